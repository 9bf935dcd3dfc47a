//! The result of adding or removing an effect, and the method of the values of a model with effects.

use super::candidate::{not_judged, veto};
use super::diagnosis::fall_of_voltage;
use super::limits::{set_aside, trivial};
use super::times;
use drivebench_diagnose::{
    AddResult, AlongFinding, ChangeFinding, Comparison, ProcessingError, Refusal,
};
use drivebench_identify::balance::Method;
use drivebench_model::text::number::probability;

/// Why an effect is accepted or refused: its probability among all others, and the change of the error.
pub fn change(result: &AddResult) -> String {
    let mut reason = reason(result);
    if let Some(refused) = &result.refused {
        let refused = match refused {
            Refusal::Veto(reason) => veto(reason),
            Refusal::Trivial(prediction) => trivial(prediction),
        };
        reason = format!("not added: {refused} ({reason})");
    }
    if let Some(aside) = &result.aside {
        reason = format!("{reason}; {}", set_aside(aside));
    }
    if result.forced {
        reason = format!("forced, although these runs do not need it: {reason}");
    }
    reason
}

fn reason(result: &AddResult) -> String {
    let name = result.name;
    let likely = probability(result.probability);
    let mut fall = fall(result);
    if result.winding_drop.is_none() {
        fall += &both_processings([&result.before, &result.after]);
    }
    let removed = |verdict: &str| {
        format!("{name} {verdict}: its probability is {likely}, and without it {fall}")
    };
    // The list between two texts; empty without an item.
    let listed = |before: &str, ids: &[&str], between: &str, behind: &str| {
        let words = || format!("{before}{}{behind}", ids.join(between));
        if ids.is_empty() { String::new() } else { words() }
    };
    match &result.finding {
        ChangeFinding::NotJudged { why } => not_judged(name, why),
        ChangeFinding::Needed => removed("is needed"),
        ChangeFinding::Superfluous => removed("is superfluous"),
        ChangeFinding::NotShown => removed("would not show in these runs, which do not need it"),
        ChangeFinding::There { rivals } => {
            let rivals = listed(", which these runs do not distinguish from ", rivals, " and ", "");
            let superfluous = (result.superfluous.iter())
                .fold(String::new(), |end, id| end + "; " + id + " is superfluous now");
            format!("{name} has a probability of {likely}{rivals}; with it {fall}{superfluous}")
        }
        ChangeFinding::NotThere { beside, would_show } => {
            let beside = listed(" besides what these runs need (", beside, ", ", ")");
            let unseen = if *would_show { "" } else { "; these runs would not show it" };
            format!(
                "{name} has a probability of {likely} only{beside}{unseen}; with it alone {fall}"
            )
        }
    }
}

fn fall(result: &AddResult) -> String {
    if let Some(drop) = &result.winding_drop {
        return fall_of_voltage(drop);
    }
    let error = |rung: usize| result.ladder.get(rung).map_or(f64::NAN, |rung| rung.holdout_rmse);
    let (from, to) = (error(0), error(1));
    let share = 100.0 * (1.0 - to / from);
    if !share.is_finite() {
        return "the held-out error is not known".to_owned();
    }
    let word = if share >= 0.0 { "falls" } else { "rises" };
    let (by, times) = (share.abs(), times(result.before.noise_floor_from));
    format!("the held-out error {word} by {by:.1} %, from {from:.2} to {to:.2} {times}")
}

/// The change under each processing of a torque balance; nothing for a free run.
fn both_processings(sides: [&Comparison; 2]) -> String {
    let [before, after] = sides.map(|side| {
        let torque = side.signals.torque_n_m.iter();
        torque.flat_map(|torque| &torque.processing)
    });
    let words = before.zip(after).map(|(before, after)| {
        let from = before.holdout_relative_error_percent;
        let to = after.holdout_relative_error_percent;
        let whole = |side: &ProcessingError| side.whole_run_relative_error_percent;
        let whole = whole(before).zip(whole(after));
        let whole = whole.map_or_else(String::new, |(from, to)| {
            format!(", {from:.2} -> {to:.2} % over the whole run")
        });
        let method = match before.method {
            Method::WeakForm => "weak form",
            Method::InverseDynamics => {
                "reference processing: inverse dynamics, zero-phase low pass"
            }
        };
        format!("; torque error {from:.2} -> {to:.2} % held out{whole} ({method})")
    });
    words.collect()
}

/// The method of the values and ± of a model with effects.
pub fn along(found: &AlongFinding) -> String {
    let not_followed = |why: &str| {
        format!(
            "the model cannot be linearised along the run{why}: ± contains the noise alone, not the errors in the forms of its \
            effects"
        )
    };
    match found {
        AlongFinding::PredictionErrors => {
            "the model has effects: values and ± are from its prediction errors, as in add and diagnose; ± includes errors in the \
            forms of the effects and in the time stamps"
                .to_owned()
        }
        AlongFinding::FreeRun => {
            "the model has effects: the values are from its free run, and differ from those of its prediction errors; ± includes \
            this difference, and errors in the forms of the effects and in the time stamps"
                .to_owned()
        }
        AlongFinding::NotFollowed => not_followed(""),
        AlongFinding::Failed(message) => not_followed(&format!(" ({message})")),
    }
}

//! The recommended run.

use super::listed;
use drivebench_diagnose::{FasterRun, Hidden, HiddenReason, NextExperiment, Recommendation};
use drivebench_model::plant::effect;
use drivebench_model::text::number::significant;

/// What to run, why, and what it will show.
pub fn next_run(next: &NextExperiment) -> String {
    match next.finding {
        Recommendation::Distinguishes => pairs(next),
        Recommendation::CannotDistinguish { faster } => {
            pairs(next) + &faster.as_ref().map_or_else(String::new, with_faster)
        }
        Recommendation::Shows => {
            let shown = listed(next.reveals.iter().map(|id| name(id).to_owned()));
            let shown = shown.unwrap_or_default();
            let text = format!("these runs would not have shown {shown}; run {}", described(next));
            if next.hidden.is_empty() {
                return text;
            }
            let hidden = next.hidden.iter().map(|own| name(own.effect).to_owned());
            format!("{text}; it still does not show {}", listed(hidden).unwrap_or_default())
        }
        Recommendation::ShowsNothingMore => {
            let hidden = next.hidden.iter();
            let words = hidden.map(|own| format!("{} ({})", name(own.effect), hidden_reason(own)));
            format!(
                "no further run within the limits would show more; not shown: {}",
                listed(words).unwrap_or_default()
            )
        }
    }
}

/// Pairs of rivals with their separations in this run.
fn pairs(next: &NextExperiment) -> String {
    let mut parts = Vec::new();
    let (distinguished, hidden): (Vec<_>, Vec<_>) =
        next.pairs.iter().partition(|pair| pair.is_separated());
    if let Some(first) = distinguished.first() {
        let rivals = distinguished.iter().map(|distinguished| {
            let [a, b] = distinguished.pair.map(name);
            format!("{a} from {b} (separation {})", figure(distinguished.expected_separation))
        });
        parts.push(format!(
            "run {}: it distinguishes {}; {} is sufficient",
            described(next),
            rivals.collect::<Vec<_>>().join(" and "),
            figure(first.needed)
        ));
    }
    for entry in hidden {
        let [a, b] = entry.pair.map(name);
        let run = program(entry.best_program);
        let (best, needed) = (figure(entry.best_separation), figure(entry.best_needed));
        parts.push(if entry.best_separation >= entry.best_needed {
            format!("{a} and {b} need another run after it: {run} (separation {best})")
        } else {
            format!(
                "no run of this kind will separate {a} and {b} within the limits: the best, {run}, gives a separation of \
                 {best} at most, {needed} are needed"
            )
        });
    }
    parts.join("; ")
}

fn with_faster(faster: &FasterRun) -> String {
    format!(
        "; with limits.slew_v_per_s = {} in the bench file, {} is sufficient (separation {})",
        faster.slew_v_per_s,
        program(faster.program),
        figure(faster.separation)
    )
}

fn described(next: &NextExperiment) -> String {
    let Some((recipe, peaks)) = next.recipe.as_ref().zip(next.peaks) else {
        return String::new();
    };
    format!(
        "{} ({:.1} s, up to {:.0} V, {:.1} A and {:.0} rad/s)",
        program(recipe.id),
        peaks.duration_s,
        peaks.voltage_v,
        peaks.current_a,
        peaks.speed_rad_s
    )
}

/// What is needed to show an effect that the recommended run does not show.
pub fn hidden_reason(hidden: &Hidden) -> String {
    match hidden.reason {
        HiddenReason::AnotherRun => "another run after it shows it".to_owned(),
        HiddenReason::Slew { v_per_s } => {
            format!("not with {v_per_s:.0} V/s: needs a faster change of the voltage")
        }
        HiddenReason::Travel { rad } => format!("not within {rad:.1} rad: needs more travel"),
        HiddenReason::Limits { voltage_v, current_a, speed_rad_s, duration_s } => format!(
            "not within {voltage_v:.0} V, {current_a:.1} A, {speed_rad_s:.0} rad/s and {duration_s:.0} s: needs more"
        ),
        HiddenReason::Excitation => {
            effect::find(hidden.effect).map_or("", |effect| effect.card().excite).to_owned()
        }
    }
}

fn program(id: &str) -> &'static str {
    match id {
        "rich" => "the rich sequence (steps, slow ramp, pseudo-random levels and sine, both ways)",
        "slow_ramp" => "a slow ramp over the full range, through zero",
        "fast_dither" => "a fast dither about zero volts",
        "hard_cycling" => "hard accelerating and braking, both ways",
        "staircase" => "long holds at several speeds, both ways",
        "slow_sine" => "a slow sine through zero",
        "standstill" => "a standstill reading",
        "heat_and_repeat" => "a first part that is repeated after heating the winding",
        "random_levels" => "pseudo-random levels of both signs",
        "steady_hold" => "a steady hold at one speed",
        "current_reversals" => "quick reversals of the current at rest",
        "dither_at_speed" => "a fast dither at rest and at speed, both ways",
        _ => "",
    }
}

fn name(id: &'static str) -> &'static str {
    effect::find(id).map_or(id, |effect| effect.card().name)
}

/// A prediction has two significant digits.
fn figure(value: f64) -> String {
    significant(value, 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing::next_experiment;
    use drivebench_diagnose::next_experiment::PairEntry;

    #[test]
    fn a_recommendation_names_its_run_and_figures() {
        let mut next = next_experiment();
        let pair = next.pairs[0].clone();
        let run = "run a slow ramp over the full range, through zero (10.0 s, up to 100 V, 6.0 A and 290 rad/s)";
        let text = next_run(&next);
        assert!(text.starts_with(run) && text.ends_with("; 612 is sufficient"), "{text}");
        let faster = FasterRun { slew_v_per_s: 400.0, program: "fast_dither", separation: 700.0 };
        next.finding = Recommendation::CannotDistinguish { faster: Some(faster) };
        next.pairs = vec![PairEntry { expected_separation: 10.0, best_separation: 10.0, ..pair }];
        let text = next_run(&next);
        let end = "with limits.slew_v_per_s = 400 in the bench file, a fast dither about zero volts is sufficient (separation 700)";
        assert!(text.starts_with("no run of this kind") && text.ends_with(end), "{text}");
        let reason = HiddenReason::Slew { v_per_s: 150.0 };
        next.hidden = vec![Hidden { effect: "cogging", reason }];
        next.finding = Recommendation::ShowsNothingMore;
        let text = next_run(&next);
        let end = "(not with 150 V/s: needs a faster change of the voltage)";
        assert!(text.starts_with("no further run") && text.ends_with(end), "{text}");
    }
}

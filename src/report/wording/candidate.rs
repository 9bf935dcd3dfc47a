//! One candidate effect: what the runs show of it, its size, when it happened, why it is not named.

use super::limits::{HOLDOUT_STILL, why_open};
use super::times;
use drivebench_diagnose::{
    Candidate, CandidateFinding, HoldoutFrom, Onset, Peak, RunOf, Status, VetoReason,
    WhyUnexplained,
};
use drivebench_model::plant::{Effect, ParameterSpec, effect};
use drivebench_model::text::number::{probability, significant, with_std, with_unit};
use std::fmt::Write as _;

pub const fn status(status: Status) -> &'static str {
    match status {
        Status::Supported => "supported",
        Status::Possible => "possible",
        Status::RuledOut => "ruled out",
        Status::NotExcited => "not excited",
    }
}

pub fn evidence(own: &Candidate) -> String {
    let effect = effect::find(own.effect);
    let name = effect.map_or(own.effect, |effect| effect.card().name);
    let percent = probability(own.probability);
    let size = |size: Option<f64>| {
        let (effect, size) = (effect?, size?);
        let unit = match unit_of_size(effect) {
            "-" => "(a ratio)",
            unit => unit,
        };
        let size = bound(Some(size), unit_of_size(effect), own.run_s)?;
        Some(format!("{} {unit}", significant(size, 2)))
    };
    let most = |bound: Option<f64>| {
        size(bound).map_or_else(String::new, |bound| format!("; at most {bound}"))
    };
    let mut text = match own.finding {
        CandidateFinding::LeftOpen(why) => format!("{name} is left open: {}", why_open(why)),
        CandidateFinding::NotJudged { why } => not_judged(name, why),
        CandidateFinding::NotShown => {
            let excite = effect.map_or("", |effect| effect.card().excite);
            format!("{name}: these runs would not show it; {excite}")
        }
        CandidateFinding::Named { floor, holdout_from } => {
            let when = effect.and_then(|effect| happening(effect, &own.onsets, holdout_from));
            format!(
                "{name} has a probability of {percent}{}; with it the held-out error goes from {:.2} to {:.2} {}",
                when.map_or_else(String::new, |when| format!(" ({when})")),
                own.holdout_before,
                own.holdout_after.unwrap_or(f64::NAN),
                times(floor)
            )
        }
        CandidateFinding::RuledOut => format!(
            "{name} has a probability of {percent}{}{}{}",
            most(own.upper_bound),
            size(own.detectable)
                .map_or_else(String::new, |least| format!("; {least} would have shown")),
            searched(own)
        ),
        CandidateFinding::MayBeThere { upper_bound } => {
            format!("{name} is possible, with a probability of {percent}{}", most(upper_bound))
        }
    };
    if let Some(reason) = &own.not_named {
        text += "; not named: ";
        text += &veto(reason);
    }
    if let Some(other) = own.as_good_as {
        let _ = write!(text, "; explains as much as {other}; these runs do not distinguish them");
    }
    text
}

pub(super) fn not_judged(name: &str, why: &str) -> String {
    format!("{name} cannot be judged from this run: {why}")
}

pub fn veto(reason: &VetoReason) -> String {
    match reason {
        VetoReason::Surplus { most } => {
            format!("more than {most} effects would act at once, and others explain more")
        }
        VetoReason::HoldoutStill => HOLDOUT_STILL.to_owned(),
        VetoReason::Diverges => "with it the simulated motor runs away".to_owned(),
        VetoReason::SearchCut => {
            "the budget ended the search, and its refit does not halve the held-out error"
                .to_owned()
        }
        VetoReason::FrequencyTooHigh { found_hz, highest_hz } => format!(
            "its frequency of {found_hz:.1} Hz is above half the sampling rate, {highest_hz:.1} Hz"
        ),
        VetoReason::FrequencyUnknown { found_hz, std_hz } => {
            format!("its frequency is not determined ({found_hz:.1} ± {std_hz:.1} Hz)")
        }
        VetoReason::ShapeAtBound { key, bound } => format!("{key} is at its bound, {bound:.1e}"),
        VetoReason::ShortLag { known_s } => format!(
            "these readings do not distinguish a lag below {} ms from an inductance, friction at rest or another form",
            significant(1e3 * known_s, 2)
        ),
        VetoReason::SizeMayBeZero => "in the fit with it its size is not significant".to_owned(),
        VetoReason::SizeMayBeZeroInBalance => "its size in the balance may be zero".to_owned(),
        VetoReason::NoInertia => {
            "an artefact: with it the torque balance has no inertia any more".to_owned()
        }
        VetoReason::ByChance => {
            "it reduces the errors no more than chance would, and they are at the noise without it"
                .to_owned()
        }
        VetoReason::Unexplained(why) => {
            let why = match why {
                WhyUnexplained::Open(why) => why_open(*why),
                WhyUnexplained::SeveralTimesTheNoise => "several times the noise is left",
                WhyUnexplained::NotWhite => "its innovations are not white",
            };
            format!("most stays unexplained with all that would be named, and {why}")
        }
        VetoReason::NotLower { before, after, floor } => format!(
            "with it the held-out error goes from {before:.2} to {after:.2} {}: it is not lower by more than chance",
            times(*floor)
        ),
    }
}

/// Note on sizes whose intervals are wider than by the noise alone.
pub fn widened(own: &Candidate) -> Option<String> {
    (own.interval_factor > 1.05).then(|| {
        format!(
            "widened {:.1} times, because more than noise is left: valid if no other effect is missing",
            own.interval_factor
        )
    })
}

/// The upper bound of its size.
pub fn at_most(own: &Candidate) -> Option<String> {
    sized(own, "at most", own.upper_bound)
}

/// The smallest size that would have been detected.
pub fn detectable_from(own: &Candidate) -> Option<String> {
    sized(own, "detectable from", own.detectable)
}

fn sized(own: &Candidate, lead: &str, size: Option<f64>) -> Option<String> {
    let unit = unit_of_size(effect::find(own.effect)?);
    let size = bound(size, unit, own.run_s)?;
    Some(format!("{lead} {}", with_unit(&significant(size, 2), unit)))
}

/// A usable bound: a time that is longer than the run is none.
fn bound(size: Option<f64>, unit: &str, run_s: f64) -> Option<f64> {
    size.filter(|size| size.is_finite() && (unit != "s" || *size <= run_s))
}

/// Unit of the parameter that gives an effect its size.
fn unit_of_size(effect: &dyn Effect) -> &'static str {
    effect.parameters().get(effect.size_index()).map_or("", |spec| spec.unit)
}

/// When an event happened, and what it changed.
pub(super) fn happening(
    effect: &dyn Effect,
    onsets: &[Onset],
    from: HoldoutFrom,
) -> Option<String> {
    let change = effect.card().changes.unwrap_or(effect.card().name);
    let size = |onset: &Onset| match unit_of_size(effect) {
        "-" => format!("{change} {:+.0} %", 100.0 * onset.size),
        unit if onset.size.abs() < 0.01 => format!("{change} {:+.2e} {unit}", onset.size),
        unit => format!("{change} {:+.3} {unit}", onset.size),
    };
    let when = |onset: &Onset| format!("from {:.2} s on, {}", onset.time_s, size(onset));
    let run = |onset: &Onset| match (onset.run, onset.number) {
        (RunOf::Fit, _) => "in the fit run".to_owned(),
        (RunOf::Whole, _) => "in the first run".to_owned(),
        (RunOf::Holdout, _) => "in the hold-out".to_owned(),
        (RunOf::Later, number) => format!("in later run {}", number.unwrap_or(1)),
    };
    let is_first = |onset: &Onset| matches!(onset.run, RunOf::Fit | RunOf::Whole);
    match onsets {
        [] => None,
        [one] if from == HoldoutFrom::Split && is_first(one) => Some(when(one)),
        [one] => Some(format!("{} only, {}", run(one), when(one))),
        several => {
            let each = several.iter().map(|own| {
                if is_first(own) { when(own) } else { format!("{} {}", run(own), when(own)) }
            });
            Some(each.collect::<Vec<_>>().join("; "))
        }
    }
}

/// The largest size of one quantity, with so many standard deviations on either side.
pub fn peak(peak: &Peak, deviations: f64) -> String {
    let size = with_std(peak.value, peak.std.map(|std| deviations * std));
    let share = peak.percent_of_largest.map_or_else(String::new, |percent| {
        format!(", {} % of the largest", significant(percent, 2))
    });
    format!("up to {size} {} in this run{share}", peak.unit)
}

/// The ranges of the shapes that were tried.
fn searched(own: &Candidate) -> String {
    let range = |(spec, [from, to]): &(&ParameterSpec, [f64; 2])| {
        let [from, to] = [from, to].map(|end| significant(*end, 2));
        let range = if from == to { from } else { format!("{from} to {to}") };
        format!("{} {}", spec.key, with_unit(&range, spec.unit))
    };
    let ranges: Vec<String> = own.searched.iter().map(range).collect();
    if ranges.is_empty() { String::new() } else { format!("; tried with {}", ranges.join(", ")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing::candidate;

    #[test]
    fn a_time_that_is_longer_than_the_run_is_no_bound() {
        for (size, unit, expected) in [
            (Some(3.67e3), "s", None),
            (Some(0.004), "s", Some(0.004)),
            (Some(3.67e3), "A", Some(3.67e3)),
            (Some(f64::INFINITY), "A", None),
            (None, "s", None),
        ] {
            assert_eq!(bound(size, unit, 12.0), expected, "{size:?} {unit}");
        }
    }

    #[test]
    fn a_veto_and_a_rival_follow_the_evidence() {
        let mut own = candidate(2, "cogging", Status::Possible, 3.9);
        own.not_named = Some(VetoReason::SizeMayBeZero);
        own.as_good_as = Some("stribeck_friction");
        let text = evidence(&own);
        let end = "; not named: in the fit with it its size is not significant; explains as much as stribeck_friction; these runs do not distinguish them";
        assert!(text.ends_with(end), "{text}");
    }

    #[test]
    fn an_event_has_its_run_and_time() {
        let onset = |run, number, time_s, size| Onset {
            run,
            number,
            time_s,
            interval_95_s: [time_s, time_s],
            size,
            size_std: 0.0,
        };
        let first = onset(RunOf::Fit, None, 5.02, 0.3);
        let later = onset(RunOf::Later, Some(2), 3.0, 0.1);
        for (onsets, from, expected) in [
            (vec![], HoldoutFrom::Run, None),
            (
                vec![first.clone()],
                HoldoutFrom::Run,
                Some("in the fit run only, from 5.02 s on, inertia +30 %"),
            ),
            (vec![first.clone()], HoldoutFrom::Split, Some("from 5.02 s on, inertia +30 %")),
            (
                vec![first, later],
                HoldoutFrom::Run,
                Some("from 5.02 s on, inertia +30 %; in later run 2 from 3.00 s on, inertia +10 %"),
            ),
        ] {
            let effect = effect::find("inertia_change").unwrap();
            assert_eq!(happening(effect, &onsets, from).as_deref(), expected);
        }
    }
}

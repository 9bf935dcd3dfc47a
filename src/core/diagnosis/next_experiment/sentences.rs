//! Sentences: a recommendation in words for a person.

use super::PairEntry;
use super::plan::Planned;
use crate::plant::effect;
use crate::text::number::significant;

/// Names of a list that are said; the rest is counted.
const MOST_NAMES: usize = 4;

/// For pairs of rivals with their separations in this run; `program` names a run of the menu.
pub(super) fn pairs(
    plan: &Planned,
    pairs: &[PairEntry],
    program: impl Fn(&str) -> &'static str,
) -> String {
    let mut sentences = Vec::new();
    let (told, hidden): (Vec<_>, Vec<_>) = pairs.iter().partition(|pair| pair.is_told());
    if let Some(first) = told.first() {
        let rivals: Vec<String> = told
            .iter()
            .map(|told| {
                let [a, b] = told.pair.map(name);
                let separation = figure(told.expected_separation);
                format!("{a} from {b} (separation {separation})")
            })
            .collect();
        sentences.push(format!(
            "run {}: it tells {}; {} would do",
            described(plan),
            rivals.join(" and "),
            figure(first.needed)
        ));
    }
    for entry in hidden {
        let [a, b] = entry.pair.map(name);
        let run = program(entry.best_program);
        let (best, needed) = (figure(entry.best_separation), figure(entry.best_needed));
        sentences.push(if entry.best_separation >= entry.best_needed {
            format!("{a} and {b} need another run after it: {run} (separation {best})")
        } else {
            format!(
                "no run of this kind will separate {a} and {b} within the limits: the best, {run}, gives a separation \
                 of {best} at most, {needed} are needed"
            )
        });
    }
    sentences.join("; ")
}

/// What would be possible if the bench let the voltage change faster.
pub(super) fn with_more_slew(plan: &Planned, separation: f64) -> String {
    format!(
        "; with limits.slew_v_per_s = {} in the bench file, {} would (separation {})",
        plan.recipe.slew_v_per_s,
        plan.recipe.name,
        figure(separation)
    )
}

/// For effects that the runs in hand did not excite.
pub(super) fn reveals(plan: &Planned, shown: &[&'static str], hidden: &[&'static str]) -> String {
    let mut sentence = if shown.is_empty() {
        format!(
            "no run of this kind will show {} within the limits",
            list(hidden)
        )
    } else {
        format!(
            "these runs would not have shown {}; run {}",
            list(shown),
            described(plan)
        )
    };
    if !shown.is_empty() && !hidden.is_empty() {
        sentence = format!("{sentence}; it still does not show {}", list(hidden));
    }
    sentence
}

fn described(plan: &Planned) -> String {
    let peaks = &plan.peaks;
    format!(
        "{} ({:.1} s, up to {:.0} V, {:.1} A and {:.0} rad/s)",
        plan.recipe.name, peaks.duration_s, peaks.voltage_v, peaks.current_a, peaks.speed_rad_s
    )
}

fn list(ids: &[&'static str]) -> String {
    let names: Vec<&str> = ids.iter().take(MOST_NAMES).map(|id| name(id)).collect();
    match ids.len().checked_sub(MOST_NAMES) {
        Some(more) if more > 0 => format!("{} and {more} more", names.join(", ")),
        _ => names.join(", "),
    }
}

fn name(id: &'static str) -> &'static str {
    effect::find(id).map_or(id, |effect| effect.card().name)
}

/// Two figures are all that a prediction deserves.
fn figure(value: f64) -> String {
    significant(value, 2)
}

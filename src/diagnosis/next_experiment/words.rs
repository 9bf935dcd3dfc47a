//! A recommendation as sentences.

use super::SEPARATED;
use super::planned::Planned;
use crate::plant::effect;

/// Names of a list that are said; the rest is counted.
const MOST_NAMES: usize = 4;

/// For pairs of rivals with their separations in this run.
pub(super) fn pairs(plan: &Planned, separations: &[([&'static str; 2], f64)]) -> String {
    let mut sentences = Vec::new();
    let told: Vec<_> = separations
        .iter()
        .filter(|(_, value)| *value >= SEPARATED)
        .collect();
    if !told.is_empty() {
        let rivals: Vec<String> = told
            .iter()
            .map(|([a, b], value)| {
                format!(
                    "{} from {} (separation {})",
                    name(a),
                    name(b),
                    figure(*value)
                )
            })
            .collect();
        sentences.push(format!(
            "run {}: it tells {}; {SEPARATED:.0} would do",
            described(plan),
            rivals.join(" and ")
        ));
    }
    for ([a, b], value) in separations.iter().filter(|(_, value)| *value < SEPARATED) {
        sentences.push(if told.is_empty() {
            format!(
                "no run of this kind will separate {} and {} within the limits: the best, {}, gives a separation of {}, \
                 {SEPARATED:.0} are needed",
                name(a),
                name(b),
                plan.recipe.name,
                figure(*value)
            )
        } else {
            format!("it does not separate {} and {}", name(a), name(b))
        });
    }
    sentences.join("; ")
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
    if value < 10.0 {
        return format!("{value:.1}");
    }
    let unit = 10_f64.powf(value.log10().floor() - 1.0);
    format!("{:.0}", (value / unit).round() * unit)
}

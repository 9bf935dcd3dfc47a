//! The drift of a machine between two dates.

use drivebench_identify::drift::{
    Change, Drift, DriftCause, DriftCaution, DriftFinding, NotCarried, NotCompared,
};
use drivebench_identify::temperature;
use drivebench_model::plant::{MotorKey, effect};
use drivebench_model::text::number::{exponent_of, fixed, places, probability, significant};

pub fn name(key: &str) -> String {
    let name = match MotorKey::from_key(key) {
        Some(MotorKey::LoadTorque) => "friction (load torque)",
        Some(own) => own.name(),
        None if key == temperature::KEY => "resistance at 20 °C",
        None => key,
    };
    name.to_owned()
}

pub fn drift(found: &Drift) -> String {
    let since = &found.since;
    let list = |is: fn(&&Change) -> bool| {
        let named = found.changes.iter().filter(is);
        let named = named.map(|change| format!("{} {}", name(&change.key), size(change)));
        named.collect::<Vec<_>>().join("; ")
    };
    let [drifted, unsettled] = [list(|change| change.drifted), list(|change| change.unsettled)];
    let open: Option<Vec<f64>> = found.changes.iter().map(Change::at_most_percent).collect();
    let count = found.changes.len();
    let answer = if !drifted.is_empty() {
        format!("drifted since {since}: {drifted}")
    } else if !unsettled.is_empty() {
        format!("not settled whether there is a drift since {since}: {unsettled}")
    } else if found.changes.is_empty() {
        "no comparison: no parameter is observable in the runs of both dates".to_owned()
    } else if let Some(open) = open {
        let most = significant(open.into_iter().fold(0.0, f64::max), 2);
        format!(
            "no drift shown since {since}: {count} parameters compared, a change larger than {most} % is excluded (95 % for each \
             alone)"
        )
    } else {
        format!("no drift shown since {since}: {count} parameters compared")
    };
    if found.not_compared.is_empty() {
        return answer;
    }
    let open: Vec<String> = found.not_compared.iter().map(|one| name(&one.key)).collect();
    format!("{answer}; not compared: {}", open.join(", "))
}

pub fn change(change: &Change, since: &str) -> String {
    let name = name(&change.key);
    match (change.finding, change.at_most_percent()) {
        (DriftFinding::Drifted, _) => {
            let chance = probability(change.by_chance);
            let cause = change.possible_cause.as_ref();
            let cause = cause
                .map_or_else(String::new, |own| format!("; possible cause: {}", self::cause(own)));
            format!("{name} {} since {since}, {chance} by chance{cause}", size(change))
        }
        (DriftFinding::Unsettled, _) => format!(
            "{name} {} since {since}: more than the noise within the runs, but there are too few runs to know the variation \
             from run to run; repeat the run",
            size(change)
        ),
        (DriftFinding::Bounded, Some(most)) => format!(
            "{name}: a change larger than {} % is excluded (95 %) since {since}",
            significant(most, 2)
        ),
        (DriftFinding::Bounded | DriftFinding::NotShown, _) => {
            format!("{name}: no change shown since {since}: {}", size(change))
        }
    }
}

pub fn cause(cause: &DriftCause) -> String {
    let words = match cause {
        DriftCause::Winding { kelvin, warmer } => {
            let (kelvin, warmth) =
                (significant(*kelvin, 2), if *warmer { "warmer" } else { "colder" });
            return format!(
                "a winding about {kelvin} K {warmth}, if that is the only cause; connections or brushes"
            );
        }
        DriftCause::LessSaturation => "less saturation: a smaller current",
        DriftCause::MoreSaturation => "more saturation, or a shorted turn",
        DriftCause::ColderMagnets => "colder magnets; the scale of the speed",
        DriftCause::WarmerMagnets => "warmer or weakened magnets; the scale of the speed",
        DriftCause::TorqueScale => "magnets; the scale of the torque",
        DriftCause::Load => "another load on the shaft, or a loose coupling",
        DriftCause::MoreFriction => "bearing, lubrication, brushes, or another load",
        DriftCause::LessFriction => "running in, warmer lubricant, or another load",
        DriftCause::Connections => "connections, brushes, or a damaged winding",
        DriftCause::Effect { id } => {
            effect::find(id).and_then(|effect| effect.card().drift_cause).unwrap_or_default()
        }
    };
    words.to_owned()
}

/// Variation that the intervals do not contain; none where they are complete.
pub fn caution(found: &Drift) -> Option<String> {
    let cautions: Vec<String> = found.cautions.iter().map(one_caution).collect();
    (!cautions.is_empty()).then(|| cautions.join("; "))
}

fn one_caution(caution: &DriftCaution) -> String {
    let words = match caution {
        DriftCaution::SingleRuns { keys } => {
            let names: Vec<String> = keys.iter().map(|key| name(key)).collect();
            let of = names.join(", ");
            let of = if of.is_empty() { of } else { format!(" with {of}") };
            return format!(
                "one run on each side{of}: the variation of this machine from run to run is not known, and no interval contains it"
            );
        }
        DriftCaution::OtherExcitation => {
            "excited otherwise than then, or not known to be alike: an effect that the model lacks may look like a drift"
        }
        DriftCaution::UnknownUnit => "no serial number: not known to be the same unit",
        DriftCaution::SameFigures => {
            "figure for figure as it was then: the same run, or a software drive that repeats itself"
        }
        DriftCaution::RepeatedRuns { count } => {
            return format!(
                "{count} of the baseline are a run that is in it already, and not counted"
            );
        }
    };
    words.to_owned()
}

pub fn not_compared(found: &NotCompared) -> String {
    let reason = match found.not_carried {
        NotCarried::ByEither => "not observable in the runs of either date",
        NotCarried::Before => "not observable in the earlier runs",
        NotCarried::After => "not observable in the later runs",
    };
    let own = found.own_reason.as_ref();
    own.map_or_else(|| reason.to_owned(), |own| format!("{reason}: {own}"))
}

/// Three numbers with their sign, to the digits in which the ends of the interval differ.
fn signed(value: f64, [low, high]: [f64; 2]) -> [String; 3] {
    let decimals = places(exponent_of(0.5 * (high - low), 1).saturating_neg());
    [value, low, high].map(|value| {
        let sign = if value > 0.0 { "+" } else { "" };
        format!("{sign}{}", fixed(value, decimals))
    })
}

/// The change itself, with its interval.
fn size(change: &Change) -> String {
    if let (Some(percent), Some(interval)) = (change.percent, change.interval_95_percent) {
        let [percent, low, high] = signed(percent, interval);
        return format!("{percent} % (95 % interval {low} to {high} %)");
    }
    let [size, low, high] = signed(change.change, change.interval_95);
    let unit = change.unit;
    format!("{size} {unit} (95 % interval {low} to {high} {unit})")
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_identify::drift::between;
    use drivebench_model::sample::ParameterEstimate;

    fn run(friction: f64, std: f64) -> Vec<ParameterEstimate> {
        let found = |key: MotorKey, value: f64, std: f64| {
            ParameterEstimate::found(key.key(), key.unit(), value, std, None)
        };
        vec![found(MotorKey::LoadTorque, friction, std), found(MotorKey::Inertia, 0.0045, 1e-5)]
    }

    #[test]
    fn a_drift_has_its_interval_and_cause() {
        let found = between(&[run(0.45, 0.003)], &[run(0.504, 0.003)], "2026-03-01");
        let [friction, inertia] = &found.changes[..] else { panic!("{found:?}") };
        assert_eq!(
            change(friction, &found.since),
            "friction (load torque) +12 % (95 % interval +10 to +14 %) since 2026-03-01, less than 1 % by chance; possible \
             cause: bearing, lubrication, brushes, or another load"
        );
        assert_eq!(
            change(inertia, &found.since),
            "inertia: a change larger than 0.62 % is excluded (95 %) since 2026-03-01"
        );
        assert_eq!(
            drift(&found),
            "drifted since 2026-03-01: friction (load torque) +12 % (95 % interval +10 to +14 %)"
        );
        let near_zero = between(&[run(0.001, 0.01)], &[run(0.2, 0.01)], "May");
        assert_eq!(size(&near_zero.changes[0]), "+0.20 N.m (95 % interval +0.17 to +0.23 N.m)");
        let caution = caution(&found).unwrap();
        assert!(caution.starts_with("one run on each side: the variation"), "{caution}");
    }
}

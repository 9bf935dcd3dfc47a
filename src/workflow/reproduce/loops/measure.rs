//! What a trace of a speed loop shows, on the true speed.

use serde::Serialize;

use crate::control::{Response, TrialPoint, response};

/// A load is recovered from when the speed stays within this share of the reference.
pub(in crate::workflow::reproduce) const RECOVERED_SHARE: f64 = 0.005;

/// One step of the reference.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    pub at_s: f64,
    pub from_rad_s: f64,
    pub to_rad_s: f64,
    /// From the speed at the instant of the step: a loop that swings does not begin at the old reference.
    #[serde(flatten)]
    pub response: Response,
    /// Overshoot over the step of the reference, per cent.
    pub overshoot_of_reference_percent: f64,
    /// Cycles in which a limit held the output, per cent.
    pub limited_percent: f64,
    /// Root mean square of the output's change from cycle to cycle, V.
    pub effort_v: f64,
}

/// A load that comes on or goes off at a constant reference.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LoadChange {
    pub at_s: f64,
    /// Largest error while the load changes the speed, rad/s.
    pub dip_rad_s: f64,
    /// After which the error stays below 0.5 % of the reference, s; `None` if it never does.
    pub recovery_s: Option<f64>,
    /// Mean error over the last fifth of the time that is looked at, rad/s.
    pub lasting_rad_s: f64,
}

/// Every step of the reference, cut where it changes; the first begins at standstill.
pub(in crate::workflow::reproduce) fn steps(trace: &[TrialPoint]) -> Vec<Step> {
    let chunks = trace.chunk_by(|a, b| a.reference_rad_s.to_bits() == b.reference_rad_s.to_bits());
    let mut from_rad_s = 0.0;
    chunks
        .map(|chunk| {
            let first = chunk[0];
            let points: Vec<_> = chunk.iter().map(|p| (p.time_s, p.speed_rad_s)).collect();
            let to_rad_s = first.reference_rad_s;
            let response = response(&points, first.speed_rad_s, to_rad_s);
            let covered = (to_rad_s - first.speed_rad_s) / (to_rad_s - from_rad_s);
            let step = Step {
                at_s: first.time_s,
                from_rad_s,
                to_rad_s,
                response,
                overshoot_of_reference_percent: covered * response.overshoot_percent,
                limited_percent: 100.0 * chunk.iter().filter(|point| point.limited).count() as f64
                    / chunk.len() as f64,
                effort_v: effort_v(chunk),
            };
            from_rad_s = to_rad_s;
            step
        })
        .collect()
}

/// What a change of the load at `at_s` did until `until_s`.
pub(in crate::workflow::reproduce) fn load_change(
    trace: &[TrialPoint],
    at_s: f64,
    until_s: f64,
) -> LoadChange {
    let seen: Vec<(f64, f64, f64)> = trace
        .iter()
        .filter(|point| point.time_s >= at_s && point.time_s < until_s)
        .map(|point| {
            let error = point.reference_rad_s - point.speed_rad_s;
            (point.time_s, error, point.reference_rad_s)
        })
        .collect();
    let outside =
        |(_, error, reference): &(f64, f64, f64)| error.abs() > RECOVERED_SHARE * reference.abs();
    let recovered = match seen.iter().rposition(outside) {
        None => seen.first(),
        Some(last) => seen.get(last + 1),
    };
    let end = &seen[seen.len() - seen.len() / 5..];
    LoadChange {
        at_s,
        dip_rad_s: seen.iter().map(|point| point.1.abs()).fold(0.0, f64::max),
        recovery_s: recovered.map(|point| point.0 - at_s),
        lasting_rad_s: end.iter().map(|point| point.1).sum::<f64>() / end.len().max(1) as f64,
    }
}

/// Root mean square of the output's change from cycle to cycle, V.
pub(in crate::workflow::reproduce) fn effort_v(trace: &[TrialPoint]) -> f64 {
    rms(trace
        .windows(2)
        .map(|pair| pair[1].output_v - pair[0].output_v))
}

pub(in crate::workflow::reproduce) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value * value;
        count += 1.0;
    }
    if count > 0.0 {
        (sum / count).sqrt()
    } else {
        0.0
    }
}

/// Standard deviation about the mean.
pub(in crate::workflow::reproduce) fn std(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    rms(values.iter().map(|value| value - mean))
}

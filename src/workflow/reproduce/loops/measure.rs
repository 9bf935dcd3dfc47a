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
    let mut before_rad_s = 0.0;
    let step = |chunk: &[TrialPoint]| {
        let first = chunk[0];
        let points: Vec<_> = chunk.iter().map(|p| (p.time_s, p.speed_rad_s)).collect();
        let to_rad_s = first.reference_rad_s;
        let from_rad_s = std::mem::replace(&mut before_rad_s, to_rad_s);
        let response = response(&points, first.speed_rad_s, to_rad_s);
        let covered = (to_rad_s - first.speed_rad_s) / (to_rad_s - from_rad_s);
        Step {
            at_s: first.time_s,
            from_rad_s,
            to_rad_s,
            response,
            overshoot_of_reference_percent: covered * response.overshoot_percent,
            limited_percent: limited_percent(chunk),
            effort_v: effort_v(chunk),
        }
    };
    chunks.map(step).collect()
}

/// What a change of the load at `at_s` did until `until_s`.
pub(in crate::workflow::reproduce) fn load_change(
    trace: &[TrialPoint],
    at_s: f64,
    until_s: f64,
) -> LoadChange {
    let seen = within(trace, at_s, until_s);
    let outside = |p: &TrialPoint| error(p).abs() > RECOVERED_SHARE * p.reference_rad_s.abs();
    let recovered = match seen.iter().rposition(outside) {
        None => seen.first(),
        Some(last) => seen.get(last + 1),
    };
    LoadChange {
        at_s,
        dip_rad_s: seen.iter().map(|p| error(p).abs()).fold(0.0, f64::max),
        recovery_s: recovered.map(|point| point.time_s - at_s),
        lasting_rad_s: lasting_rad_s(&seen),
    }
}

/// The part of a trace from an instant until another.
pub(in crate::workflow::reproduce) fn within(
    trace: &[TrialPoint],
    from_s: f64,
    until_s: f64,
) -> Vec<TrialPoint> {
    let inside = |point: &&TrialPoint| point.time_s >= from_s && point.time_s < until_s;
    trace.iter().filter(inside).copied().collect()
}

pub(in crate::workflow::reproduce) fn error(point: &TrialPoint) -> f64 {
    point.reference_rad_s - point.speed_rad_s
}

/// Mean error of the last fifth, rad/s.
pub(in crate::workflow::reproduce) fn lasting_rad_s(trace: &[TrialPoint]) -> f64 {
    let end = &trace[trace.len() - trace.len() / 5..];
    end.iter().map(error).sum::<f64>() / end.len().max(1) as f64
}

/// Cycles in which a limit held the output, per cent.
pub(in crate::workflow::reproduce) fn limited_percent(trace: &[TrialPoint]) -> f64 {
    100.0 * trace.iter().filter(|point| point.limited).count() as f64 / trace.len() as f64
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

/// Mean of the speed, and its standard deviation about it.
pub(in crate::workflow::reproduce) fn mean_and_std(trace: &[TrialPoint]) -> (f64, f64) {
    let speeds = || trace.iter().map(|point| point.speed_rad_s);
    let mean = speeds().sum::<f64>() / trace.len().max(1) as f64;
    (mean, rms(speeds().map(|speed| speed - mean)))
}

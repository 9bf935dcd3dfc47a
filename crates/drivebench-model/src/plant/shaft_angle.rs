//! Phase unwrapping (Itoh, *Applied Optics* 21, 1982) of a measured angle that jumps back by one turn.

use std::f64::consts::TAU;

use crate::numerics::statistics::extent;

/// `angle` as `(time, angle)`, unwrapped. An angle without jumps, or with a range of more than one turn, is continuous already.
/// Each step is the shorter way round; where steps are too large for that, the way nearest to the integral of `speed` (at its
/// own times, NaN where missing).
pub(super) fn continuous(angle: Vec<(f64, f64)>, speed: &[(f64, f64)]) -> Vec<(f64, f64)> {
    // All values within one turn and the last count of an encoder, and steps of more than half a turn.
    let (least, most) = extent(angle.iter().map(|point| point.1));
    let steps = || angle.windows(2).map(|pair| pair[1].1 - pair[0].1);
    let is_wrapped = most - least < 1.02 * TAU && steps().any(|step| step.abs() > 0.5 * TAU);
    if !is_wrapped {
        return angle;
    }
    let nearest = |step: f64| step - TAU * (step / TAU).round();
    // With steps of less than a quarter of a turn the shorter way round is certain.
    let is_certain = steps().all(|step| nearest(step).abs() < 0.25 * TAU);
    let speed: &[(f64, f64)] = if is_certain { &[] } else { speed };
    let mut next = 0;
    // The mean of the speeds within an interval, or of the next one, times its length; zero without a speed.
    let mut travelled = |from_s: f64, to_s: f64| {
        while speed.get(next).is_some_and(|point| point.0 < from_s) {
            next += 1;
        }
        let rest = &speed[next..];
        let within = rest.iter().take_while(|point| point.0 <= to_s).count();
        let speeds = &rest[..within.max(1).min(rest.len())];
        let sum = speeds.iter().fold(0.0, |sum, point| sum + point.1);
        match speeds.len() {
            0 => 0.0,
            count => sum / count as f64 * (to_s - from_s),
        }
    };
    let mut turns = 0.0;
    let mut last = angle[0];
    let mut out = Vec::with_capacity(angle.len());
    out.push(last);
    for &point in &angle[1..] {
        let step = point.1 - last.1;
        turns -= ((step - travelled(last.0, point.0)) / TAU).round();
        out.push((point.0, point.1 + TAU * turns));
        last = point;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    /// There and back, many turns each way, up to 300 rad/s.
    fn motion(t: f64) -> f64 {
        0.5 + 100.0 * (3.0 * t).sin()
    }

    /// A signal every `period_s`.
    fn sampled(period_s: f64, of: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        (0..400).map(|k| f64::from(k) * period_s).map(|t| (t, of(t))).collect()
    }

    fn largest_error(angle: &[(f64, f64)]) -> f64 {
        crate::numerics::statistics::largest(angle.iter().map(|(t, a)| a - motion(*t)))
    }

    #[test]
    fn a_wrapped_angle_becomes_continuous_if_need_be_by_the_speed() {
        for from in [0.0, -0.5 * TAU] {
            let wrapped = sampled(0.002, |t| (motion(t) - from).rem_euclid(TAU) + from);
            assert!(largest_error(&continuous(wrapped, &[])) < 1e-9);
        }
        // More than half a turn passes between two samples.
        let wrapped = || sampled(0.015, |t| motion(t).rem_euclid(TAU));
        let speed = sampled(0.015, |t| 300.0 * (3.0 * t).cos());
        assert!(largest_error(&continuous(wrapped(), &speed)) < 1e-9);
        assert!(largest_error(&continuous(wrapped(), &[])) > 1.0);
        let long = sampled(0.015, motion);
        assert_eq!(continuous(long.clone(), &speed), long);
        let small = sampled(0.01, |t| 2.0 * t.sin());
        assert_eq!(continuous(small.clone(), &[]), small);
        assert!(continuous(vec![], &[]).is_empty());
    }
}

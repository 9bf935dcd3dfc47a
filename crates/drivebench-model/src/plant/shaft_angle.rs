//! A measured angle that starts again after each turn, made continuous: between two samples an effect of position has to
//! see the way that the shaft went, not the jump back.

use std::f64::consts::TAU;

use crate::numerics::statistics::extent;

/// Share of a turn by which the values of a wrapped angle may exceed one: an encoder's last count.
const SLACK: f64 = 0.02;
/// Longest step, in turns, up to which the nearest way round is taken without asking the speed.
const SURE: f64 = 0.25;

/// `angle` as `(time, angle)`, continuous. An angle that never jumps, or that leaves one turn, is continuous already. The
/// nearest way round is taken; where that could be either, `speed` (at its own times, NaN where missing) decides.
pub(super) fn continuous(angle: Vec<(f64, f64)>, speed: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if !is_wrapped(&angle) {
        return angle;
    }
    let nearest = |step: f64| step - TAU * (step / TAU).round();
    let sure = angle
        .windows(2)
        .all(|pair| nearest(pair[1].1 - pair[0].1).abs() < SURE * TAU);
    let mut track = Integral::new(if sure { &[] } else { speed });
    let mut turns = 0.0;
    let mut last = angle[0];
    let mut out = Vec::with_capacity(angle.len());
    out.push(last);
    for &point in &angle[1..] {
        let step = point.1 - last.1;
        turns -= ((step - track.over(last.0, point.0)) / TAU).round();
        out.push((point.0, point.1 + TAU * turns));
        last = point;
    }
    out
}

/// All values within one turn, and steps of more than half of it.
fn is_wrapped(angle: &[(f64, f64)]) -> bool {
    let (least, most) = extent(angle.iter().map(|point| point.1));
    let mut steps = angle.windows(2).map(|pair| pair[1].1 - pair[0].1);
    most - least < (1.0 + SLACK) * TAU && steps.any(|step| step.abs() > 0.5 * TAU)
}

/// Integral of a speed over intervals that come in the order of time.
struct Integral<'a> {
    speed: &'a [(f64, f64)],
    next: usize,
}

impl<'a> Integral<'a> {
    const fn new(speed: &'a [(f64, f64)]) -> Self {
        Self { speed, next: 0 }
    }

    /// Mean of the speeds within the interval, or beside it, times its length; zero without a speed.
    fn over(&mut self, from_s: f64, to_s: f64) -> f64 {
        while self.next < self.speed.len() && self.speed[self.next].0 < from_s {
            self.next += 1;
        }
        let (mut sum, mut count) = (0.0, 0.0);
        for point in &self.speed[self.next..] {
            if point.0 > to_s && count > 0.0 {
                break;
            }
            sum += point.1;
            count += 1.0;
            if point.0 > to_s {
                break;
            }
        }
        if count > 0.0 {
            sum / count * (to_s - from_s)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// There and back, many turns each way, up to 300 rad/s.
    fn motion(t: f64) -> f64 {
        0.5 + 100.0 * (3.0 * t).sin()
    }

    fn speed(t: f64) -> f64 {
        300.0 * (3.0 * t).cos()
    }

    /// A signal every `period_s`.
    fn sampled(period_s: f64, of: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        let times = (0..400).map(|k| f64::from(k) * period_s);
        times.map(|t| (t, of(t))).collect()
    }

    fn largest_error(angle: &[(f64, f64)]) -> f64 {
        crate::numerics::statistics::largest(angle.iter().map(|(t, a)| a - motion(*t)))
    }

    #[test]
    fn a_wrapped_angle_becomes_the_motion_from_any_start_of_the_turn() {
        for from in [0.0, -0.5 * TAU] {
            let wrapped = sampled(0.002, |t| (motion(t) - from).rem_euclid(TAU) + from);
            assert!(largest_error(&continuous(wrapped, &[])) < 1e-9);
        }
    }

    #[test]
    fn where_half_a_turn_passes_between_samples_the_speed_tells_the_way() {
        let wrapped = || sampled(0.015, |t| motion(t).rem_euclid(TAU));
        assert!(largest_error(&continuous(wrapped(), &sampled(0.015, speed))) < 1e-9);
        assert!(largest_error(&continuous(wrapped(), &[])) > 1.0);
    }

    #[test]
    fn what_does_not_wrap_stays_as_it_is() {
        let long = sampled(0.015, motion);
        assert_eq!(continuous(long.clone(), &sampled(0.015, speed)), long);
        let small = sampled(0.01, |t| 2.0 * t.sin());
        assert_eq!(continuous(small.clone(), &[]), small);
        assert!(continuous(vec![], &[]).is_empty());
    }
}

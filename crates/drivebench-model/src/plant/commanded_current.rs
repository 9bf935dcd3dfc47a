//! A commanded current as the input of a run: what the motor had of it, and by how much the speed shows it late.

use crate::numerics::statistics::{mean, median, median_step};
use crate::sample::{Channel, Run};
use crate::signal::Point;

/// The steps of the commanded current `(time, A)`: a command that repeats the one before is none.
pub(super) fn steps(commands: &[Point]) -> Vec<Point> {
    let mut steps: Vec<Point> = Vec::new();
    for command in commands {
        if steps.last().is_none_or(|last| last.1.to_bits() != command.1.to_bits()) {
            steps.push(*command);
        }
    }
    steps
}

/// The current `(time, A)` that the motor had: between the steps the measured one from halfway to its neighbours, less its mean at
/// rest before the first step. A current loop holds it below its command while the back-EMF rises, and a limit of the drive far
/// below. Without measured ones the command.
pub(super) fn applied(run: &Run, steps: &[Point]) -> Vec<Point> {
    let measured: Vec<Point> = run.points(Channel::Current).collect();
    let ends = steps.iter().skip(1).map(|step| step.0).chain([f64::INFINITY]);
    let between = |from_s: f64, to_s: f64| {
        let first = measured.partition_point(|point| point.0 <= from_s);
        let last = measured.partition_point(|point| point.0 <= to_s);
        // The first one may be within the transient, and the last within that of the next step.
        measured.get(first + 1..last.saturating_sub(1)).unwrap_or_default()
    };
    let offset_a = match steps {
        [(from_s, 0.0), next, ..] => {
            let at_rest = between(*from_s, next.0).iter().map(|point| point.1);
            Some(mean(&at_rest.collect::<Vec<f64>>())).filter(|offset| offset.is_finite())
        }
        _ => None,
    };
    let mut applied = Vec::new();
    for (&(from_s, amperes), to_s) in steps.iter().zip(ends) {
        let settled = between(from_s, to_s);
        let first = settled.first().map_or(amperes, |first| first.1 - offset_a.unwrap_or(0.0));
        applied.push((from_s, first));
        applied.extend(settled.windows(2).map(|pair| {
            (f64::midpoint(pair[0].0, pair[1].0), pair[1].1 - offset_a.unwrap_or(0.0))
        }));
    }
    applied
}

/// The time after the steps of the current at which the speed changes its slope, s: where the lines before and after a step
/// intersect, the median over the half of the steps with the largest changes; zero where too few steps show one.
pub(super) fn lag_s(run: &Run, steps: &[Point]) -> f64 {
    let speed: Vec<Point> = run.points(Channel::Speed).collect();
    let period_s = median_step(&speed.iter().map(|point| point.0).collect::<Vec<f64>>());
    let at = |time_s: f64| speed.partition_point(|point| point.0 <= time_s);
    let ends: Vec<usize> = steps.iter().map(|step| at(step.0)).chain([speed.len()]).collect();
    let kink = |(ends, step): (&[usize], &Point)| {
        let &[begin, middle, end] = ends else { return None };
        let before = line(one_way(&speed[begin.max(middle.saturating_sub(8))..middle]));
        // The samples behind the step are still on the line before it for as long as the lag is. Beyond a lag of three the line would
        // begin within the change itself.
        let from = (middle + 3).min(end);
        let after = line(one_way(&speed[from..end.min(from + 8)]));
        let ((level, slope), (next_level, next_slope)) = before.zip(after)?;
        let kink_s = (level - next_level) / (next_slope - slope) - step.0;
        let is_near = kink_s.abs() <= 3.0 * period_s;
        is_near.then(|| ((next_slope - slope).abs(), kink_s))
    };
    let mut found: Vec<(f64, f64)> =
        ends.windows(3).zip(steps.iter().skip(1)).filter_map(kink).collect();
    if found.len() < 6 {
        return 0.0;
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(found.len().div_ceil(2));
    median(&found.into_iter().map(|(_, kink_s)| kink_s).collect::<Vec<f64>>())
}

/// The points, where all are on one side of standstill: the friction reverses there.
fn one_way(points: &[Point]) -> &[Point] {
    let reverses = points.windows(2).any(|pair| pair[0].1 * pair[1].1 <= 0.0);
    if reverses { &[] } else { points }
}

/// Level at time zero and slope of the line through these points.
fn line(points: &[Point]) -> Option<(f64, f64)> {
    if points.len() < 4 {
        return None;
    }
    let (time_s, value): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
    let (middle_s, middle) = (mean(&time_s), mean(&value));
    let moment = |values: &[f64], about: f64| -> f64 {
        time_s.iter().zip(values).map(|(t, v)| (t - middle_s) * (v - about)).sum()
    };
    let slope = moment(&value, middle) / moment(&time_s, middle_s);
    Some((middle - slope * middle_s, slope))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::run_of;
    use crate::sample::Origin;

    /// A triangle of speed under alternating currents, shown late.
    fn run(lag_s: f64) -> (Run, Vec<Point>) {
        let steps: Vec<Point> =
            (0..20).map(|k| (0.3 * f64::from(k), if k % 2 == 0 { 2.0 } else { -2.0 })).collect();
        let times: Vec<f64> = (0..600).map(|row| 0.01 * f64::from(row) + 0.0037).collect();
        let triangle = |time_s: f64| {
            let phase = (time_s / 0.3).rem_euclid(2.0);
            100.0 * (1.0 - (phase - 1.0).abs()) - 50.0
        };
        let speed = times.iter().map(|time_s| triangle(time_s - lag_s)).collect();
        let current = times
            .iter()
            .map(|time_s| if (time_s / 0.3).rem_euclid(2.0) < 1.0 { 2.0 } else { -1.5 });
        let current = current.collect();
        let columns = [
            (Channel::Speed, speed, Origin::Measured),
            (Channel::Current, current, Origin::Measured),
        ];
        (run_of("r", times, columns), steps)
    }

    #[test]
    fn the_lag_is_where_the_lines_of_the_speed_intersect() {
        for lag_s in [0.0, 0.004, 0.017] {
            let (run, steps) = run(lag_s);
            let found_s = super::lag_s(&run, &steps);
            assert!((found_s - lag_s).abs() < 1e-6, "{lag_s}: {found_s}");
        }
        let (run, steps) = run(0.004);
        assert_eq!(super::lag_s(&run, &steps[..4]).to_bits(), 0.0_f64.to_bits());
    }

    #[test]
    fn the_current_between_the_steps_is_the_measured_one() {
        let (run, mut commands) = run(0.0);
        // The same command again is no step.
        commands.insert(1, (0.1, 2.0));
        let steps = steps(&commands);
        assert_eq!(steps.len(), 20);
        let applied = applied(&run, &steps);
        assert!(steps.iter().all(|step| applied.iter().any(|own| (own.0 - step.0).abs() < 1e-12)));
        for (time_s, amperes) in applied {
            let expected = if (time_s / 0.3 + 1e-9).rem_euclid(2.0) < 1.0 { 2.0 } else { -1.5 };
            assert!((amperes - expected).abs() < 1e-12, "{time_s}");
        }
        assert_eq!(super::applied(&run.without(Channel::Current), &steps), steps);
    }
}

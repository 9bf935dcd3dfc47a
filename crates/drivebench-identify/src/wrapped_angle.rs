//! Phase unwrapping of an angle that jumps back after a turn, or at the end of a counter.
//!
//! The range of the counter is the jump plus the motion between the two samples (from the speed before and after), if every jump
//! gives the same range and all values are within it.

use std::f64::consts::TAU;

use drivebench_model::numerics::statistics::{extent, largest, mean, median};
use drivebench_model::sample::{Channel, Run, RunError};

/// Whether the step between two samples exceeds half of the span: a jump of the counter.
fn is_jump(step: f64, span: f64) -> bool {
    step.abs() > 0.5 * span
}

/// The run with an unwrapped angle and a note on it; unchanged without jumps.
pub(super) fn complete(run: &Run) -> Result<Run, RunError> {
    let points: Vec<(f64, f64)> = run.points(Channel::Angle).collect();
    let mut completed = run.clone();
    let Some(sawtooth) = Sawtooth::find(&points) else {
        if looks_wrapped(&points) {
            completed.notes.push(
                "angle_rad jumps within one turn, but moves too far between samples to be unwrapped: \
                 record faster, or map a speed"
                    .to_owned(),
            );
        }
        return Ok(completed);
    };
    let mut column = run.column(Channel::Angle).unwrap_or_default().to_vec();
    let (mut turns, mut before) = (0.0, f64::NAN);
    for cell in column.iter_mut().filter(|cell| cell.is_finite()) {
        if before.is_finite() {
            turns -= ((*cell - before) / sawtooth.range).round();
        }
        before = *cell;
        *cell += turns * sawtooth.range;
    }
    completed.set_column(Channel::Angle, column, run.origin(Channel::Angle))?;
    completed.notes.push(sawtooth.sentence());
    Ok(completed)
}

struct Sawtooth {
    range: f64,
    jumps: usize,
}

impl Sawtooth {
    fn find(points: &[(f64, f64)]) -> Option<Self> {
        let span = span(points);
        let pairs = points.windows(2);
        let steps: Vec<(f64, f64)> = pairs.map(|w| (w[1].0 - w[0].0, w[1].1 - w[0].1)).collect();
        let is_jump = |step: &&(f64, f64)| is_jump(step.1, span);
        let sizes = steps.iter().map(|step| step.1.abs()).filter(|step| *step > 1e-9 * span);
        let finest = sizes.fold(f64::INFINITY, f64::min);
        // Noise of the last digit is not a sawtooth.
        if span <= 16.0 * finest {
            return None;
        }
        let mut ranges = Vec::new();
        for (k, step) in steps.iter().enumerate().filter(|(_, step)| is_jump(step)) {
            let neighbours = [k.checked_sub(1), Some(k + 1)].into_iter();
            let neighbours = neighbours.filter_map(|k| steps.get(k?)).filter(|step| !is_jump(step));
            let speeds: Vec<f64> = neighbours.map(|step| step.1 / step.0).collect();
            if speeds.is_empty() {
                return None;
            }
            // The motion between the samples is opposite to the jump.
            ranges.push(step.1.abs() - step.1.signum() * mean(&speeds) * step.0);
        }
        let range = median(&ranges);
        let longest = largest(steps.iter().filter(|step| !is_jump(step)).map(|step| step.1));
        let agree = ranges.iter().all(|found| (found - range).abs() < 0.1 * range);
        let is_full = range > 0.98 * span && range < span + 1.5 * longest;
        (agree && is_full).then(|| Self {
            range: if is_near(range, TAU) {
                TAU
            } else {
                // A counter's range is a whole number of counts.
                (range / finest).round() * finest
            },
            jumps: ranges.len(),
        })
    }

    fn sentence(&self) -> String {
        let Self { range, jumps } = self;
        let hint = if is_near(*range, TAU) {
            "one turn"
        } else if is_near(*range, 360.0) {
            "360: if these are degrees, map them with *0.0174532925"
        } else {
            "not one turn: a counter's range, if the scale to radians is right"
        };
        format!("angle_rad jumped back {jumps} times after {range:.6} rad ({hint}): unwrapped")
    }
}

/// Within a hundredth.
fn is_near(range: f64, known: f64) -> bool {
    (range / known - 1.0).abs() < 0.01
}

fn span(points: &[(f64, f64)]) -> f64 {
    let (least, most) = extent(points.iter().map(|point| point.1));
    most - least
}

/// All values within one turn, most of it used, and steps of more than half of it.
fn looks_wrapped(points: &[(f64, f64)]) -> bool {
    let span = span(points);
    let jumps = points.windows(2).filter(|w| is_jump(w[1].1 - w[0].1, TAU));
    span > 0.85 * TAU && span < 1.01 * TAU && jumps.count() > 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{changed, every, run_of};
    use drivebench_model::sample::Origin;

    fn run(angle: impl Fn(f64) -> f64, period_s: f64) -> Run {
        let times = every(period_s, 1000.0 * period_s);
        let angles = times.iter().map(|t| angle(*t)).collect();
        run_of(times, [(Channel::Angle, angles)])
    }

    /// There and back, several turns each way.
    fn motion(t: f64) -> f64 {
        1.0 + 40.0 * (3.0 * t).sin()
    }

    fn largest_error(run: &Run, offset: f64) -> f64 {
        largest(run.points(Channel::Angle).map(|(t, angle)| angle - motion(t) - offset))
    }

    #[test]
    fn turns_and_a_counter_are_made_continuous() {
        for (range, from) in [(TAU, 0.0), (TAU, -0.5 * TAU), (65.536, 0.0)] {
            let wrap = move |t: f64| {
                let wrapped = (motion(t) - from).rem_euclid(range) + from;
                // A counter's resolution: a thousandth of a radian, or of a turn.
                (wrapped * 1000.0).floor() / 1000.0
            };
            let completed = complete(&run(wrap, 0.002)).unwrap();
            let first = completed.points(Channel::Angle).next().unwrap().1;
            let offset = first - motion(0.0);
            assert!(largest_error(&completed, offset) < 3e-3, "{range} {from}");
            assert_eq!(completed.origin(Channel::Angle), Origin::Measured);
            assert!(completed.notes[0].contains("unwrapped"));
            assert_eq!(completed.notes[0].contains("one turn)"), range < 7.0);
        }
    }

    #[test]
    fn missing_cells_do_not_lose_a_turn() {
        let hole = |row, angle| if row % 9 == 7 { f64::NAN } else { angle };
        let turns = run(|t| motion(t).rem_euclid(TAU), 0.001);
        let completed = complete(&changed(&turns, Channel::Angle, hole)).unwrap();
        assert!(largest_error(&completed, 0.0) < 1e-9);
        assert!(completed.column(Channel::Angle).unwrap()[7].is_nan());
    }

    #[test]
    fn an_angle_that_does_not_wrap_stays_as_it_is() {
        let noise = |t: f64| ((t * 1e7).sin() * 1e4).fract();
        let flicker = |t: f64| ((t * 977.0).sin() * 0.7).round() * 7.7e-4;
        for angle in [&motion as &dyn Fn(f64) -> f64, &noise, &flicker, &|_| 2.0] {
            let run = run(angle, 0.002);
            let completed = complete(&run).unwrap();
            assert!(completed.notes.is_empty(), "{:?}", completed.notes);
            assert_eq!(completed.column(Channel::Angle), run.column(Channel::Angle));
        }
        // Between a third and two thirds of a turn from sample to sample: either way round.
        let fast = |t: f64| (300.0 * t + 40.0 * (3.0 * t).sin()).rem_euclid(TAU);
        let run = run(fast, 0.01);
        let completed = complete(&run).unwrap();
        assert_eq!(completed.column(Channel::Angle), run.column(Channel::Angle));
        assert!(completed.notes[0].contains("record faster"));
    }
}

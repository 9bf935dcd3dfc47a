//! Speed from the measured angle, where a run has no speed of its own.
//!
//! At each sample the slope of a parabola through the neighbours on either side (Savitzky and Golay 1964, on the true
//! stamps). The span is chosen from the data: the shortest whose error from the angle's resolution stays below a share
//! of the largest speed, so that a fine encoder is hardly smoothed and a coarse one is not differentiated count by count.

use super::wrapped_angle;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::Scenario;
use drivebench_model::sample::{Channel, Origin, Run, RunError};

/// The run with a speed column derived from its unwrapped angle and a note on the method. A run with a measured speed, or without
/// an angle, is not changed.
pub fn complete(run: &Run) -> Result<Run, RunError> {
    let mut completed = wrapped_angle::complete(run)?;
    let points: Vec<(f64, f64)> = completed.points(Channel::Angle).collect();
    if run.points(Channel::Speed).next().is_some() || points.len() < 5 {
        return Ok(completed);
    }
    let side = side(&points);
    let speeds = slopes(&points, side);
    let mut column = vec![f64::NAN; run.rows()];
    let cells = run.column(Channel::Angle).unwrap_or_default();
    let rows = (0..run.rows()).filter(|row| cells[*row].is_finite());
    for (row, speed) in rows.zip(&speeds) {
        column[row] = *speed;
    }
    let span_ms = 1e3 * (points[2 * side].0 - points[0].0);
    completed.set_column(Channel::Speed, column, Origin::Derived)?;
    completed.notes.push(format!(
        "speed_rad_s derived from angle_rad: slope of a parabola through {} samples ({span_ms:.3} ms)",
        2 * side + 1
    ));
    Ok(completed)
}

/// Length of the Savitzky-Golay window in samples, where a scenario's speed was derived here.
pub fn span(scenario: &Scenario) -> Option<usize> {
    let points = &scenario.angle;
    if scenario.speed_rad_s.len() < 5 || points.len() < 5 {
        return None;
    }
    let side = side(points);
    let slopes = slopes(points, side);
    let fastest = largest(&slopes);
    let (mut compared, mut same) = (0_usize, true);
    for (time_s, speed) in scenario.sample_time_s.iter().zip(&scenario.speed_rad_s) {
        let at = points.partition_point(|point| point.0 < *time_s);
        #[expect(clippy::float_cmp, reason = "a stamp of the same row")]
        let is_same = points.get(at).is_some_and(|point| point.0 == *time_s);
        if is_same && speed.is_finite() {
            compared += 1;
            same &= (slopes[at] - speed).abs() <= 1e-9 * fastest;
        }
    }
    (same && compared > 0).then_some(2 * side + 1)
}

/// Standard deviation of the derived speed by the quantisation of the angle, which is zero at rest.
pub fn noise(scenario: &Scenario) -> Option<f64> {
    let span = span(scenario)?;
    let points = &scenario.angle;
    Some(resolution(points) / 12f64.sqrt() * gain((span / 2) as f64, period_s(points)))
}

/// Standard deviation of the difference quotient of the angle from sample to sample by its quantisation, zero without an angle.
pub(super) fn noise_of_counts(scenario: &Scenario) -> f64 {
    let points = &scenario.angle;
    if points.len() < 5 {
        return 0.0;
    }
    resolution(points) / 6f64.sqrt() / period_s(points)
}

fn period_s(points: &[(f64, f64)]) -> f64 {
    (points[points.len() - 1].0 - points[0].0) / (points.len() - 1) as f64
}

/// Standard deviation of the slope over 2 m + 1 equidistant points of unit variance.
fn gain(m: f64, period_s: f64) -> f64 {
    (3.0 / (m * (m + 1.0) * (2.0 * m + 1.0))).sqrt() / period_s
}

/// Neighbours on either side, at most twelve, so that the motion is not smoothed.
fn side(points: &[(f64, f64)]) -> usize {
    let most = usize::min(12, (points.len() - 1) / 2);
    let period_s = period_s(points);
    // The longest window, with the least quantisation noise, gives the largest speed, of which the noise may be 0.2 %.
    let largest = largest(slopes(points, most));
    let error = resolution(points) / 12f64.sqrt();
    (1..most).find(|side| error * gain(*side as f64, period_s) <= 0.002 * largest).unwrap_or(most)
}

/// Resolution: smallest change of the angle.
fn resolution(points: &[(f64, f64)]) -> f64 {
    let largest = largest(points.iter().map(|point| point.1));
    let steps = points
        .windows(2)
        .map(|pair| (pair[1].1 - pair[0].1).abs())
        .filter(|step| *step > 1e-12 * largest);
    steps.fold(f64::INFINITY, f64::min).min(largest)
}

/// Slope at every point; at the ends the parabola of the nearest whole span.
pub(super) fn slopes(points: &[(f64, f64)], side: usize) -> Vec<f64> {
    let last = points.len() - 1;
    (0..=last)
        .map(|at| {
            let centre = at.clamp(side, last - side);
            slope(&points[centre - side..=centre + side], points[at].0)
        })
        .collect()
}

/// Slope at `at_s` of the least-squares parabola, through polynomials orthogonal on the points.
fn slope(points: &[(f64, f64)], at_s: f64) -> f64 {
    let n = points.len() as f64;
    let centre = points.iter().map(|point| point.0).sum::<f64>() / n;
    let scale = points[points.len() - 1].0 - points[0].0;
    let x = |point: &(f64, f64)| (point.0 - centre) / scale;
    let sum = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>();
    let s2 = sum(&|p| x(p) * x(p));
    let (mean_square, skew) = (s2 / n, sum(&|p| x(p).powi(3)) / s2);
    let second = |x: f64| x * x - skew * x - mean_square;
    let norm = sum(&|p| second(x(p)).powi(2));
    let first = sum(&|p| x(p) * p.1) / s2;
    let curvature =
        if points.len() > 2 && norm > 0.0 { sum(&|p| second(x(p)) * p.1) / norm } else { 0.0 };
    let at = (at_s - centre) / scale;
    (first + curvature * (2.0 * at - skew)) / scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{changed, put, run_of};

    fn run(angle: impl Fn(f64) -> f64, jitter: f64) -> Run {
        let times: Vec<f64> =
            (0..500).map(|k| f64::from(k) * 0.001 + jitter * f64::from(k % 3)).collect();
        let angles = times.iter().map(|t| angle(*t)).collect();
        run_of(times, [(Channel::Angle, angles)])
    }

    #[test]
    fn a_parabola_is_differentiated_exactly() {
        let run = complete(&run(|t| 2.0 * t - 3.0 * t * t, 2e-4)).unwrap();
        for (time_s, speed) in run.points(Channel::Speed) {
            let exact = 2.0 - 6.0 * time_s;
            assert!((speed - exact).abs() < 1e-9, "{time_s} {speed}");
        }
        assert_eq!(run.origin(Channel::Speed), Origin::Derived);
        assert!(run.notes[0].contains("derived from angle_rad"));
    }

    #[test]
    fn only_a_coarse_encoder_is_smoothed() {
        let wave = |t: f64| (20.0 * t).sin();
        let speed = |t: f64| 20.0 * (20.0 * t).cos();
        for (counts_per_rad, spread) in [(500.0, 0.3), (1e6, 0.01)] {
            let coarse = move |t: f64| (wave(t) * counts_per_rad).round() / counts_per_rad;
            let completed = complete(&run(coarse, 0.0)).unwrap();
            let errors = completed.points(Channel::Speed);
            let squares = errors.map(|(t, found)| (found - speed(t)).powi(2));
            let rms = (squares.sum::<f64>() / 500.0).sqrt();
            assert!(rms < spread, "{counts_per_rad}: {rms}");
        }
    }

    #[test]
    fn a_measured_speed_stays_and_missing_angles_stay_missing() {
        let mut with_speed = run(|t| t, 0.0);
        put(&mut with_speed, Channel::Speed, vec![7.0; 500]);
        let same = complete(&with_speed).unwrap();
        let kept = same.column(Channel::Speed).unwrap()[3];
        assert_eq!(kept.to_bits(), 7f64.to_bits());
        let hole = |row, angle| if row == 10 { f64::NAN } else { angle };
        let holes = changed(&run(|t| t, 0.0), Channel::Angle, hole);
        let speeds = complete(&holes).unwrap();
        let speeds = speeds.column(Channel::Speed).unwrap();
        assert!(speeds[10].is_nan() && (speeds[11] - 1.0).abs() < 1e-9);
    }
}

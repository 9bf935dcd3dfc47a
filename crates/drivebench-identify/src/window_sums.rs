//! Integrals of the signals over short windows, for both balances in integral form: for starting values and for the check of
//! columns.
//!
//! `int u = R int i + L (i_b - i_a) + Ke int w` and `Kt int i = J (w_b - w_a) + Mc int sgn w`, current and speed by the
//! trapezoidal rule. Coarse sampling biases the estimates by some per cent.

use std::ops::Range;

use drivebench_model::numerics::statistics::median_step;

/// Length of a window, in times of response.
pub(super) const WINDOW_RESPONSES: f64 = 0.75;

/// First and last row of each window of this length, or of three samples at least.
pub(super) fn windows(times: &[f64], window_s: f64) -> Vec<Range<usize>> {
    let fewest = 3;
    let mut windows = Vec::new();
    // No window contains a pause, in which the signals are not known: its integral would dominate all others.
    let longest_s = f64::max(window_s, 3.0 * median_step(times));
    let mut begin = 0;
    while begin + fewest <= times.len() {
        let mut end = begin + fewest - 1;
        while end + 1 < times.len() && times[end] - times[begin] < window_s {
            end += 1;
        }
        let pause = (begin..end).rfind(|row| times[row + 1] - times[*row] > longest_s);
        if let Some(row) = pause {
            begin = row + 1;
            continue;
        }
        windows.push(begin..end);
        begin = end;
    }
    windows
}

/// Integral by the trapezoid from the first to the last row of a window.
pub(super) fn trapezoid(times: &[f64], values: &[f64], window: &Range<usize>) -> f64 {
    let area = |k: usize| 0.5 * (values[k] + values[k + 1]) * (times[k + 1] - times[k]);
    window.clone().map(area).sum()
}

pub(super) struct Sums {
    pub(super) length_s: f64,
    pub(super) voltage: f64,
    pub(super) current: f64,
    pub(super) current_step: f64,
    /// Integral of the speed.
    pub(super) angle: f64,
    pub(super) speed_step: f64,
    /// Sign of the speed where it is the same over the whole window and beyond the dead zone, else zero.
    pub(super) direction: f64,
}

impl Sums {
    /// `voltage`: integral of the voltage; `zone`: speed below which there is no direction, rad/s.
    pub(super) fn over(
        window: &Range<usize>,
        times: &[f64],
        voltage: f64,
        [current, speed]: [&[f64]; 2],
        zone: f64,
    ) -> Self {
        let (begin, end) = (window.start, window.end);
        let speeds = &speed[begin..=end];
        let forward = speeds.iter().all(|w| *w > zone);
        let backward = speeds.iter().all(|w| *w < -zone);
        Self {
            length_s: times[end] - times[begin],
            voltage,
            current: trapezoid(times, current, window),
            current_step: current[end] - current[begin],
            angle: trapezoid(times, speed, window),
            speed_step: speed[end] - speed[begin],
            direction: f64::from(i8::from(forward) - i8::from(backward)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_window_spans_a_pause_and_slow_rows_are_none() {
        let times = (0..1000).filter(|row| !(400..800).contains(row));
        let times: Vec<f64> = times.map(|row| 1e-3 * f64::from(row)).collect();
        let found = windows(&times, 0.03);
        let length_s = |window: &Range<usize>| times[window.end] - times[window.start];
        assert!(found.len() >= 18 && found.iter().all(|window| length_s(window) < 0.05));
        let slow: Vec<f64> = (0..100).map(|row| 0.1 * f64::from(row)).collect();
        assert!(windows(&slow, 0.03).len() > 40);
    }
}

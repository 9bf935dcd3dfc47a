//! Signals over time: zero-order hold, linear interpolation, and the modulating functions of Shinbrot (*Trans. ASME* 79, 1957):
//! means under a smooth test function, by which no signal is differentiated.
//!
//! ```text
//! (time, value) --zero-order hold--> held, pieces, integral, mean
//!               --interpolation----> line, line_with_ends (end values hold), line_across (short gaps only)
//! sample times ---window-----------> weights of a mean and of a mean rate: trapezoid times (1 - s^2)^4
//! ```

/// Time and value, in the order of time.
pub type Point = (f64, f64);

/// The value of the last point at or before an instant; `None` before the first.
#[inline]
pub fn held(points: &[Point], time_s: f64) -> Option<f64> {
    points.partition_point(|point| point.0 <= time_s).checked_sub(1).map(|at| points[at].1)
}

/// The points from the one whose value holds at an instant on.
#[inline]
pub fn holding_since(points: &[Point], time_s: f64) -> &[Point] {
    &points[points.partition_point(|point| point.0 <= time_s).saturating_sub(1)..]
}

/// The zero-order hold between two instants as `(length, value)`; the first value also holds before its point.
#[inline]
pub fn pieces(points: &[Point], from_s: f64, to_s: f64) -> impl Iterator<Item = Point> + Clone {
    let first = points.partition_point(|point| point.0 <= from_s).max(1) - 1;
    let from_first = points.iter().enumerate().skip(first);
    from_first.take_while(move |(index, point)| *index == 0 || point.0 < to_s).filter_map(
        move |(index, &(at_s, value))| {
            let next_s = points.get(index + 1).map_or(to_s, |next| next.0.min(to_s));
            let begin_s = if index == 0 { from_s } else { at_s.max(from_s) };
            (next_s > begin_s).then_some((next_s - begin_s, value))
        },
    )
}

/// Integral of a held signal.
#[inline]
pub fn integral(points: &[Point], from_s: f64, to_s: f64) -> f64 {
    pieces(points, from_s, to_s).fold(0.0, |sum, (length_s, value)| sum + value * length_s)
}

/// Mean of a held signal.
#[inline]
pub fn mean(points: &[Point], from_s: f64, to_s: f64) -> f64 {
    integral(points, from_s, to_s) / (to_s - from_s)
}

/// Linear interpolation; NaN outside the points.
pub fn line(points: &[Point], time_s: f64) -> f64 {
    let after = points.partition_point(|point| point.0 < time_s);
    match (after.checked_sub(1).map(|at| points[at]), points.get(after)) {
        (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (time_s - a.0) / (b.0 - a.0),
        (None, Some(first)) if first.0 <= time_s => first.1,
        _ => f64::NAN,
    }
}

/// As [`line()`]; the end values hold beyond the ends.
pub fn line_with_ends(points: &[Point], time_s: f64) -> f64 {
    match (points.first(), points.last()) {
        (Some(first), _) if time_s <= first.0 => first.1,
        (_, Some(last)) if time_s > last.0 => last.1,
        _ => line(points, time_s),
    }
}

/// As [`line()`], but not across gaps longer than `longest_gap_s`; a stamp of a point gives its value to the bit.
pub fn line_across(points: &[Point], time_s: f64, longest_gap_s: f64) -> f64 {
    let after = points.partition_point(|point| point.0 < time_s);
    match (after.checked_sub(1), points.get(after)) {
        #[expect(clippy::float_cmp, reason = "a stamp of the same row")]
        (_, Some(exact)) if exact.0 == time_s => exact.1,
        (Some(before), Some(next)) if next.0 - points[before].0 <= longest_gap_s => {
            line(points, time_s)
        }
        _ => f64::NAN,
    }
}

/// Quadrature weights of one window of half-length `H`: the trapezoidal rule at the true sample times, times the test function
/// `psi = (1 - s^2)^4`, `s = (t - middle)/H`, and times `-dpsi/dt`.
///
/// Integration by parts: the mean of a rate `dx/dt` under `psi` is that of `x` under `-dpsi/dt`, as `psi` vanishes at the ends.
#[derive(Clone, Debug)]
pub struct Window {
    begin: usize,
    pub middle_s: f64,
    weights: Vec<f64>,
    rates: Vec<f64>,
}

impl Window {
    /// Over the samples `begin..=end`.
    pub fn new(times: &[f64], begin: usize, end: usize) -> Self {
        let middle_s = 0.5 * (times[begin] + times[end]);
        let half_s = 0.5 * (times[end] - times[begin]);
        let (mut weights, mut rates, mut total) = (Vec::new(), Vec::new(), 0.0);
        for sample in begin..=end {
            let before = times[sample.saturating_sub(1).max(begin)];
            let after = times[(sample + 1).min(end)];
            let s = (times[sample] - middle_s) / half_s;
            let q = 1.0 - s * s;
            let share = 0.5 * (after - before);
            total += share * q.powi(4);
            weights.push(share * q.powi(4));
            // -dpsi/dt = -(dpsi/ds)/H.
            rates.push(share * 8.0 * s * q.powi(3) / half_s);
        }
        for weight in weights.iter_mut().chain(&mut rates) {
            *weight /= total;
        }
        Self { begin, middle_s, weights, rates }
    }

    /// The integral over the samples `begin..=end` (the test function is one), over `nominal_s`: noise of the ends makes the same error
    /// of a rate in a window of any length.
    pub fn integral(times: &[f64], begin: usize, end: usize, nominal_s: f64) -> Self {
        let weight = |sample: usize| {
            let before = times[sample.saturating_sub(1).max(begin)];
            let after = times[(sample + 1).min(end)];
            0.5 * (after - before) / nominal_s
        };
        let rate = |sample: usize| {
            f64::from(i8::from(sample == end) - i8::from(sample == begin)) / nominal_s
        };
        Self {
            begin,
            middle_s: 0.5 * (times[begin] + times[end]),
            weights: (begin..=end).map(weight).collect(),
            rates: (begin..=end).map(rate).collect(),
        }
    }

    pub fn mean(&self, values: &[f64]) -> f64 {
        self.mean_of(|sample| values[sample])
    }

    pub fn mean_of(&self, value: impl Fn(usize) -> f64) -> f64 {
        self.sum(&self.weights, value)
    }

    pub fn mean_rate(&self, values: &[f64]) -> f64 {
        self.sum(&self.rates, |sample| values[sample])
    }

    fn sum(&self, weights: &[f64], value: impl Fn(usize) -> f64) -> f64 {
        weights.iter().zip(self.begin..).map(|(weight, sample)| weight * value(sample)).sum()
    }

    /// Every interval between two samples, by its first, and its share of the mean.
    pub fn intervals(&self) -> impl Iterator<Item = (usize, f64)> {
        let pairs = self.weights.windows(2).zip(self.begin..);
        pairs.map(|(pair, interval)| (interval, 0.5 * (pair[0] + pair[1])))
    }

    /// Standard deviations of a mean and of a mean rate under white noise of unit variance: the norms of their weights.
    pub fn gains(&self) -> (f64, f64) {
        let norm = |weights: &[f64]| weights.iter().map(|w| w * w).sum::<f64>().sqrt();
        (norm(&self.weights), norm(&self.rates))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEPS: [Point; 3] = [(0.0, 5.0), (1.0, 6.0), (2.0, 7.0)];

    #[test]
    fn a_held_signal_is_read_in_pieces_from_any_instant_on() {
        assert_eq!([-1.0, 0.0, 1.5].map(|t| held(&STEPS, t)), [None, Some(5.0), Some(6.0)]);
        let between = |from_s, to_s| pieces(&STEPS, from_s, to_s).collect::<Vec<_>>();
        assert_eq!(between(0.5, 2.5), [(0.5, 5.0), (1.0, 6.0), (0.5, 7.0)]);
        assert_eq!(between(-1.0, 0.5), [(1.5, 5.0)]);
        assert_eq!(between(2.5, 2.5), []);
        assert!((mean(&STEPS, 0.5, 2.5) - 6.0).abs() < 1e-15);
        assert!((integral(&STEPS, -2.0, -1.0) - 5.0).abs() < 1e-15);
    }

    #[test]
    fn an_integral_has_the_change_and_the_area_of_its_window() {
        let times = [0.0, 0.1, 0.3, 0.6, 1.0];
        let window = Window::integral(&times, 1, 4, 2.0);
        let line: Vec<f64> = times.iter().map(|t| 3.0 * t - 1.0).collect();
        assert!((window.mean_rate(&line) - 3.0 * 0.9 / 2.0).abs() < 1e-15);
        assert!((window.mean(&line) - 0.9 * (3.0 * 0.55 - 1.0) / 2.0).abs() < 1e-15);
        assert!((window.middle_s - 0.55).abs() < 1e-15);
        // The noise of the ends, whatever the length.
        let short = Window::integral(&times, 0, 1, 2.0);
        assert!((window.gains().1 - short.gains().1).abs() < 1e-15);
    }

    #[test]
    fn between_two_points_lies_their_line() {
        assert!((line(&STEPS, 0.25) - 5.25).abs() < 1e-15);
        assert!(line(&STEPS, -0.1).is_nan() && line(&STEPS, 2.1).is_nan());
        assert!((line_with_ends(&STEPS, -1.0) - 5.0).abs() < 1e-15);
        assert!((line_with_ends(&STEPS, 9.0) - 7.0).abs() < 1e-15);
        assert!(line_with_ends(&[], 0.0).is_nan());
    }

    #[test]
    fn a_window_gives_the_mean_and_the_slope_of_a_line() {
        let times: Vec<f64> = (0..41).map(|k| 0.1 * f64::from(k)).collect();
        let window = Window::new(&times, 10, 30);
        let values: Vec<f64> = times.iter().map(|t| 3.0 - 2.0 * t).collect();
        assert!((window.mean(&values) - (3.0 - 2.0 * window.middle_s)).abs() < 1e-12);
        assert!((window.mean_rate(&values) + 2.0).abs() < 1e-3);
    }
}

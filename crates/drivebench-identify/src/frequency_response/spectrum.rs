//! Fourier integrals over a stretch of a record: exact for an input with a zero-order hold, a sum over the samples for the measured
//! outputs.
//!
//! Input and output are then transforms of signals in continuous time. Their ratio is the response of the plant alone:
//! neither the hold of the sampled input nor its delay is in it.

use std::f64::consts::TAU;

use nalgebra::Complex;

use drivebench_model::signal::Point;

/// `exp(-j 2 pi f t)` from one instant to the next, cheap where the steps are equal.
struct Phasor {
    frequency_rad_s: f64,
    time_s: f64,
    value: Complex<f64>,
    step_s: f64,
    turn: Complex<f64>,
    since: usize,
}

impl Phasor {
    fn at(frequency_hz: f64, time_s: f64) -> Self {
        let frequency_rad_s = TAU * frequency_hz;
        Self {
            frequency_rad_s,
            time_s,
            value: Complex::cis(-frequency_rad_s * time_s),
            step_s: f64::NAN,
            turn: Complex::new(1.0, 0.0),
            since: 0,
        }
    }

    fn moved_to(&mut self, time_s: f64) -> Complex<f64> {
        let step_s = time_s - self.time_s;
        self.since += 1;
        // A product of 256 factors keeps 14 digits.
        if self.since >= 256 {
            self.since = 0;
            self.value = Complex::cis(-self.frequency_rad_s * time_s);
        } else {
            // Decimal stamps round equal steps to the nanosecond; there is none before the first.
            let differs = (step_s - self.step_s).abs() >= 1e-9;
            if differs || self.step_s.is_nan() {
                self.step_s = step_s;
                self.turn = Complex::cis(-self.frequency_rad_s * step_s);
            }
            self.value *= self.turn;
        }
        self.time_s = time_s;
        self.value
    }
}

/// Of a signal that holds each value until the next: `sum v (e(t0) - e(t1)) / (j w)`. The mean is left out; `pieces` end
/// where the next begins, the last at `end_s`.
pub(super) fn of_held(pieces: &[Point], end_s: f64, frequency_hz: f64) -> Complex<f64> {
    let Some(&(begin_s, _)) = pieces.first() else { return Complex::new(0.0, 0.0) };
    let mean = drivebench_model::signal::mean(pieces, begin_s, end_s);
    let mut phasor = Phasor::at(frequency_hz, begin_s);
    let mut from = phasor.value;
    let mut sum = Complex::new(0.0, 0.0);
    for (index, &(_, value)) in pieces.iter().enumerate() {
        let until_s = pieces.get(index + 1).map_or(end_s, |next| next.0);
        let until = phasor.moved_to(until_s);
        sum += (from - until) * (value - mean);
        from = until;
    }
    sum / Complex::new(0.0, phasor.frequency_rad_s)
}

/// Of samples, by the trapezoidal rule without the mean, over missing cells. For a band-limited signal the sum over equal steps is
/// exact.
pub(super) fn of_samples(time_s: &[f64], values: &[f64], frequency_hz: f64) -> Complex<f64> {
    let mut known = time_s.iter().zip(values).filter(|(_, value)| value.is_finite());
    let all = known.clone();
    let Some((&begin_s, &first)) = known.next() else { return Complex::new(0.0, 0.0) };
    let count = all.clone().count() as f64;
    let mean = all.map(|(_, value)| value).sum::<f64>() / count;
    let mut phasor = Phasor::at(frequency_hz, begin_s);
    let mut before = (begin_s, phasor.value * (first - mean));
    let mut sum = Complex::new(0.0, 0.0);
    for (&time_s, value) in known {
        let now = phasor.moved_to(time_s) * (value - mean);
        sum += (before.1 + now) * (0.5 * (time_s - before.0));
        before = (time_s, now);
    }
    sum
}

/// Intersample correction: factors from the sums over the samples of current and speed to the transforms of the continuous signals, at
/// a frequency over the sampling rate.
///
/// Under a zero-order hold the current consists of straight lines and the speed of parabolas, where the period is short against the
/// time constants: `(sin x / x)^2` and `(sin x / x)^3 / cos x` with `x = pi f / fs` are then exact.
pub(super) fn between_samples(share: f64) -> [f64; 2] {
    let x = std::f64::consts::PI * share;
    let sinc = if x > 0.0 { x.sin() / x } else { 1.0 };
    [sinc.powi(2), sinc.powi(3) / x.cos()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: Complex<f64>, expected: Complex<f64>, within: f64) {
        assert!((found - expected).norm() < within, "{found} {expected}");
    }

    #[test]
    fn a_pulse_has_the_transform_of_the_textbook() {
        // 1 from 1 s to 3 s of 5 s: without its mean of 0.4.
        let pieces = [(0.0, 0.0), (1.0, 1.0), (3.0, 0.0)];
        for hertz in [0.07, 0.3, 1.9, 12.0] {
            let w = TAU * hertz;
            let j = Complex::new(0.0, w);
            let of = |from: f64, to: f64| (Complex::cis(-w * from) - Complex::cis(-w * to)) / j;
            let expected = of(1.0, 3.0) - of(0.0, 5.0) * 0.4;
            near(of_held(&pieces, 5.0, hertz), expected, 1e-12);
        }
    }

    #[test]
    fn equal_and_unequal_steps_agree_and_a_hole_is_bridged() {
        let signal = |t: f64| (-(t - 2.0) * (t - 2.0)).exp();
        let even: Vec<f64> = (0..=4000).map(|n| 1e-3 * f64::from(n)).collect();
        let uneven: Vec<f64> = even.iter().map(|t| t + 2e-4 * (40.0 * t).sin()).collect();
        let values = |times: &[f64]| times.iter().map(|t| signal(*t)).collect::<Vec<_>>();
        let mut holed = values(&even);
        holed[1500] = f64::NAN;
        for hertz in [0.25, 1.0, 2.25] {
            let expected = of_samples(&even, &values(&even), hertz);
            near(of_samples(&uneven, &values(&uneven), hertz), expected, 2e-4);
            near(of_samples(&even, &holed, hertz), expected, 1e-5);
        }
        let none = of_samples(&[0.0, 1.0, 2.0], &[f64::NAN; 3], 1.0);
        for empty in [of_samples(&[], &[], 1.0), none] {
            near(empty, Complex::new(0.0, 0.0), 1e-300);
        }
    }
}

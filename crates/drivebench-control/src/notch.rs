//! Notch filter of second order.
//!
//! `H(s) = (s^2 + 2 d z w s + w^2) / (s^2 + 2 z w s + w^2)`; sampled by the bilinear transform prewarped at
//! `w` (Bristow-Johnson, Cookbook formulae for audio equalizer biquad filter coefficients, 1998): its gain at `w`
//! is `d` at every sampling rate.

use nalgebra::Complex;
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Notch {
    pub frequency_hz: f64,
    /// Of its poles, z: half of the relative width.
    pub damping_ratio: f64,
    /// Gain at its frequency, d.
    pub depth: f64,
}

/// `y = b0 x + b1 x1 + b2 x2 - a1 y1 - a2 y2`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Coefficients {
    b: [f64; 3],
    a: [f64; 2],
}

impl Notch {
    /// Up to 0.4 of the sampling rate.
    pub fn is_realisable(frequency_hz: f64, period_s: f64) -> bool {
        frequency_hz > 0.0 && frequency_hz * period_s <= 0.4
    }

    pub fn text(&self) -> String {
        let (hertz, damping, percent) = (self.frequency_hz, self.damping_ratio, 100.0 * self.depth);
        format!("notch at {hertz:.1} Hz (damping {damping:.2}, leaves {percent:.0} %)")
    }

    /// Group delay at zero frequency, s.
    pub fn lag_s(&self) -> f64 {
        2.0 * self.damping_ratio * (1.0 - self.depth) / (std::f64::consts::TAU * self.frequency_hz)
    }

    /// `None` where the sampling is too slow: then it is a gain of one.
    fn coefficients(&self, period_s: f64) -> Option<Coefficients> {
        if !Self::is_realisable(self.frequency_hz, period_s) {
            return None;
        }
        let (sin, cos) = (std::f64::consts::TAU * self.frequency_hz * period_s).sin_cos();
        let poles = self.damping_ratio * sin;
        let zeros = self.depth * poles;
        let scale = 1.0 / (1.0 + poles);
        Some(Coefficients {
            b: [1.0 + zeros, -2.0 * cos, 1.0 - zeros].map(|each| scale * each),
            a: [-2.0 * cos, 1.0 - poles].map(|each| scale * each),
        })
    }

    /// Frequency response at `1/z`.
    pub(super) fn response(&self, back: Complex<f64>, period_s: f64) -> Complex<f64> {
        let Some(Coefficients { b, a }) = self.coefficients(period_s) else {
            return Complex::new(1.0, 0.0);
        };
        let zeros = (back * b[2] + b[1]) * back + b[0];
        let poles = (back * a[1] + a[0]) * back + 1.0;
        zeros / poles
    }
}

/// State of a notch: its last two inputs and outputs, the newest first. A constant signal passes unchanged whatever the
/// coefficients become.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NotchMemory {
    pub(super) inputs: [f64; 2],
    pub(super) outputs: [f64; 2],
}

impl NotchMemory {
    pub(super) const fn at_rest() -> Self {
        Self { inputs: [0.0; 2], outputs: [0.0; 2] }
    }

    /// The output for this input; the state stays.
    pub(super) fn output(&self, notch: Option<&Notch>, input: f64, period_s: f64) -> f64 {
        let Some(Coefficients { b, a }) = notch.and_then(|notch| notch.coefficients(period_s))
        else {
            return input;
        };
        let [x1, x2] = self.inputs;
        let [y1, y2] = self.outputs;
        b[0] * input + b[1] * x1 + b[2] * x2 - a[0] * y1 - a[1] * y2
    }

    pub(super) fn pass(&mut self, notch: Option<&Notch>, input: f64, period_s: f64) -> f64 {
        let output = self.output(notch, input, period_s);
        self.inputs = [input, self.inputs[0]];
        self.outputs = [output, self.outputs[0]];
        output
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_close;

    const NOTCH: Notch = Notch { frequency_hz: 22.0, damping_ratio: 0.3, depth: 0.1 };

    /// Amplitude of a sine after the notch.
    fn amplitude(frequency_hz: f64, period_s: f64) -> f64 {
        let mut memory = NotchMemory::at_rest();
        let sine = |n: u32| (std::f64::consts::TAU * frequency_hz * f64::from(n) * period_s).sin();
        let outputs = (0..40_000).map(|n| memory.pass(Some(&NOTCH), sine(n), period_s));
        let square = outputs.skip(20_000).map(|output| output * output).sum::<f64>();
        (2.0 * square / 20_000.0).sqrt()
    }

    #[test]
    fn its_gain_is_that_of_its_formula_at_every_rate() {
        for period_s in [0.01, 0.002, 1e-4] {
            assert_close(amplitude(22.0, period_s), 0.1, 1e-4);
            let back = Complex::new(0.0, -std::f64::consts::TAU * 9.0 * period_s).exp();
            assert_close(amplitude(9.0, period_s), NOTCH.response(back, period_s).norm(), 1e-3);
        }
        // Far from warping it is the formula in s.
        let s = Complex::new(0.0, 9.0 / 22.0);
        let continuous: Complex<f64> = (s * s + s * 0.06 + 1.0) / (s * s + s * 0.6 + 1.0);
        assert_close(amplitude(9.0, 1e-4), continuous.norm(), 1e-3);
        // The slope of the phase at zero frequency is its lag.
        let phase = NOTCH.response(Complex::new(0.0, -0.5 * 1e-4).exp(), 1e-4).arg();
        assert_close(-phase / 0.5, NOTCH.lag_s(), 1e-6);
    }

    #[test]
    fn a_constant_passes_a_changing_notch() {
        let mut memory = NotchMemory::at_rest();
        for _ in 0..3000 {
            memory.pass(Some(&NOTCH), 3.0, 0.002);
        }
        let wider = Notch { frequency_hz: 40.0, damping_ratio: 0.7, ..NOTCH };
        for (notch, period_s) in [(&wider, 0.002), (&NOTCH, 0.004), (&NOTCH, 0.1)] {
            assert_close(memory.output(Some(notch), 3.0, period_s), 3.0, 1e-9);
        }
        assert_close(memory.output(None, 7.0, 0.002), 7.0, 1e-12);
    }
}

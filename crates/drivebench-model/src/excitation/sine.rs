//! Sines as chords: one frequency, and the exponential sweep (chirp; Farina, 108th AES Convention, 2000), whose frequency grows
//! by the same factor in equal times.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::error::{Refusal, amplitude, duration, finite, refuse_unless};
use super::piece::chords;
use super::{Excitation, Target};

/// A sine that begins at zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sine {
    /// Peak, V.
    pub amplitude_v: f64,
    pub frequency_hz: f64,
    pub seconds: f64,
}

impl Excitation for Sine {
    fn check(&self) -> Result<(), Refusal> {
        amplitude("amplitude_v", self.amplitude_v)?;
        duration("seconds", self.seconds)?;
        let good = self.frequency_hz > 0.0 && self.frequency_hz * self.seconds <= 1e4;
        let allowed = "more than 0 Hz, at most 10000 periods in its part";
        refuse_unless(good, "frequency_hz", self.frequency_hz, allowed)
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        // 128 chords per period: none is farther from the sine than (pi / 128)^2 / 2 = 3e-4 of the amplitude, and the peaks are met.
        let chord_s = 1.0 / (self.frequency_hz * 128.0);
        // A last chord without length would have no slope.
        let ends = (1..)
            .map(|index| f64::from(index) * chord_s)
            .take_while(|end_s| *end_s < self.seconds - 1e-6 * chord_s);
        let sine_v = |time_s: f64| self.amplitude_v * (TAU * self.frequency_hz * time_s).sin();
        Target::Voltage(chords(ends, self.seconds, sine_v))
    }
}

/// An exponential sweep about an offset: `f(t) = from (to/from)^(t/T)`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chirp {
    /// Peak from the offset, V; the slew limit reduces it at high frequencies.
    pub amplitude_v: f64,
    pub from_hz: f64,
    pub to_hz: f64,
    pub seconds: f64,
    /// Middle, V: one that keeps the shaft turning one way leaves its friction out of the response.
    #[serde(default)]
    pub offset_v: f64,
}

impl Chirp {
    /// Integral of the frequency from 0 to `time_s`: the phase over 2 pi.
    fn periods_at(&self, time_s: f64) -> f64 {
        let log_ratio = (self.to_hz / self.from_hz).ln();
        self.from_hz * self.seconds / log_ratio * (log_ratio * time_s / self.seconds).exp_m1()
    }

    /// The inverse of [`Self::periods_at`], s.
    fn time_of(&self, periods: f64) -> f64 {
        let log_ratio = (self.to_hz / self.from_hz).ln();
        let growth = periods * log_ratio / (self.from_hz * self.seconds);
        self.seconds / log_ratio * growth.ln_1p()
    }
}

impl Excitation for Chirp {
    fn check(&self) -> Result<(), Refusal> {
        amplitude("amplitude_v", self.amplitude_v)?;
        duration("seconds", self.seconds)?;
        finite("offset_v", self.offset_v)?;
        let good = self.from_hz > 0.0 && self.from_hz * self.seconds >= 1.0;
        refuse_unless(good, "from_hz", self.from_hz, "more than 0 Hz, a period in its part")?;
        let good = self.to_hz >= 1.01 * self.from_hz && self.periods_at(self.seconds) <= 2e4;
        let allowed = "more than from_hz, at most 20000 periods in its part";
        refuse_unless(good, "to_hz", self.to_hz, allowed)
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        // 64 chords per period: none is farther from the sine than (pi / 64)^2 / 2 = 1.2e-3 of the amplitude.
        let ends = (1..).map(|chord| self.time_of(f64::from(chord) / 64.0));
        // A last chord without length would have no slope.
        let last_s = self.seconds - 1e-3 / (self.to_hz * 64.0);
        let ends = ends.take_while(|end_s| *end_s < last_s);
        let value_v =
            |time_s: f64| self.offset_v + self.amplitude_v * (TAU * self.periods_at(time_s)).sin();
        Target::Voltage(chords(ends, self.seconds, value_v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chirp(from_hz: f64, to_hz: f64, seconds: f64) -> Chirp {
        Chirp { amplitude_v: 5.0, from_hz, to_hz, seconds, offset_v: 20.0 }
    }

    #[test]
    fn chords_are_close_to_the_curve() {
        let sweep = chirp(0.5, 32.0, 12.0);
        let sine = Sine { amplitude_v: 12.0, frequency_hz: 0.4, seconds: 3.3 };
        let sine_v = |t: f64| 12.0 * (TAU * 0.4 * t).sin();
        let sweep_v = |t: f64| 20.0 + 5.0 * (TAU * sweep.periods_at(t)).sin();
        let curves: [&dyn Fn(f64) -> f64; 2] = [&sine_v, &sweep_v];
        let rows = [(sine.target(), 3.3, 12.0 * 3.1e-4), (sweep.target(), 12.0, 5.0 * 1.3e-3)];
        for ((target, end_s, within_v), exact_v) in rows.into_iter().zip(curves) {
            let Target::Voltage(pieces) = target else {
                panic!("a sine is a voltage");
            };
            for piece in &pieces {
                let middle_s = 0.5 * (piece.start_s + piece.end_s);
                let off_v = piece.value(middle_s) - exact_v(middle_s);
                assert!(off_v.abs() < within_v, "{middle_s} s: {off_v} V");
            }
            assert!((pieces.last().unwrap().end_s - end_s).abs() < 1e-12);
        }
    }

    #[test]
    fn the_frequency_grows_by_the_same_factor_in_equal_times() {
        let sweep = chirp(0.5, 32.0, 12.0);
        sweep.check().unwrap();
        // Six octaves in 12 s; the mean frequency of an octave is its first over ln 2.
        for octave in 0..6_i32 {
            let at = |octave: i32| sweep.periods_at(2.0 * f64::from(octave));
            let expected = 0.5 * 2.0_f64.powi(octave) * 2.0 / std::f64::consts::LN_2;
            assert!(((at(octave + 1) - at(octave)) / expected - 1.0).abs() < 1e-12);
        }
        for periods in [0.1, 3.0, 200.0] {
            assert!((sweep.periods_at(sweep.time_of(periods)) / periods - 1.0).abs() < 1e-12);
        }
        for (from_hz, to_hz) in [(2.0, 1.0), (0.0, 1.0), (0.1, 1.0), (1.0, 1e6)] {
            assert!(chirp(from_hz, to_hz, 5.0).check().is_err());
        }
        assert!(chirp(f64::NAN, 1.0, 5.0).check().is_err());
        assert!(chirp(1.0, f64::INFINITY, 5.0).check().is_err());
    }
}

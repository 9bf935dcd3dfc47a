//! A sine about an offset whose frequency grows by the same factor in equal times: a logarithmic sweep.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::error::{Refusal, amplitude, duration, finite, refuse_unless};
use super::{Card, Excitation, Piece, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chirp {
    /// Peak beside the offset, V; at high frequencies what the slew limit leaves of it.
    pub amplitude_v: f64,
    pub from_hz: f64,
    pub to_hz: f64,
    pub seconds: f64,
    /// Middle, V: one that keeps the shaft turning one way leaves its friction out of the response.
    #[serde(default)]
    pub offset_v: f64,
}

/// Chords per period: none is farther from the sine than (pi / 64)^2 / 2 = 1.2e-3 of the amplitude.
const CHORDS: f64 = 64.0;
const MOST_PERIODS: f64 = 2e4;

impl Chirp {
    pub const CARD: Card = Card {
        id: "chirp",
        example: "chirp = { amplitude_v = 6.0, from_hz = 0.5, to_hz = 40.0, seconds = 20.0, offset_v = 20.0 }",
    };

    /// Periods that have passed; `f(t) = from (to/from)^(t/T)`.
    fn periods_at(&self, time_s: f64) -> f64 {
        let octaves = (self.to_hz / self.from_hz).ln();
        self.from_hz * self.seconds / octaves * (octaves * time_s / self.seconds).exp_m1()
    }

    /// When so many periods have passed, s.
    fn time_of(&self, periods: f64) -> f64 {
        let octaves = (self.to_hz / self.from_hz).ln();
        let grown = periods * octaves / (self.from_hz * self.seconds);
        self.seconds / octaves * grown.ln_1p()
    }
}

impl Excitation for Chirp {
    fn check(&self) -> Result<(), Refusal> {
        amplitude("amplitude_v", self.amplitude_v)?;
        duration("seconds", self.seconds)?;
        finite("offset_v", self.offset_v)?;
        refuse_unless(
            self.from_hz > 0.0 && self.from_hz * self.seconds >= 1.0,
            "from_hz",
            self.from_hz,
            "more than 0 Hz, a period in its part",
        )?;
        refuse_unless(
            self.to_hz >= 1.01 * self.from_hz && self.periods_at(self.seconds) <= MOST_PERIODS,
            "to_hz",
            self.to_hz,
            "more than from_hz, at most 20000 periods in its part",
        )
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        let value_v =
            |time_s: f64| self.offset_v + self.amplitude_v * (TAU * self.periods_at(time_s)).sin();
        let mut pieces: Vec<Piece> = Vec::new();
        let mut from = (0.0, self.offset_v);
        let ends = (1..).map(|chord| self.time_of(f64::from(chord) / CHORDS));
        // A sliver at the end would have no slope to speak of.
        let last_s = self.seconds - 1e-3 / (self.to_hz * CHORDS);
        let ends = ends.take_while(|end_s| *end_s < last_s);
        for end_s in ends.chain(std::iter::once(self.seconds)) {
            let to = (end_s, value_v(end_s));
            pieces.push(Piece::line(from, to));
            from = to;
        }
        Target::Voltage(pieces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frequency_grows_by_the_same_factor_in_equal_times() {
        let chirp = Chirp {
            amplitude_v: 5.0,
            from_hz: 0.5,
            to_hz: 32.0,
            seconds: 12.0,
            offset_v: 20.0,
        };
        chirp.check().unwrap();
        // Six octaves in 12 s; the mean frequency of an octave is its first over ln 2.
        for octave in 0..6_i32 {
            let at = |octave: i32| chirp.periods_at(2.0 * f64::from(octave));
            let periods = at(octave + 1) - at(octave);
            let expected = 0.5 * 2.0_f64.powi(octave) * 2.0 / std::f64::consts::LN_2;
            assert!((periods / expected - 1.0).abs() < 1e-12);
        }
        for periods in [0.1, 3.0, 200.0] {
            let again = chirp.periods_at(chirp.time_of(periods));
            assert!((again / periods - 1.0).abs() < 1e-12);
        }
        let Target::Voltage(pieces) = chirp.target() else {
            panic!("a chirp is a voltage");
        };
        for piece in &pieces {
            let middle_s = 0.5 * (piece.start_s + piece.end_s);
            let exact_v = 20.0 + 5.0 * (TAU * chirp.periods_at(middle_s)).sin();
            assert!((piece.value(middle_s) - exact_v).abs() < 5.0 * 1.3e-3);
        }
        assert!((pieces.last().unwrap().end_s - 12.0).abs() < 1e-12);
    }

    #[test]
    fn a_sweep_that_goes_down_or_never_ends_is_refused() {
        let chirp = |from_hz, to_hz, seconds| Chirp {
            amplitude_v: 5.0,
            from_hz,
            to_hz,
            seconds,
            offset_v: 0.0,
        };
        for (from_hz, to_hz, seconds) in [
            (2.0, 1.0, 5.0),
            (0.0, 1.0, 5.0),
            (0.1, 1.0, 5.0),
            (1.0, 1e6, 5.0),
            (f64::NAN, 1.0, 5.0),
            (1.0, f64::INFINITY, 5.0),
        ] {
            assert!(chirp(from_hz, to_hz, seconds).check().is_err());
        }
    }
}

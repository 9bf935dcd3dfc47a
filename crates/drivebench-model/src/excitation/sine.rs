//! A sine that begins at zero.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::error::{Refusal, amplitude, duration, refuse_unless};
use super::{Card, Excitation, Piece, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sine {
    /// Peak, V.
    pub amplitude_v: f64,
    pub frequency_hz: f64,
    pub seconds: f64,
}

/// Chords per period: none is farther from the sine than (pi / 128)^2 / 2 = 3e-4 of the amplitude, and the peaks are met.
const CHORDS: f64 = 128.0;

impl Sine {
    pub const CARD: Card = Card {
        id: "sine",
        example: "sine = { amplitude_v = 12.0, frequency_hz = 0.4, seconds = 5.0 }",
    };
}

impl Excitation for Sine {
    fn check(&self) -> Result<(), Refusal> {
        amplitude("amplitude_v", self.amplitude_v)?;
        duration("seconds", self.seconds)?;
        let periods = self.frequency_hz * self.seconds;
        refuse_unless(
            self.frequency_hz > 0.0 && periods <= 1e4,
            "frequency_hz",
            self.frequency_hz,
            "more than 0 Hz, at most 10000 periods in its part",
        )
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        let chord_s = 1.0 / (self.frequency_hz * CHORDS);
        // A sliver at the end would have no slope to speak of.
        let ends = (1..)
            .map(|index| f64::from(index) * chord_s)
            .take_while(|end_s| *end_s < self.seconds - 1e-6 * chord_s)
            .chain(std::iter::once(self.seconds));
        let sine_v = |time_s: f64| self.amplitude_v * (TAU * self.frequency_hz * time_s).sin();
        let mut pieces: Vec<Piece> = Vec::new();
        let mut start_s = 0.0;
        for end_s in ends {
            let corner = |time_s| (time_s, sine_v(time_s));
            pieces.push(Piece::line(corner(start_s), corner(end_s)));
            start_s = end_s;
        }
        Target::Voltage(pieces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chords_are_close_to_the_sine() {
        let sine = Sine {
            amplitude_v: 12.0,
            frequency_hz: 0.4,
            seconds: 3.3,
        };
        let Target::Voltage(pieces) = sine.target() else {
            panic!("a sine is a voltage");
        };
        let mut worst_v: f64 = 0.0;
        for piece in &pieces {
            let middle_s = 0.5 * (piece.start_s + piece.end_s);
            let exact_v = 12.0 * (TAU * 0.4 * middle_s).sin();
            worst_v = worst_v.max((piece.value(middle_s) - exact_v).abs());
        }
        assert!(worst_v < 12.0 * 3.1e-4, "{worst_v}");
        assert!((pieces.last().unwrap().end_s - 3.3).abs() < 1e-12);
    }
}

//! A small pseudo-random binary voltage on top of steps, staircases and ramps.

use serde::{Deserialize, Serialize};

use super::Piece;
use super::error::{Refusal, amplitude, clock};
use super::lfsr::Lfsr;

/// Keeps current and speed moving during holds: without it resistance and back-EMF cannot be separated there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dither {
    /// Peak of the square wave, V.
    pub amplitude_v: f64,
    /// Time between possible changes of sign, s; 0.02 to 0.05 suits small motors.
    pub clock_s: f64,
    #[serde(default)]
    pub seed: u64,
}

impl Dither {
    fn check(&self, seconds: f64) -> Result<(), Refusal> {
        amplitude("dither.amplitude_v", self.amplitude_v)?;
        clock("dither.clock_s", self.clock_s, seconds)
    }

    /// The pieces, cut at every change of sign, with the dither added.
    pub(super) fn add(&self, pieces: &[Piece]) -> Vec<Piece> {
        let mut register = Lfsr::new(self.seed);
        let mut tick = 1_u32;
        let mut volts = self.next_v(&mut register);
        let mut dithered = Vec::new();
        for piece in pieces {
            let mut start_s = piece.start_s;
            while start_s < piece.end_s {
                let mut change_s = f64::from(tick) * self.clock_s;
                if change_s <= start_s {
                    tick += 1;
                    volts = self.next_v(&mut register);
                    change_s = f64::from(tick) * self.clock_s;
                }
                let end_s = piece.end_s.min(change_s.max(start_s.next_up()));
                let [from_v, to_v] = [start_s, end_s].map(|at_s| piece.value(at_s) + volts);
                dithered.push(Piece::line((start_s, from_v), (end_s, to_v)));
                start_s = end_s;
            }
        }
        dithered
    }

    fn next_v(&self, register: &mut Lfsr) -> f64 {
        self.amplitude_v * if register.next_bit() { 1.0 } else { -1.0 }
    }
}

pub(super) fn check_dither(dither: Option<&Dither>, seconds: f64) -> Result<(), Refusal> {
    dither.map_or(Ok(()), |dither| dither.check(seconds))
}

pub(super) fn dithered(dither: Option<&Dither>, pieces: Vec<Piece>) -> Vec<Piece> {
    match dither {
        Some(dither) => dither.add(&pieces),
        None => pieces,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_dither_stands_on_the_ramp_and_changes_only_at_its_clock() {
        let ramp = [Piece::line((0.0, -4.0), (1.0, 4.0))];
        let dither = Dither { amplitude_v: 0.5, clock_s: 0.03, seed: 5 };
        let pieces = dither.add(&ramp);
        assert_eq!(pieces.len(), 34);
        let mut ups = 0;
        for (index, piece) in pieces.iter().enumerate() {
            let over = piece.from_v - ramp[0].value(piece.start_s);
            let off = (piece.start_s - index as f64 * 0.03).abs() + (over.abs() - 0.5).abs();
            assert!(off < 1e-12, "{piece:?}");
            ups += usize::from(over > 0.0);
        }
        assert!((8..=26).contains(&ups), "{ups} of 34 are up");
    }
}

//! Pseudo-random levels at a fixed clock.

use serde::{Deserialize, Serialize};

use super::error::{Refusal, amplitude, clock, duration, finite, refuse_unless};
use super::lfsr::Lfsr;
use super::piece::{cut, levels};
use super::{Card, Excitation, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prbs {
    /// Farthest level from the offset, V.
    pub amplitude_v: f64,
    /// Time between possible changes, s; about the mechanical time constant or less.
    pub clock_s: f64,
    pub seconds: f64,
    #[serde(default)]
    pub seed: u64,
    /// Middle of the levels, V.
    #[serde(default)]
    pub offset_v: f64,
    /// Number of levels, equally far apart: 2 is the plain binary sequence.
    #[serde(default = "two")]
    pub levels: u16,
}

const fn two() -> u16 {
    2
}

impl Prbs {
    pub const CARD: Card = Card {
        id: "prbs",
        example: "prbs = { amplitude_v = 8.0, clock_s = 0.04, seconds = 4.0, seed = 1, offset_v = 0.0, levels = 5 }",
    };

    fn count(&self) -> u32 {
        // `check` keeps it under 1e6; the cast saturates in any case.
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a checked duration over a checked clock is between 1 and 1e6"
        )]
        let count = (self.seconds / self.clock_s).ceil() as u32;
        count.max(1)
    }
}

impl Excitation for Prbs {
    fn check(&self) -> Result<(), Refusal> {
        amplitude("amplitude_v", self.amplitude_v)?;
        duration("seconds", self.seconds)?;
        clock("clock_s", self.clock_s, self.seconds)?;
        finite("offset_v", self.offset_v)?;
        refuse_unless(
            (2..=1_000).contains(&self.levels),
            "levels",
            f64::from(self.levels),
            "2 to 1000",
        )
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        let mut register = Lfsr::new(self.seed);
        let last = f64::from(self.levels - 1);
        let values_v = (0..self.count()).map(|_| {
            let share = 2.0 * f64::from(register.next_level(self.levels)) / last - 1.0;
            self.offset_v + self.amplitude_v * share
        });
        let mut pieces = levels(self.clock_s, values_v);
        // The last clock may be cut short, or rounding may leave a hair: the length is what was asked for.
        cut(&mut pieces, self.seconds);
        Target::Voltage(pieces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(prbs: &Prbs) -> Vec<f64> {
        match prbs.target() {
            Target::Voltage(pieces) => pieces.iter().map(|piece| piece.from_v).collect(),
            Target::Coast => vec![],
        }
    }

    #[test]
    fn binary_and_five_level_sequences_have_their_levels() {
        let mut prbs = Prbs {
            amplitude_v: 4.0,
            clock_s: 0.01,
            seconds: 5.0,
            seed: 3,
            offset_v: 1.0,
            levels: 2,
        };
        let binary = values(&prbs);
        assert_eq!(binary.len(), 500);
        let is_one_of_two = |v: &f64| (v - 5.0).abs() < 1e-12 || (v + 3.0).abs() < 1e-12;
        assert!(binary.iter().all(is_one_of_two));
        prbs.levels = 5;
        let found = values(&prbs).into_iter().map(|volts| format!("{volts:.3}"));
        let found: std::collections::BTreeSet<String> = found.collect();
        assert!(
            found
                .iter()
                .eq(["-1.000", "-3.000", "1.000", "3.000", "5.000"]),
            "{found:?}"
        );
    }

    #[test]
    fn another_seed_is_another_sequence() {
        let of = |seed| {
            values(&Prbs {
                amplitude_v: 1.0,
                clock_s: 0.1,
                seconds: 5.0,
                seed,
                offset_v: 0.0,
                levels: 3,
            })
        };
        assert_eq!(of(1), of(1));
        assert_ne!(of(1), of(2));
    }
}

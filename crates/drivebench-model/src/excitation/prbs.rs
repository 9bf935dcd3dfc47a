//! Pseudo-random binary and multi-level sequences at a fixed clock (Ljung, *System Identification*, 1999, section 13.3).

use serde::{Deserialize, Serialize};

use super::error::{Refusal, amplitude, clock, duration, finite, refuse_unless};
use super::lfsr::Lfsr;
use super::piece::{cut, levels};
use super::{Excitation, Target};
use crate::numerics::count::whole;

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

impl Excitation for Prbs {
    fn check(&self) -> Result<(), Refusal> {
        amplitude("amplitude_v", self.amplitude_v)?;
        duration("seconds", self.seconds)?;
        clock("clock_s", self.clock_s, self.seconds)?;
        finite("offset_v", self.offset_v)?;
        let good = (2..=1_000).contains(&self.levels);
        refuse_unless(good, "levels", f64::from(self.levels), "2 to 1000")
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        let mut register = Lfsr::new(self.seed);
        let last = f64::from(self.levels - 1);
        let count = whole((self.seconds / self.clock_s).ceil()).max(1);
        let values_v = (0..count).map(|_| {
            let share = 2.0 * f64::from(register.next_level(self.levels)) / last - 1.0;
            self.offset_v + self.amplitude_v * share
        });
        let mut pieces = levels(self.clock_s, values_v);
        // The last clock may be cut short, or the length be off by rounding.
        cut(&mut pieces, self.seconds);
        Target::Voltage(pieces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    fn levels_of(levels: u16, seed: u64) -> Vec<f64> {
        let prbs =
            Prbs { amplitude_v: 4.0, clock_s: 0.01, seconds: 5.0, seed, offset_v: 1.0, levels };
        match prbs.target() {
            Target::Voltage(pieces) => pieces.iter().map(|piece| piece.from_v).collect(),
            Target::Coast => vec![],
        }
    }

    #[test]
    fn sequences_have_their_levels_and_differ_by_their_seed() {
        for (levels, expected) in [(2, &[-3.0, 5.0][..]), (5, &[-3.0, -1.0, 1.0, 3.0, 5.0])] {
            let mut found = levels_of(levels, 3);
            assert_eq!(found.len(), 500);
            found.sort_by(f64::total_cmp);
            found.dedup_by(|a, b| (*a - *b).abs() < 1e-12);
            let alike = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12;
            assert!(found.len() == usize::from(levels) && found.iter().zip(expected).all(alike));
        }
        assert_eq!(levels_of(3, 1), levels_of(3, 1));
        assert_ne!(levels_of(3, 1), levels_of(3, 2));
    }
}

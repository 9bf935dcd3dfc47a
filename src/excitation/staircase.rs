//! Equal steps from one voltage to another.

use serde::{Deserialize, Serialize};

use super::dither::{check_dither, dithered};
use super::error::{Refusal, duration, finite, refuse_unless};
use super::piece::levels;
use super::{Card, Dither, Excitation, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Staircase {
    pub from_v: f64,
    pub to_v: f64,
    /// Number of levels, both ends included.
    pub levels: u16,
    /// How long each one lasts, the slew to it included, s.
    pub hold_s: f64,
    pub dither: Option<Dither>,
}

impl Staircase {
    pub const CARD: Card = Card {
        id: "staircase",
        name: "staircase",
        shows: "steady points over the speed range: the friction curve, dead zones, saturation",
        example: "staircase = { from_v = -12.0, to_v = 12.0, levels = 9, hold_s = 0.5 }",
    };
}

impl Excitation for Staircase {
    fn check(&self) -> Result<(), Refusal> {
        finite("from_v", self.from_v)?;
        finite("to_v", self.to_v)?;
        refuse_unless(
            (2..=10_000).contains(&self.levels),
            "levels",
            f64::from(self.levels),
            "2 to 10000",
        )?;
        duration("hold_s", self.hold_s)?;
        check_dither(self.dither.as_ref(), self.duration_s())
    }

    fn duration_s(&self) -> f64 {
        f64::from(self.levels) * self.hold_s
    }

    fn target(&self) -> Target {
        let last = f64::from(self.levels - 1);
        let values_v = (0..self.levels).map(|level| {
            let share = f64::from(level) / last;
            self.from_v * (1.0 - share) + self.to_v * share
        });
        let pieces = levels(self.hold_s, values_v);
        Target::Voltage(dithered(self.dither.as_ref(), pieces))
    }
}

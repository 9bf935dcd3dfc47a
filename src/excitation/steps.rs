//! Levels given one by one.

use serde::{Deserialize, Serialize};

use super::dither::{check_dither, dithered};
use super::error::{Refusal, duration, finite, refuse_unless};
use super::piece::levels;
use super::{Card, Dither, Excitation, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Steps {
    /// In the order in which they come, V.
    pub levels_v: Vec<f64>,
    /// How long each one lasts, the slew to it included, s.
    pub hold_s: f64,
    pub dither: Option<Dither>,
}

impl Steps {
    pub const CARD: Card = Card {
        id: "steps",
        name: "steps",
        shows: "resistance, back-EMF and inertia; both signs part Coulomb friction from an offset",
        example: "steps = { levels_v = [12.0, 0.0, -12.0], hold_s = 0.5, dither = { amplitude_v = 2.0, clock_s = 0.03, seed = 1 } }",
    };
}

impl Excitation for Steps {
    fn check(&self) -> Result<(), Refusal> {
        let count = self.levels_v.len();
        refuse_unless(
            (1..=10_000).contains(&count),
            "number of levels_v",
            count as f64,
            "1 to 10000",
        )?;
        for level_v in &self.levels_v {
            finite("levels_v", *level_v)?;
        }
        duration("hold_s", self.hold_s)?;
        check_dither(self.dither.as_ref(), self.duration_s())
    }

    fn duration_s(&self) -> f64 {
        self.levels_v.len() as f64 * self.hold_s
    }

    fn target(&self) -> Target {
        let pieces = levels(self.hold_s, self.levels_v.iter().copied());
        Target::Voltage(dithered(self.dither.as_ref(), pieces))
    }
}

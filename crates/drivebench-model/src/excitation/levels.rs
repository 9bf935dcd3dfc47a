//! Levels and lines with a dither on top: steps given one by one, equal steps, a straight line.

use serde::{Deserialize, Serialize};

use super::dither::{check_dither, dithered};
use super::error::{Refusal, duration, finite, refuse_unless};
use super::piece::levels;
use super::{Dither, Excitation, Piece, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Steps {
    /// In the order in which they come, V.
    pub levels_v: Vec<f64>,
    /// How long each one lasts, the slew to it included, s.
    pub hold_s: f64,
    pub dither: Option<Dither>,
}

impl Excitation for Steps {
    fn check(&self) -> Result<(), Refusal> {
        let count = self.levels_v.len();
        let good = (1..=10_000).contains(&count);
        refuse_unless(good, "number of levels_v", count as f64, "1 to 10000")?;
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

/// Equal steps from one voltage to another.
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

impl Excitation for Staircase {
    fn check(&self) -> Result<(), Refusal> {
        finite("from_v", self.from_v)?;
        finite("to_v", self.to_v)?;
        let good = (2..=10_000).contains(&self.levels);
        refuse_unless(good, "levels", f64::from(self.levels), "2 to 10000")?;
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

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    pub from_v: f64,
    pub to_v: f64,
    pub seconds: f64,
    pub dither: Option<Dither>,
}

impl Excitation for Ramp {
    fn check(&self) -> Result<(), Refusal> {
        finite("from_v", self.from_v)?;
        finite("to_v", self.to_v)?;
        duration("seconds", self.seconds)?;
        check_dither(self.dither.as_ref(), self.seconds)
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        let pieces = vec![Piece::line((0.0, self.from_v), (self.seconds, self.to_v))];
        Target::Voltage(dithered(self.dither.as_ref(), pieces))
    }
}

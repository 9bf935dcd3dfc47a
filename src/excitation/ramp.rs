//! A straight line from one voltage to another.

use serde::{Deserialize, Serialize};

use super::dither::{check_dither, dithered};
use super::error::{Refusal, duration, finite};
use super::{Card, Dither, Excitation, Piece, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    pub from_v: f64,
    pub to_v: f64,
    pub seconds: f64,
    pub dither: Option<Dither>,
}

impl Ramp {
    pub const CARD: Card = Card {
        id: "ramp",
        name: "ramp",
        shows: "what happens around zero speed: Stribeck friction, breakaway, cogging, dead zones",
        example: "ramp = { from_v = -4.0, to_v = 4.0, seconds = 2.0 }",
    };
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

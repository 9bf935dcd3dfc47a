//! Standstill and coast-down: zero volts shows noise floor and sensor offsets, output off friction over inertia.

use serde::{Deserialize, Serialize};

use super::error::{Refusal, duration};
use super::{Excitation, Piece, Target};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Standstill {
    pub seconds: f64,
}

impl Excitation for Standstill {
    fn check(&self) -> Result<(), Refusal> {
        duration("seconds", self.seconds)
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        Target::Voltage(vec![Piece::level(0.0, self.seconds, 0.0)])
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoastDown {
    pub seconds: f64,
}

impl Excitation for CoastDown {
    fn check(&self) -> Result<(), Refusal> {
        duration("seconds", self.seconds)
    }

    fn duration_s(&self) -> f64 {
        self.seconds
    }

    fn target(&self) -> Target {
        Target::Coast
    }
}

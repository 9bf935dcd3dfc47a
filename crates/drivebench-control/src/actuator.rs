//! The actuator of a speed controller.

use drivebench_model::sample::Demand;
use drivebench_model::tabulated;

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Actuator {
        Voltage = "voltage",
        /// Armature current or torque reference, A.
        Current = "current",
        /// Speed reference of a drive that has a speed loop of its own, rad/s.
        Speed = "speed",
    }
    pub const fn name(self) -> &'static str;
}

impl Actuator {
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Voltage => "V",
            Self::Current => "A",
            Self::Speed => "rad/s",
        }
    }

    /// The output of a demand on it; `None`: on another.
    pub const fn of(self, demand: Demand) -> Option<f64> {
        match (self, demand) {
            (Self::Voltage, Demand::Voltage(output))
            | (Self::Current, Demand::Current(output))
            | (Self::Speed, Demand::Speed(output)) => Some(output),
            _ => None,
        }
    }

    pub const fn demand(self, output: f64) -> Demand {
        match self {
            Self::Voltage => Demand::Voltage(output),
            Self::Current => Demand::Current(output),
            Self::Speed => Demand::Speed(output),
        }
    }
}

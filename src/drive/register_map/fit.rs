//! Which quantities signals and set-points may have, and in which units: what is wrong here would otherwise only show
//! up as a channel that is missing.

use serde::Serialize;

use super::facts::{Quantity, Unit};

impl Quantity {
    /// As a profile writes it.
    pub fn name(self) -> String {
        written(&self)
    }

    /// Units in which it may be given; `None`: any.
    const fn units(self) -> Option<&'static [Unit]> {
        Some(match self {
            Self::Current | Self::FieldCurrent | Self::RatedCurrent | Self::CurrentLimit => {
                &[Unit::A, Unit::Percent]
            }
            Self::Voltage
            | Self::BusVoltage
            | Self::LineVoltage
            | Self::RatedVoltage
            | Self::VoltageLimit => &[Unit::V, Unit::Percent],
            Self::ShaftSpeed | Self::OutputSpeed | Self::RatedSpeed | Self::Speed => &[
                Unit::Rpm,
                Unit::RadS,
                Unit::Hertz,
                Unit::CountsPerSecond,
                Unit::Percent,
            ],
            Self::Torque => &[Unit::NewtonMetre, Unit::Percent],
            Self::Power => &[Unit::KiloWatt, Unit::Percent],
            Self::Duty => &[Unit::Percent],
            Self::Temperature => &[Unit::Celsius],
            Self::Angle => &[Unit::Rad, Unit::Counts],
            Self::Clock => &[Unit::Microsecond, Unit::Millisecond, Unit::Second],
            Self::Status | Self::FaultCode | Self::Word => &[Unit::None],
            Self::Other => return None,
        })
    }

    /// Whether a set-point of this quantity moves the motor with every value but zero.
    pub const fn moves(self) -> bool {
        !matches!(self, Self::Word | Self::Other)
    }

    /// Why a signal cannot be of this quantity.
    pub(super) fn read(self) -> Result<(), String> {
        let instead = match self {
            Self::Speed => {
                "\"shaft_speed\" with a sensor on the shaft, \"output_speed\" without one"
            }
            Self::Word => "\"status\"",
            _ => return Ok(()),
        };
        let name = self.name();
        Err(format!(
            "quantity \"{name}\" is one of setpoints (expected {instead})"
        ))
    }

    /// Why a set-point cannot be of this quantity.
    pub(super) fn written(self) -> Result<(), String> {
        let instead = match self {
            Self::Speed
            | Self::Current
            | Self::Voltage
            | Self::Torque
            | Self::Duty
            | Self::Word
            | Self::Other => return Ok(()),
            Self::ShaftSpeed | Self::OutputSpeed => "\"speed\"",
            Self::Status => "\"word\"",
            _ => "speed, current, voltage, torque, duty, word or other",
        };
        let name = self.name();
        Err(format!(
            "quantity \"{name}\" is one of signals (expected {instead})"
        ))
    }

    /// The key that is wrong, and why a value of this quantity cannot be in this unit.
    pub(super) fn given_in(self, unit: Unit) -> Result<(), (&'static str, String)> {
        let Some(units) = self.units().filter(|units| !units.contains(&unit)) else {
            return Ok(());
        };
        let names: Vec<&str> = units.iter().map(|unit| unit.name()).collect();
        let (quantity, unit_name) = (self.name(), unit.name());
        let expected = match names.as_slice() {
            [""] => "no unit".to_owned(),
            names => either(names),
        };
        if unit == Unit::None && names != [""] {
            let message = format!("quantity \"{quantity}\" needs a unit (expected {expected})");
            return Err(("quantity", message));
        }
        let message = format!(
            "unit \"{unit_name}\" does not fit quantity \"{quantity}\" (expected {expected})"
        );
        Err(("unit", message))
    }
}

/// How a profile writes a value, by the names that serde has for it.
pub(super) fn written(value: &impl Serialize) -> String {
    match toml::Value::try_from(value) {
        Ok(toml::Value::String(name)) => name,
        // Each is an enumeration of plain names.
        _ => String::new(),
    }
}

/// `a, b or c`.
fn either(names: &[&str]) -> String {
    match names {
        [rest @ .., last] if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => names.concat(),
    }
}

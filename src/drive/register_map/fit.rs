//! Which quantities signals and set-points may have, and in which units: what is wrong here would otherwise only show
//! up as a channel that is missing.

use super::facts::{Quantity, Unit};

impl Quantity {
    /// As a profile writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Current => "current",
            Self::Voltage => "voltage",
            Self::BusVoltage => "bus_voltage",
            Self::LineVoltage => "line_voltage",
            Self::ShaftSpeed => "shaft_speed",
            Self::OutputSpeed => "output_speed",
            Self::Torque => "torque",
            Self::Power => "power",
            Self::Duty => "duty",
            Self::FieldCurrent => "field_current",
            Self::Temperature => "temperature",
            Self::Angle => "angle",
            Self::Clock => "clock",
            Self::Status => "status",
            Self::FaultCode => "fault_code",
            Self::RatedCurrent => "rated_current",
            Self::RatedVoltage => "rated_voltage",
            Self::RatedSpeed => "rated_speed",
            Self::CurrentLimit => "current_limit",
            Self::VoltageLimit => "voltage_limit",
            Self::Word => "word",
            Self::Speed => "speed",
            Self::Other => "other",
        }
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
        Err(match (unit, names.as_slice()) {
            (Unit::None, [first, ..]) if !first.is_empty() => (
                "quantity",
                format!("quantity \"{quantity}\" needs a unit (expected {expected})"),
            ),
            _ => (
                "unit",
                format!(
                    "unit \"{unit_name}\" does not fit quantity \"{quantity}\" (expected {expected})"
                ),
            ),
        })
    }
}

/// `a, b or c`.
fn either(names: &[&str]) -> String {
    match names {
        [rest @ .., last] if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => names.concat(),
    }
}

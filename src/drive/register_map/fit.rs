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
    pub(super) fn not_read(self) -> Option<String> {
        let instead = match self {
            Self::Speed => {
                "\"shaft_speed\" with a sensor on the shaft, \"output_speed\" without one"
            }
            Self::Word => "\"status\"",
            _ => return None,
        };
        Some(format!(
            "quantity \"{}\" is one of setpoints (expected {instead})",
            self.name()
        ))
    }

    /// Why a set-point cannot be of this quantity.
    pub(super) fn not_written(self) -> Option<String> {
        let instead = match self {
            Self::Speed
            | Self::Current
            | Self::Voltage
            | Self::Torque
            | Self::Duty
            | Self::Word
            | Self::Other => return None,
            Self::ShaftSpeed | Self::OutputSpeed => "\"speed\"",
            Self::Status => "\"word\"",
            _ => "speed, current, voltage, torque, duty, word or other",
        };
        Some(format!(
            "quantity \"{}\" is one of signals (expected {instead})",
            self.name()
        ))
    }

    /// The key that is wrong, and why a value of this quantity cannot be in this unit.
    pub(super) fn misfit(self, unit: Unit) -> Option<(&'static str, String)> {
        let units = self.units()?;
        if units.contains(&unit) {
            return None;
        }
        let names: Vec<&str> = units.iter().map(|unit| unit.name()).collect();
        let quantity = self.name();
        Some(match (unit, names.as_slice()) {
            (_, [""]) => (
                "unit",
                format!(
                    "unit \"{}\" does not fit quantity \"{quantity}\" (expected no unit)",
                    unit.name()
                ),
            ),
            (Unit::None, _) => (
                "quantity",
                format!(
                    "quantity \"{quantity}\" needs a unit (expected {})",
                    either(&names)
                ),
            ),
            _ => (
                "unit",
                format!(
                    "unit \"{}\" does not fit quantity \"{quantity}\" (expected {})",
                    unit.name(),
                    either(&names)
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

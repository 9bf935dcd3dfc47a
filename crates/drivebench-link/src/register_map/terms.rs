//! Terms that the keys and the facts of a profile share, and the units in which each quantity may be given.

use serde::{Deserialize, Serialize};

use crate::settings::{Trust, named};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DeviceKind {
    /// Chopper or servo amplifier for a DC motor.
    Dc,
    /// Line-commutated bridge for a DC motor.
    ThyristorDc,
    /// Frequency converter for an induction motor.
    Ac,
    Bldc,
    Servo,
}

/// `[device]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// How a bench file names it.
    pub id: String,
    pub name: String,
    pub kind: DeviceKind,
    pub source: String,
    pub trust: Trust,
    /// Shown wherever the profile is used.
    pub note: Option<String>,
    /// Counts of the encoder in one turn of the shaft, all edges counted, for values in counts.
    pub counts_per_turn: Option<u32>,
}

/// `[converter]` of a thyristor drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Converter {
    /// Longest time until the bridge fires next, ms: 3.3 with six pulses, 10 with two, both at 50 Hz.
    pub dead_time_ms: f64,
    /// 1: one direction and no braking; 2: one direction of current; 4: all.
    pub quadrants: u8,
}

/// How a late reply is distinguished from the right one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Resync {
    /// Function code 08 echoes a number.
    Fc08,
    /// A read of a length that no unanswered request had.
    Length,
    /// Modbus TCP has a transaction number.
    Tid,
    /// Only silence; a reply that is later than that cannot be distinguished.
    None,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PollRate {
    #[default]
    Fast,
    Slow,
    Once,
}

named! {
    /// What a register means.
    #[derive(Default)]
    pub enum Quantity {
        Current = "current",
        /// A current that is positive where it drives the shaft the way of the voltage, whatever that is.
        DrivingCurrent = "driving_current",
        Voltage = "voltage",
        BusVoltage = "bus_voltage",
        LineVoltage = "line_voltage",
        /// From a sensor on the shaft.
        ShaftSpeed = "shaft_speed",
        /// What the converter puts out or computes; no shaft was looked at.
        OutputSpeed = "output_speed",
        Torque = "torque",
        Power = "power",
        Duty = "duty",
        FieldCurrent = "field_current",
        Temperature = "temperature",
        Angle = "angle",
        /// A counter that runs with the drive's time.
        Clock = "clock",
        Status = "status",
        FaultCode = "fault_code",
        /// Nameplate values that other signals are scaled with.
        RatedCurrent = "rated_current",
        RatedVoltage = "rated_voltage",
        RatedSpeed = "rated_speed",
        CurrentLimit = "current_limit",
        VoltageLimit = "voltage_limit",
        /// What the drive stores of its motor, between two lines.
        MotorResistance = "motor_resistance",
        MotorInductance = "motor_inductance",
        MotorBackEmf = "motor_back_emf",
        /// A word of bits that is written.
        Word = "word",
        /// A set-point of speed.
        Speed = "speed",
        #[default]
        Other = "other",
    }
}

named! {
    #[derive(Default)]
    pub enum Unit {
        #[default]
        None = "",
        Rpm = "rpm",
        RadS = "rad/s",
        Hertz = "Hz",
        A = "A",
        V = "V",
        NewtonMetre = "N.m",
        Percent = "%",
        KiloWatt = "kW",
        Celsius = "C",
        Rad = "rad",
        /// Of an encoder; `counts_per_turn` makes them an angle or a speed.
        Counts = "counts",
        CountsPerSecond = "counts/s",
        Microsecond = "us",
        Millisecond = "ms",
        Second = "s",
        Ohm = "ohm",
        Henry = "H",
        VoltSecond = "V.s/rad",
    }
}

impl Unit {
    /// What one of a unit of time is, s.
    pub(super) const fn seconds(self) -> Option<f64> {
        match self {
            Self::Microsecond => Some(1e-6),
            Self::Millisecond => Some(1e-3),
            Self::Second => Some(1.0),
            _ => None,
        }
    }

    /// Whether it counts edges of an encoder.
    pub const fn is_counts(self) -> bool {
        matches!(self, Self::Counts | Self::CountsPerSecond)
    }
}

impl Quantity {
    /// Units in which it may be given; `None`: any.
    const fn units(self) -> Option<&'static [Unit]> {
        Some(match self {
            Self::Current
            | Self::DrivingCurrent
            | Self::FieldCurrent
            | Self::RatedCurrent
            | Self::CurrentLimit => &[Unit::A, Unit::Percent],
            Self::Voltage
            | Self::BusVoltage
            | Self::LineVoltage
            | Self::RatedVoltage
            | Self::VoltageLimit => &[Unit::V, Unit::Percent],
            Self::ShaftSpeed | Self::OutputSpeed | Self::RatedSpeed | Self::Speed => {
                &[Unit::Rpm, Unit::RadS, Unit::Hertz, Unit::CountsPerSecond, Unit::Percent]
            }
            Self::Torque => &[Unit::NewtonMetre, Unit::Percent],
            Self::Power => &[Unit::KiloWatt, Unit::Percent],
            Self::Duty => &[Unit::Percent],
            Self::Temperature => &[Unit::Celsius],
            Self::Angle => &[Unit::Rad, Unit::Counts],
            Self::Clock => &[Unit::Microsecond, Unit::Millisecond, Unit::Second],
            Self::MotorResistance => &[Unit::Ohm],
            Self::MotorInductance => &[Unit::Henry],
            Self::MotorBackEmf => &[Unit::VoltSecond],
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
        Err(format!("quantity \"{name}\" is one of setpoints (expected {instead})"))
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
        Err(format!("quantity \"{name}\" is one of signals (expected {instead})"))
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

/// `a, b or c`.
fn either(names: &[&str]) -> String {
    match names {
        [rest @ .., last] if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => names.concat(),
    }
}

/// Sign of a set-point as bits of another one.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sign {
    #[serde(rename = "setpoint")]
    pub set_point: String,
    pub mask: u16,
}

/// When a register may be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StoppedOnly {
    Stopped,
}

/// Supervision of the host by the drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SupervisionKind {
    /// A register that takes the time.
    Register,
    Parameter,
    /// Part of the command itself: it has to be repeated.
    Implicit,
    Gateway,
    Unknown,
    None,
}

/// What the drive does when the host is silent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Expiry {
    Trip,
    Stop,
    /// Another parameter decides.
    Parameter,
    #[default]
    Unknown,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rates {
    /// What the fast signals and one set-point reach at the profile's baud rate, Hz.
    pub fast_hz: f64,
    pub slow_hz: f64,
}

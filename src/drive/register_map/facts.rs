//! Resolved register map of a profile: addresses as on the wire, names looked up, everything checked; and which quantities may
//! be given in which units: what is wrong there would otherwise only show up as a channel that is missing.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::schema::{SetPointKeys, SignalKeys, WatchdogKeys};
use super::value::Layout;
use crate::drive::register_bus::{ReadRequest, RegisterTable};
use crate::drive::settings::{DriveLimits, LinkSettings, Trust};
use crate::sample::Channel;
use crate::units::rad_s_from_rpm;

/// What turns the motor.
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

/// How a late reply is told from the right one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Resync {
    /// Function code 08 returns a number of our own.
    Fc08,
    /// A read of a length that no unanswered request had.
    Length,
    /// Modbus TCP has a transaction number.
    Tid,
    /// Only silence; a reply that is later than that cannot be told.
    None,
}

/// How often a signal is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PollRate {
    Fast,
    Slow,
    Once,
}

/// What a register means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    Current,
    Voltage,
    BusVoltage,
    LineVoltage,
    /// From a sensor on the shaft.
    ShaftSpeed,
    /// What the converter puts out or computes; no shaft was looked at.
    OutputSpeed,
    Torque,
    Power,
    Duty,
    FieldCurrent,
    Temperature,
    Angle,
    /// A counter that runs with the drive's time.
    Clock,
    Status,
    FaultCode,
    /// Nameplate values that other signals are scaled with.
    RatedCurrent,
    RatedVoltage,
    RatedSpeed,
    CurrentLimit,
    VoltageLimit,
    /// A word of bits that is written.
    Word,
    /// A set-point of speed.
    Speed,
    Other,
}

/// Unit of a value in a profile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    #[default]
    #[serde(rename = "")]
    None,
    #[serde(rename = "rpm")]
    Rpm,
    #[serde(rename = "rad/s")]
    RadS,
    #[serde(rename = "Hz")]
    Hertz,
    A,
    V,
    #[serde(rename = "N.m")]
    NewtonMetre,
    #[serde(rename = "%")]
    Percent,
    #[serde(rename = "kW")]
    KiloWatt,
    #[serde(rename = "C")]
    Celsius,
    #[serde(rename = "rad")]
    Rad,
    /// Of an encoder; `counts_per_turn` makes them an angle or a speed.
    #[serde(rename = "counts")]
    Counts,
    #[serde(rename = "counts/s")]
    CountsPerSecond,
    #[serde(rename = "us")]
    Microsecond,
    #[serde(rename = "ms")]
    Millisecond,
    #[serde(rename = "s")]
    Second,
}

impl Unit {
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Rpm => "rpm",
            Self::RadS => "rad/s",
            Self::Hertz => "Hz",
            Self::A => "A",
            Self::V => "V",
            Self::NewtonMetre => "N.m",
            Self::Percent => "%",
            Self::KiloWatt => "kW",
            Self::Celsius => "C",
            Self::Rad => "rad",
            Self::Counts => "counts",
            Self::CountsPerSecond => "counts/s",
            Self::Microsecond => "us",
            Self::Millisecond => "ms",
            Self::Second => "s",
        }
    }

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

/// What turns an electrical frequency or an encoder's counts into those of the shaft.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PerTurn {
    pub(super) pole_pairs: Option<u8>,
    pub(super) counts: Option<u32>,
}

/// Where a value lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Location {
    pub table: RegisterTable,
    pub address: u16,
    pub layout: Layout,
}

impl Location {
    /// The question for its registers.
    pub const fn request(&self) -> ReadRequest {
        ReadRequest {
            table: self.table,
            address: self.address,
            count: self.layout.registers(),
        }
    }
}

/// Raw number to value: `raw * scale * (product of the signals in scale_by) + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct Numbers {
    pub scale: f64,
    pub offset: f64,
    pub scale_by: Vec<String>,
    pub unit: Unit,
}

impl Numbers {
    /// `factor`: product of the signals in `scale_by`.
    pub fn value(&self, raw: f64, factor: f64) -> f64 {
        raw * self.scale * factor + self.offset
    }

    pub fn raw(&self, value: f64, factor: f64) -> f64 {
        (value - self.offset) / (self.scale * factor)
    }
}

/// One value that is read: what the profile says of it, and what follows.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    pub name: String,
    /// Line of the profile in which it begins.
    pub line: usize,
    pub keys: SignalKeys,
    pub location: Location,
    pub numbers: Numbers,
    /// The channel that it fills, and what one unit is in SI.
    pub channel: Option<(Channel, f64)>,
    /// Raw counts after which a position begins again; `None`: it never does.
    pub wraps_at: Option<f64>,
}

impl Signal {
    /// What one count of a clock is, s; `None` for what is none.
    pub fn clock_count_s(&self) -> Option<f64> {
        let unit_s = self.numbers.unit.seconds()?;
        (self.keys.quantity == Quantity::Clock).then_some(self.numbers.scale * unit_s)
    }

    /// What bits that lie so say; `factor`: the product of the signals that they are scaled with, where it is known.
    pub(in crate::drive) fn read(
        &self,
        layout: Layout,
        pattern: u32,
        factor: Option<f64>,
    ) -> Reading {
        if self.keys.invalid.contains(&pattern) {
            return Reading::NotAvailable;
        }
        let Some(factor) = factor else {
            return Reading::Unread;
        };
        let value = self.numbers.value(layout.number(pattern), factor);
        match self.keys.valid {
            _ if !value.is_finite() => Reading::NotANumber,
            Some([low, high]) if !(low..=high).contains(&value) => Reading::Outside(value),
            _ => Reading::Value(value),
        }
    }

    /// Whether its number tells which way.
    pub fn is_signed(&self) -> bool {
        let of_type = self.location.layout.kind.is_signed();
        self.keys.signed.unwrap_or(of_type)
    }
}

/// What a reading is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// In the profile's unit.
    Value(f64),
    /// The profile's code for "not available".
    NotAvailable,
    /// Outside of the profile's `valid`.
    Outside(f64),
    /// A float register that holds no number.
    NotANumber,
    /// No registers, or a factor is missing.
    Unread,
}

impl Reading {
    /// In the profile's unit; what cannot be is none.
    pub const fn value(self) -> Option<f64> {
        match self {
            Self::Value(value) => Some(value),
            _ => None,
        }
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

/// One value that is written: what the profile says of it, and what follows.
#[derive(Clone, Debug, PartialEq)]
pub struct SetPoint {
    pub name: String,
    /// Line of the profile in which it begins.
    pub line: usize,
    pub keys: SetPointKeys,
    pub location: Location,
    /// 6 or 16.
    pub function: u8,
    pub numbers: Numbers,
    /// What one unit is in SI where the bench may command it as speed, current or voltage.
    pub si: Option<f64>,
}

impl SetPoint {
    pub fn is_word(&self) -> bool {
        self.keys.quantity == Quantity::Word
    }

    /// A reference that the program may set to zero by itself.
    pub fn is_reference(&self) -> bool {
        !self.is_word() && !self.keys.nvm
    }

    /// Its range with the sign that stands in another word.
    pub fn range(&self) -> Option<[f64; 2]> {
        let [low, high] = self.keys.limits?;
        Some([if self.keys.sign.is_some() { -high } else { low }, high])
    }

    pub fn refresh_s(&self) -> Option<f64> {
        self.keys.refresh_ms.map(|ms| ms * 1e-3)
    }
}

/// A test of bits of a signal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Condition {
    pub signal: String,
    pub mask: u32,
    pub pattern: u32,
    /// The bits must differ from the pattern.
    pub negated: bool,
    /// Line of the profile in which it stands.
    pub line: usize,
}

impl Condition {
    pub const fn holds(&self, pattern: u32) -> bool {
        (pattern & self.mask == self.pattern) != self.negated
    }

    /// What is expected of the signal, and where the profile says so.
    pub fn expected(&self) -> String {
        let not = if self.negated { "other than " } else { "" };
        format!(
            "expected {not}{:#06x} under mask {:#06x}, line {} of the profile",
            self.pattern, self.mask, self.line
        )
    }
}

/// A write of a command.
#[derive(Clone, Debug, PartialEq)]
pub struct Write {
    pub set_point: String,
    pub value: f64,
    /// Only these bits; the others stay as last written.
    pub mask: Option<u16>,
}

/// One step of a command.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Write(Write),
    Wait {
        condition: Condition,
        within_s: f64,
        error: Option<String>,
    },
    Delay {
        seconds: f64,
    },
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Commands {
    pub enable: Vec<Step>,
    pub stop: Vec<Step>,
    pub coast: Vec<Step>,
    pub reset: Vec<Step>,
    pub quickstop: Vec<Step>,
}

impl Commands {
    pub fn all(&self) -> [(&'static str, &[Step]); 5] {
        [
            ("enable", &self.enable),
            ("stop", &self.stop),
            ("coast", &self.coast),
            ("reset", &self.reset),
            ("quickstop", &self.quickstop),
        ]
    }
}

/// `[[identity]]`.
#[derive(Clone, Debug, PartialEq)]
pub enum IdentityCheck {
    Signal {
        signal: String,
        mask: u32,
        test: IdentityTest,
    },
    /// An object of function code 43 has to hold this text.
    Object { object: u8, contains: String },
}

#[derive(Clone, Debug, PartialEq)]
pub enum IdentityTest {
    OneOf(Vec<u32>),
    Within([f64; 2]),
}

impl IdentityTest {
    /// Whether a signal with these bits, and this value, passes.
    pub fn passes(&self, pattern: Option<u32>, mask: u32, value: Option<f64>) -> bool {
        match self {
            Self::OneOf(patterns) => pattern.is_some_and(|bits| patterns.contains(&(bits & mask))),
            Self::Within([low, high]) => value.is_some_and(|v| (*low..=*high).contains(&v)),
        }
    }
}

/// What watches over the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SupervisionKind {
    /// A register that takes the time.
    Register,
    /// A parameter of the drive.
    Parameter,
    /// Part of the command itself: it has to be repeated.
    Implicit,
    /// The gateway in between.
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

/// `[watchdog]`, with the register that it has.
#[derive(Clone, Debug, PartialEq)]
pub struct Supervision {
    pub keys: WatchdogKeys,
    /// The time's register, and what one raw unit is in s.
    pub time: Option<(Location, f64)>,
}

impl Supervision {
    /// As delivered, s: 0 is off, `None` not known.
    pub fn default_s(&self) -> Option<f64> {
        self.keys.default_ms.map(|ms| ms * 1e-3)
    }

    /// Written at connect and read back, s.
    pub fn set_s(&self) -> Option<f64> {
        self.keys.set_ms.map(|ms| ms * 1e-3)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rates {
    /// What the fast signals and one set-point reach at the profile's baud rate, Hz.
    pub fast_hz: f64,
    pub slow_hz: f64,
}

/// The whole map.
#[derive(Clone, Debug, PartialEq)]
pub struct RegisterMap {
    pub device: Device,
    pub converter: Option<Converter>,
    /// Function codes that the drive knows.
    pub functions: Vec<u8>,
    pub max_read: u16,
    pub max_write: u16,
    /// Unused registers that a read may run over.
    pub max_hole: u16,
    /// Blocks that are only read as a whole: first address and registers.
    pub exact_reads: Vec<(u16, u16)>,
    pub resync: Resync,
    pub nvm_cycles: Option<u32>,
    pub identity: Vec<IdentityCheck>,
    pub signals: Vec<Signal>,
    /// Channel key to the reason why it is not mapped.
    pub missing: BTreeMap<String, String>,
    pub set_points: Vec<SetPoint>,
    pub commands: Commands,
    /// Names of [`RegisterMap::STATES`] to their condition.
    pub state: BTreeMap<String, Condition>,
    /// Names of states that no register tells, with the reason.
    pub untold: BTreeMap<String, String>,
    /// What the numbers of the fault code mean.
    pub fault_codes: BTreeMap<u16, String>,
    pub watchdog: Supervision,
    /// Current of the field below which the motor would run away, A.
    pub field_min_a: Option<f64>,
    pub rates: Rates,
}

impl RegisterMap {
    /// States that a profile may tell from status bits.
    pub const STATES: [&'static str; 7] = [
        "fault",
        "ready",
        "running",
        "comm_loss",
        "local",
        "sto",
        "remote",
    ];
    /// Channels that are mapped or declared missing.
    pub const REQUIRED: [Channel; 3] = [Channel::Voltage, Channel::Current, Channel::Speed];

    /// Reads a profile file of this kind; `file` names it in errors.
    ///
    /// # Errors
    /// The first key or value that is not allowed, with its line.
    pub fn parse(file: &str, text: &str) -> Result<Self, crate::config_text::ConfigError> {
        super::resolve::read(file, text).map(|(map, ..)| map)
    }

    /// The same with what the file says of the link and of the drive's limits.
    pub(in crate::drive) fn with_settings(
        file: &str,
        text: &str,
    ) -> Result<(Self, LinkSettings, DriveLimits), crate::config_text::ConfigError> {
        super::resolve::read(file, text)
    }

    /// Position of a signal.
    pub fn index(&self, name: &str) -> Option<usize> {
        self.signals.iter().position(|signal| signal.name == name)
    }

    pub fn signal(&self, name: &str) -> Option<&Signal> {
        self.signals.iter().find(|signal| signal.name == name)
    }

    /// The signal that fills a channel.
    pub fn of_channel(&self, channel: Channel) -> Option<&Signal> {
        let is_it = |signal: &&Signal| signal.channel.is_some_and(|(has, _)| has == channel);
        self.signals.iter().find(is_it)
    }

    pub fn of_quantity(&self, quantity: Quantity) -> Option<&Signal> {
        let mut signals = self.signals.iter();
        signals.find(|signal| signal.keys.quantity == quantity)
    }

    pub fn set_point(&self, name: &str) -> Option<&SetPoint> {
        self.set_points.iter().find(|point| point.name == name)
    }

    /// The set-point that takes a demand of this quantity in SI.
    pub fn demand(&self, quantity: Quantity) -> Option<&SetPoint> {
        let is_it = |point: &&SetPoint| point.keys.quantity == quantity && point.si.is_some();
        self.set_points.iter().find(is_it)
    }

    pub fn state(&self, name: &str) -> Option<&Condition> {
        self.state.get(name)
    }

    /// What is only from memory in a profile that otherwise has a source.
    pub fn unverified(&self) -> Vec<&str> {
        let signals = self.signals.iter().map(|s| (s.keys.trust, s.name.as_str()));
        let points = self.set_points.iter();
        signals
            .chain(points.map(|p| (p.keys.trust, p.name.as_str())))
            .filter_map(|(trust, name)| (trust == Some(Trust::Unverified)).then_some(name))
            .collect()
    }
}

/// The channel that a quantity fills, and what one unit is in SI; `None` where the unit does not lead there.
pub(super) fn channel_of(
    quantity: Quantity,
    unit: Unit,
    per_turn: PerTurn,
) -> Option<(Channel, f64)> {
    Some(match (quantity, unit) {
        (Quantity::Current, Unit::A) => (Channel::Current, 1.0),
        (Quantity::Voltage, Unit::V) => (Channel::Voltage, 1.0),
        (Quantity::BusVoltage, Unit::V) => (Channel::Bus, 1.0),
        (Quantity::ShaftSpeed | Quantity::OutputSpeed, _) => {
            (Channel::Speed, speed_si(unit, per_turn)?)
        }
        (Quantity::Torque, Unit::NewtonMetre) => (Channel::Torque, 1.0),
        (Quantity::Temperature, Unit::Celsius) => (Channel::Temperature, 1.0),
        (Quantity::Angle, Unit::Rad) => (Channel::Angle, 1.0),
        (Quantity::Angle, Unit::Counts) => (Channel::Angle, per_turn.count_rad()?),
        _ => return None,
    })
}

/// What one unit of a set-point is in SI, if the bench may command it.
pub(super) fn demand_si(quantity: Quantity, unit: Unit, per_turn: PerTurn) -> Option<f64> {
    match (quantity, unit) {
        (Quantity::Speed, _) => speed_si(unit, per_turn),
        (Quantity::Current, Unit::A) | (Quantity::Voltage, Unit::V) => Some(1.0),
        _ => None,
    }
}

impl PerTurn {
    /// Angle of one count, rad.
    fn count_rad(self) -> Option<f64> {
        self.counts.map(|counts| TAU / f64::from(counts))
    }
}

fn speed_si(unit: Unit, per_turn: PerTurn) -> Option<f64> {
    match unit {
        Unit::Rpm => Some(rad_s_from_rpm(1.0)),
        Unit::RadS => Some(1.0),
        // Electrical to mechanical.
        Unit::Hertz => per_turn.pole_pairs.map(|pairs| TAU / f64::from(pairs)),
        Unit::CountsPerSecond => per_turn.count_rad(),
        _ => None,
    }
}

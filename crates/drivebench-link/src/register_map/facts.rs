//! Resolved register map of a profile: addresses as on the wire, names looked up, everything checked.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::Arc;

use super::schema::{SetPointKeys, SignalKeys, WatchdogKeys};
use super::terms::{Converter, Device, Quantity, Rates, Resync, Unit};
use super::value::Layout;
use crate::cell_bus::{CellTable, Put, ReadRequest};
use crate::framing::{Grammar, PROOF_WRITE};
use crate::settings::{Protocol, Trust};
use drivebench_model::plant::effect::Tree;
use drivebench_model::sample::{Channel, Sensors, SpeedLag};
use drivebench_model::units::rad_s_from_rpm;

/// What turns an electrical frequency or an encoder's counts into those of the shaft.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PerTurn {
    pub(super) pole_pairs: Option<u8>,
    pub(super) counts: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Location {
    pub table: CellTable,
    pub address: u16,
    pub layout: Layout,
}

impl Location {
    pub const fn request(&self) -> ReadRequest {
        ReadRequest { table: self.table, address: self.address, count: self.layout.cells() }
    }
}

/// Product of the signals in a `scale_by`; one with a slash in front divides. `None` where one has no value, or divides by zero.
pub fn product_of(scale_by: &[String], value: impl Fn(&str) -> Option<f64>) -> Option<f64> {
    let factor = |name: &String| match name.strip_prefix('/') {
        Some(name) => value(name).map(f64::recip).filter(|factor| factor.is_finite()),
        None => value(name),
    };
    scale_by.iter().map(factor).product()
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

/// One value that is read: its keys in the profile and what follows from them.
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
    /// How it is computed from other signals; `None`: it is read.
    pub formula: Option<Formula>,
}

/// A value that is computed from those of other signals.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    pub(super) tree: Tree,
    /// Those signals, by position in the map; the names of the tree count them.
    pub of: Vec<usize>,
    /// The signal in the direction of which the value is counted.
    pub direction: Option<usize>,
}

impl Formula {
    /// `None` where one of them has no value, or this has none for them.
    pub fn value(&self, reading: impl Fn(usize) -> Option<f64>) -> Option<f64> {
        let values: Option<Vec<f64>> = self.of.iter().map(|index| reading(*index)).collect();
        Some(self.tree.value(&values?)).filter(|value| value.is_finite())
    }
}

impl Signal {
    /// Its place, by the raw numbers of the signals that may decide on it; `None`: it has none for this number.
    pub fn placed(&self, raw: impl FnOnce(&str) -> Option<u32>) -> Option<Location> {
        let Some(by) = &self.keys.reply_by else { return Some(self.location) };
        let address = *by.bytes.get(&raw(&by.signal)?.to_string())?;
        Some(Location { address, ..self.location })
    }

    /// The read that holds it, wherever its place is.
    pub fn request(&self) -> ReadRequest {
        let request = self.location.request();
        let places = self.keys.reply_by.iter().flat_map(|by| by.bytes.values());
        let last = places.max().map_or(0, |last| last - request.address);
        ReadRequest { count: request.count + last, ..request }
    }

    /// What one count of a clock is, s; `None` for what is none.
    pub fn clock_count_s(&self) -> Option<f64> {
        let unit_s = self.numbers.unit.seconds()?;
        (self.keys.quantity == Quantity::Clock).then_some(self.numbers.scale * unit_s)
    }

    /// Value of raw bits; `factor`: the product of the signals in `scale_by`, if known.
    pub(crate) fn read(&self, layout: Layout, pattern: u32, factor: Option<f64>) -> Reading {
        if self.keys.invalid.contains(&pattern) {
            return Reading::NotAvailable;
        }
        let Some(factor) = factor else { return Reading::Unread };
        let raw = layout.number(pattern);
        // What is cut off is half of a step on average, and as much of either sign at zero.
        let cut = if self.keys.truncated && raw != 0.0 { 0.5 * raw.signum() } else { 0.0 };
        let value = self.numbers.value(raw + cut, factor);
        match self.keys.valid {
            _ if !value.is_finite() => Reading::NotANumber,
            Some([low, high]) if !(low..=high).contains(&value) => Reading::Outside(value),
            _ => Reading::Value(value),
        }
    }

    /// Whether its sign is the direction.
    pub fn is_signed(&self) -> bool {
        self.keys.signed.unwrap_or(self.location.layout.kind.is_signed())
    }
}

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

/// One value that is written: its keys in the profile and what follows from them.
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
    /// The write of these cells.
    pub const fn put<'a>(&self, cells: &'a [u16]) -> Put<'a> {
        Put { function: self.function, address: self.location.address, cells }
    }

    pub fn is_word(&self) -> bool {
        self.keys.quantity == Quantity::Word
    }

    /// A reference that the program may set to zero by itself.
    pub fn is_reference(&self) -> bool {
        self.keys.quantity.moves() && !self.keys.nvm
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

/// The magnitude of a signal is more than a share of another one.
#[derive(Clone, Debug, PartialEq)]
pub struct Beyond {
    pub signal: String,
    pub of: String,
    pub share: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    pub signal: String,
    pub mask: u32,
    pub pattern: u32,
    /// The bits must differ from the pattern.
    pub negated: bool,
    /// The condition also holds where this does, whatever the bits are.
    pub or: Option<Beyond>,
    /// Line of the profile in which it stands.
    pub line: usize,
}

impl Condition {
    pub const fn holds(&self, pattern: u32) -> bool {
        (pattern & self.mask == self.pattern) != self.negated
    }

    /// By the bits and, where they do not hold, by the value of `or`; `None` while one of them is not known.
    pub fn holds_by(
        &self,
        pattern: Option<u32>,
        value: impl Fn(&str) -> Option<f64>,
    ) -> Option<bool> {
        let holds = self.holds(pattern?);
        let Some(beyond) = self.or.as_ref().filter(|_| !holds) else { return Some(holds) };
        Some(value(&beyond.signal)?.abs() > beyond.share * value(&beyond.of)?)
    }

    /// The expected value of the signal, and its line in the profile.
    pub fn expected(&self) -> String {
        let not = if self.negated { "other than " } else { "" };
        let Self { pattern, mask, line, .. } = self;
        let or = self.or.as_ref().map_or_else(String::new, |Beyond { signal, of, share }| {
            format!(", or {signal} beyond {share} of {of}")
        });
        format!(
            "expected {not}{pattern:#06x} under mask {mask:#06x}{or}, line {line} of the profile"
        )
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Write {
    pub set_point: String,
    pub value: f64,
    /// Only these bits; the others stay as last written.
    pub mask: Option<u16>,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Write(Write),
    Wait { condition: Condition, within_s: f64, error: Option<String> },
    Delay { seconds: f64 },
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
    Object {
        object: u8,
        contains: String,
    },
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

#[derive(Clone, Debug, PartialEq)]
pub struct RegisterMap {
    pub device: Device,
    pub converter: Option<Converter>,
    /// Of the profile; a bench may carry the registers of Modbus over another of its kinds.
    pub protocol: Protocol,
    /// Of `protocol = "lines"`.
    pub lines: Option<Arc<Grammar>>,
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
    /// States that no register maps, with the reason.
    pub unmapped_states: BTreeMap<String, String>,
    /// What the numbers of the fault code mean.
    pub fault_codes: BTreeMap<u16, String>,
    pub watchdog: Supervision,
    /// Current of the field below which the motor would run away, A.
    pub field_min_a: Option<f64>,
    pub rates: Rates,
}

impl RegisterMap {
    pub fn write_function(&self, cells: usize) -> u8 {
        match self.protocol {
            Protocol::Dynamixel | Protocol::Lines => PROOF_WRITE,
            _ if cells == 1 && self.functions.contains(&6) => 6,
            _ => 16,
        }
    }

    /// States that a profile may tell from status bits.
    pub const STATES: [&'static str; 7] =
        ["fault", "ready", "running", "comm_loss", "local", "sto", "remote"];
    /// Channels that are mapped or declared missing.
    pub const REQUIRED: [Channel; 3] = [Channel::Voltage, Channel::Current, Channel::Speed];

    pub fn index(&self, name: &str) -> Option<usize> {
        self.signals.iter().position(|signal| signal.name == name)
    }

    pub fn signal(&self, name: &str) -> Option<&Signal> {
        self.signals.iter().find(|signal| signal.name == name)
    }

    pub fn of_channel(&self, channel: Channel) -> Option<&Signal> {
        let is_it = |signal: &&Signal| signal.channel.is_some_and(|(has, _)| has == channel);
        self.signals.iter().find(is_it)
    }

    /// What is stated of the sensors.
    pub fn sensors(&self) -> Sensors {
        let keys = |channel| self.of_channel(channel).map(|signal| &signal.keys);
        let filter_ms = keys(Channel::Speed).and_then(|keys| keys.filter_ms);
        Sensors {
            speed: SpeedLag { delay_s: 0.0, filter_s: 1e-3 * filter_ms.unwrap_or(0.0) },
            has_unknown_filter: filter_ms.is_none(),
            averages_current: keys(Channel::Current).is_some_and(|keys| keys.since_last_read),
            ramp_v_per_s: 0.0,
        }
    }

    /// The drive's own ramp of a duty, as a share of the supply per second.
    pub fn duty_ramp_per_s(&self) -> Option<f64> {
        let point = self.demand(Quantity::Voltage)?;
        let ramp_percent_per_s = point.keys.ramp_per_s?;
        (point.keys.quantity == Quantity::Duty).then_some(0.01 * ramp_percent_per_s)
    }

    pub fn of_quantity(&self, quantity: Quantity) -> Option<&Signal> {
        self.signals.iter().find(|signal| signal.keys.quantity == quantity)
    }

    pub fn set_point(&self, name: &str) -> Option<&SetPoint> {
        self.set_points.iter().find(|point| point.name == name)
    }

    /// The set-point that takes a demand of this quantity in SI; of a voltage also a duty, where the supply is read.
    pub fn demand(&self, quantity: Quantity) -> Option<&SetPoint> {
        let is_it = |point: &&SetPoint| point.keys.quantity == quantity && point.si.is_some();
        let duty = |point: &&SetPoint| {
            quantity == Quantity::Voltage
                && point.keys.quantity == Quantity::Duty
                && self.of_channel(Channel::Bus).is_some()
        };
        self.set_points.iter().find(is_it).or_else(|| self.set_points.iter().find(duty))
    }

    /// A drive that resumes with the next command shows by its watchdog that nothing commands it: until so long after the last
    /// command, s.
    pub fn released_after_s(&self) -> Option<f64> {
        let resumes = self.watchdog.keys.auto_resume && self.state("comm_loss").is_some();
        // A fifth for the drive's clock and its period of looking at it.
        self.watchdog.default_s().filter(|_| resumes).map(|watchdog_s| 1.2 * watchdog_s)
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

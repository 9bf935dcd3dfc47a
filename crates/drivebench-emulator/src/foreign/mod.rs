//! Emulation of another make of drive: the same motor under the register map of a drive profile.
//!
//! ```text
//! request -> answer.rs (function codes, limits of length) -> registers.rs (truth -> registers) <- SoftDrive (the motor)
//!                                          '-> enable_sequence.rs (control words -> what the drive does)
//! bus.rs   in virtual time, as registers for the host
//! ```
//!
//! Implemented from the profile without code of the host, so that two implementations check each other. An error in the profile
//! itself is in both.

mod answer;
mod bus;
mod enable_sequence;
mod identity;
mod packets;
mod processing;
mod registers;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use firmware_protocol::{Control, DriveCommand, Fault, State};

pub use self::bus::ForeignBus;
use self::enable_sequence::{EnableSequence, Turn};
pub(crate) use self::packets::PacketReceiver;
use self::processing::Processing;
use super::config::LineConfig;
use super::fault::FaultKind;
use super::truth::MotorTruth;
use super::{EmulatorConfig, SoftDrive};
use drivebench_link::register_map::{
    Expiry, Kind, Quantity, RegisterMap, SetPoint, SupervisionKind, Unit,
};
use drivebench_link::{CellTable, DriveProfile, KickedBy};
use drivebench_model::sample::Hindrance;

/// Period of the drive's own control, s: of an industrial drive on a bus, and of a servo or a hobby drive, whose packets act at once.
const STEP_S: f64 = 0.005;
const PACKET_STEP_S: f64 = 0.0005;
/// Field current of a sound machine, A.
const FIELD_A: f64 = 1.0;

/// Emulation of another drive: its profile, and how its watchdog was set at its keypad.
#[derive(Clone, Debug)]
pub struct Guise {
    pub map: Arc<RegisterMap>,
    pub unit: u8,
    /// 0: off; `None`: as delivered.
    pub watchdog_s: Option<f64>,
    pub line: LineConfig,
}

impl Guise {
    /// `None` for our own register map.
    pub fn of(profile: &DriveProfile) -> Option<Self> {
        Some(Self {
            map: Arc::clone(profile.registers.as_ref()?),
            unit: profile.link.unit,
            watchdog_s: None,
            line: LineConfig {
                baud: profile.link.baud,
                bits_per_char: profile.link.framing.bits_per_char(),
                turnaround_ms: profile.link.reply_ms,
                gap_us: profile.link.gap_us,
                ..LineConfig::default()
            },
        })
    }
}

/// A drive of another make around our motor.
pub struct ForeignDrive {
    map: Arc<RegisterMap>,
    unit: u8,
    soft: SoftDrive,
    nameplate: MotorTruth,
    /// Objects of its device identification.
    identification_objects: Vec<(u8, String)>,
    limits_a_v: (f64, f64),
    sequence: EnableSequence,
    written: BTreeMap<u16, u16>,
    /// Bits that a signal shows instead of its value: a broken sensor.
    forced: BTreeMap<String, u32>,
    ignored: Option<String>,
    watchdog_s: f64,
    kicked_s: f64,
    processing: Processing,
    fault: Option<Cause>,
    field_lost_from_s: Option<f64>,
    /// Stopped by the watchdog, until the next command.
    lapsed: bool,
    hindrance: Option<Hindrance>,
    /// Every request is refused with this exception, and every write.
    refusing: Option<u8>,
    refusing_writes: Option<u8>,
    /// For how long a write is only accepted (exception 05) before it is carried out, s; those that are due, and when.
    accepts_for_s: Option<f64>,
    accepted: VecDeque<(f64, Vec<u8>)>,
    switched_on_s: f64,
    as_set_s: f64,
    seq: u16,
    /// The number that a host has written to prove its lines.
    scratch: String,
    /// Without power, and under control from its keypad, by the configuration.
    faults: (bool, bool),
    is_missing: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cause {
    Trip,
    CommunicationLoss,
}

impl ForeignDrive {
    pub fn new(guise: &Guise, config: &EmulatorConfig, seed: u64) -> Self {
        let watchdog = &guise.map.watchdog;
        let as_delivered_s = watchdog.default_s().unwrap_or(0.0);
        let watchdog_s = match watchdog.keys.kind {
            SupervisionKind::None | SupervisionKind::Unknown => guise.watchdog_s.unwrap_or(0.0),
            SupervisionKind::Implicit => as_delivered_s,
            _ => guise.watchdog_s.unwrap_or(as_delivered_s),
        };
        Self {
            sequence: EnableSequence::new(&guise.map),
            map: Arc::clone(&guise.map),
            unit: guise.unit,
            soft: SoftDrive::new(config, seed),
            nameplate: config.motor.clone(),
            identification_objects: identity::identification_objects(&guise.map),
            limits_a_v: (config.limits.current_limit_a, config.limits.bus_v),
            written: BTreeMap::new(),
            forced: BTreeMap::new(),
            ignored: None,
            watchdog_s,
            as_set_s: watchdog_s,
            kicked_s: 0.0,
            processing: Processing::of(&guise.map),
            fault: None,
            field_lost_from_s: config.faults.field_lost_from_s,
            lapsed: false,
            hindrance: None,
            refusing: None,
            refusing_writes: None,
            accepts_for_s: None,
            accepted: VecDeque::new(),
            switched_on_s: 0.0,
            seq: 0,
            scratch: String::new(),
            faults: (false, false),
            is_missing: false,
        }
    }

    pub fn time_s(&self) -> f64 {
        self.soft.time_s()
    }

    pub(super) const fn soft(&self) -> &SoftDrive {
        &self.soft
    }

    pub const fn speed_rad_s(&self) -> f64 {
        self.soft.plant().speed_rad_s()
    }

    pub fn is_running(&self) -> bool {
        self.soft.state() == State::Running
    }

    pub fn trip(&mut self) {
        self.fail(Cause::Trip);
    }

    fn has_no_field(&self) -> bool {
        let gone = |from_s: f64| self.is_running() && self.soft.plant().time_s() >= from_s;
        self.field_lost_from_s.is_some_and(gone)
    }

    /// Stop from the keypad, which takes control; or control given back to the bus.
    pub const fn take_local(&mut self, local: bool) {
        self.hindrance = if local {
            self.sequence.stop();
            Some(Hindrance::LocalControl)
        } else {
            None
        };
    }

    /// Opens or closes its enable circuit (safe torque off).
    pub const fn switch_torque_off(&mut self, off: bool) {
        self.hindrance = if off {
            self.sequence.fall();
            Some(Hindrance::TorqueOff)
        } else {
            None
        };
    }

    /// Refuses every request with this exception; `None`: answers again.
    pub const fn refuse(&mut self, code: Option<u8>) {
        self.refusing = code;
    }

    /// Refuses every write with this exception, and answers reads; `None`: takes them again.
    pub const fn refuse_writes(&mut self, code: Option<u8>) {
        self.refusing_writes = code;
    }

    /// Accepts every write with exception 05 (acknowledge) and carries it out so much later, s; `None`: at once.
    pub const fn accept_writes_for(&mut self, late_s: Option<f64>) {
        self.accepts_for_s = late_s;
    }

    /// A second master writes a set-point, raw, which the host does not receive.
    pub fn overwrite(&mut self, set_point: &str, raw: u16) {
        if let Some(point) = self.map.set_point(set_point) {
            self.written.insert(point.location.address, raw);
        }
    }

    /// Supply off and on again: what was written is forgotten, a fault as well.
    pub fn switch_on_again(&mut self) {
        self.written.clear();
        self.sequence.fall();
        self.fault = None;
        self.lapsed = false;
        self.watchdog_s = self.as_set_s;
        self.switched_on_s = self.soft.time_s();
    }

    /// What was written to a set-point last, raw; `None`: nothing since it was switched on.
    pub fn last_written(&self, set_point: &str) -> Option<u16> {
        self.written.get(&self.map.set_point(set_point)?.location.address).copied()
    }

    /// What was written to a set-point last, in its unit; `None`: nothing since it was switched on.
    #[cfg(test)]
    fn value_of(&self, set_point: &str) -> Option<f64> {
        self.value(self.map.set_point(set_point)?)
    }

    /// Lets a signal show these bits whatever is true; `None`: as it is again.
    pub fn force(&mut self, signal: &str, pattern: Option<u32>) {
        match pattern {
            Some(pattern) => self.forced.insert(signal.to_owned(), pattern),
            None => self.forced.remove(signal),
        };
    }

    /// Acknowledges writes to this set-point and does nothing about them.
    pub fn ignore(&mut self, set_point: Option<&str>) {
        self.ignored = set_point.map(str::to_owned);
    }

    pub fn advance_to(&mut self, time_s: f64) {
        let step_s = if self.map.protocol.is_modbus() { STEP_S } else { PACKET_STEP_S };
        while self.soft.time_s() + 1e-9 < time_s {
            let next_s = ((self.soft.time_s() / step_s + 1e-6).floor() + 1.0) * step_s;
            self.carry_out_accepted();
            self.supervise();
            self.drive_motor();
            self.soft.advance_to(next_s.min(time_s));
            let now_s = self.soft.time_s();
            if self.processing.is_needed() {
                let sensed = self.soft.telemetry();
                let signals = [sensed.current_a, sensed.speed_rad_s];
                self.processing.follow(now_s, signals, sensed.voltage_cmd_v);
            }
            self.processing.look(now_s, self.has_lost_host());
            self.apply_faults();
        }
    }

    /// What goes wrong in the drive by its configuration, as it begins and as it ends.
    fn apply_faults(&mut self) {
        let (is_off, is_local) = (!self.soft.is_powered(), self.soft.has(FaultKind::LocalControl));
        let (was_off, was_local) = std::mem::replace(&mut self.faults, (is_off, is_local));
        if was_off && !is_off {
            self.switch_on_again();
        } else if !was_off && is_off {
            self.sequence.fall();
        }
        if was_local != is_local {
            self.take_local(is_local);
        }
        let missing = self.soft.has(FaultKind::SignalMissing);
        if missing != std::mem::replace(&mut self.is_missing, missing) {
            self.withhold(missing);
        }
    }

    /// Sets measured signals to the drive's code for "not available".
    fn withhold(&mut self, missing: bool) {
        let map = Arc::clone(&self.map);
        for signal in &map.signals {
            let code = match (signal.keys.invalid.first(), signal.location.layout.kind) {
                (Some(code), _) => *code,
                (None, Kind::F32) => f32::NAN.to_bits(),
                (None, _) => continue,
            };
            self.force(&signal.name, missing.then_some(code));
        }
    }

    /// The request that writes zero to its first set-point.
    pub(super) fn first_command(&self) -> Vec<u8> {
        let address = self.map.set_points.first().map_or(0, |point| point.location.address);
        let [high, low] = address.to_be_bytes();
        if self.map.functions.contains(&6) {
            vec![6, high, low, 0, 0]
        } else {
            vec![16, high, low, 0, 1, 2, 0, 0]
        }
    }

    /// The drive's own supervision.
    fn supervise(&mut self) {
        if self.soft.fault() != Fault::None && self.fault.is_none() {
            self.fail(Cause::Trip);
        }
        let now_s = self.soft.time_s();
        let watchdog = &self.map.watchdog;
        let blind =
            now_s - self.switched_on_s < watchdog.keys.boot_delay_s || self.watchdog_s <= 0.0;
        let dead = self.soft.has(FaultKind::WatchdogDead);
        if blind || dead || !self.sequence.is_running() || self.lapsed {
            return;
        }
        if now_s - self.kicked_s >= self.watchdog_s {
            if watchdog.keys.auto_resume {
                self.lapsed = true;
            } else if watchdog.keys.on_expire == Expiry::Stop {
                self.sequence.stop();
            } else {
                self.fail(Cause::CommunicationLoss);
            }
        }
    }

    /// Stopped by its watchdog.
    fn has_lost_host(&self) -> bool {
        self.lapsed || self.fault == Some(Cause::CommunicationLoss)
    }

    fn fail(&mut self, cause: Cause) {
        if self.fault.is_none() {
            self.fault = Some(cause);
            self.sequence.fall();
        }
    }

    fn drive_motor(&mut self) {
        // Share of the rated speed below which a shaft stands.
        let rest = 0.02 * self.nameplate.rated_speed_rad_s;
        let stands = self.soft.plant().speed_rad_s().abs() < rest;
        let control = match self.sequence.turn(stands) {
            _ if self.fault.is_some() => Control::Disable,
            Turn::Off => Control::Disable,
            Turn::Down => Control::Speed(0.0),
            Turn::On if self.lapsed => Control::Speed(0.0),
            Turn::On => self.reference(),
        };
        self.seq = self.seq.wrapping_add(1);
        self.soft.command(DriveCommand::new(self.seq, control));
    }

    /// The command that follows from the references.
    fn reference(&self) -> Control {
        let nameplate = &self.nameplate;
        let references = self.map.set_points.iter().filter(|p| p.keys.quantity.moves());
        let written = references.filter_map(|point| Some((point, self.value(point)?)));
        // Of several references the one that is not zero, as the drive's own selection would be.
        let chosen = written.reduce(|a, b| if a.1.abs() >= b.1.abs() { a } else { b });
        let Some((point, value)) = chosen else {
            let has_reference = self.map.set_points.iter().any(|point| point.keys.quantity.moves());
            // Share of the rated speed with which a drive jogs whose profile has no reference.
            let jog = 0.1 * nameplate.rated_speed_rad_s;
            return Control::Speed(if has_reference { 0.0 } else { jog });
        };
        match (point.keys.quantity, point.numbers.unit) {
            (Quantity::Voltage, _) => Control::Voltage(value),
            (Quantity::Duty, _) => Control::Voltage(0.01 * value * self.limits_a_v.1),
            (Quantity::Current, _) => Control::Current(value),
            (Quantity::Torque, _) => Control::Current(0.01 * value * nameplate.rated_current_a),
            (_, Unit::Percent) => Control::Speed(0.01 * value * nameplate.rated_speed_rad_s),
            (_, unit) => Control::Speed(registers::rad_s(value, unit, point.si)),
        }
    }

    /// A reference as it was written, with its sign.
    fn value(&self, point: &SetPoint) -> Option<f64> {
        let address = point.location.address;
        let count = point.location.layout.cells();
        let registers: Option<Vec<u16>> = (address..address.checked_add(count)?)
            .map(|address| self.written.get(&address).copied())
            .collect();
        let raw = registers::number(point.location.layout, &registers?);
        let factor = self.factor(&point.numbers.scale_by);
        let value = raw * point.numbers.scale * factor + point.numbers.offset;
        let negative = point.keys.sign.as_ref().is_some_and(|sign| {
            let word = self.map.set_point(&sign.set_point);
            let word = word.and_then(|word| self.written.get(&word.location.address));
            word.is_some_and(|word| word & sign.mask != 0)
        });
        Some(if negative { -value } else { value })
    }

    /// Restarts the watchdog where a request of this kind counts.
    fn kick(&mut self, by: KickedBy) {
        let counts = match self.map.watchdog.keys.kicked_by {
            KickedBy::Any => true,
            KickedBy::Write => by != KickedBy::Any,
            KickedBy::Command => by == KickedBy::Command,
        };
        if counts {
            self.kicked_s = self.soft.time_s();
        }
    }

    fn written(&mut self, address: u16, word: u16) {
        let ignored = self.ignored.as_ref().and_then(|name| self.map.set_point(name));
        if ignored.is_none_or(|point| point.location.address != address) {
            self.written.insert(address, word);
        }
    }

    /// A whole write is over: what it makes the drive do.
    fn apply_write(&mut self, first: u16, count: u16) {
        let map = Arc::clone(&self.map);
        if let Some((location, unit_s)) = map.watchdog.time
            && (first..first.saturating_add(count)).contains(&location.address)
        {
            let raw = self.written.get(&location.address).copied().unwrap_or(0);
            self.watchdog_s = f64::from(raw) * unit_s;
            self.kick(KickedBy::Write);
        }
        for point in &map.set_points {
            if !(first..first.saturating_add(count)).contains(&point.location.address) {
                continue;
            }
            self.kick(KickedBy::Command);
            self.lapsed = false;
            if !point.is_word() {
                continue;
            }
            // Commands of the bus have no effect meanwhile.
            if self.hindrance.is_some() {
                continue;
            }
            let Some(number) = self.value(point) else { continue };
            if self.sequence.take(&map, &point.name, number, self.fault.is_some()) {
                self.fault = None;
                self.seq = self.seq.wrapping_add(1);
                self.soft.command(DriveCommand::new(self.seq, Control::ResetFault));
            }
        }
    }

    fn is_mapped(&self, table: CellTable, address: u16) -> bool {
        let within = |first: u16, count: u16| {
            u32::from(address) >= u32::from(first)
                && u32::from(address) < u32::from(first) + u32::from(count)
        };
        let signals = self.map.signals.iter().any(|signal| {
            let at = signal.location;
            at.table == table && within(at.address, at.layout.cells())
        });
        let points = table == CellTable::Holding || !self.map.functions.contains(&3);
        let is_in = |p: &SetPoint| within(p.location.address, p.location.layout.cells());
        let points = points && self.map.set_points.iter().any(is_in);
        let exact = self.map.exact_reads.iter().any(|(first, count)| within(*first, *count));
        let time = self.map.watchdog.time.as_ref();
        let time = table == CellTable::Holding && time.is_some_and(|(at, _)| at.address == address);
        signals || points || exact || time
    }
}

#[cfg(test)]
mod tests;

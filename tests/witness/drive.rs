//! The drive itself: a register map of its own, states, watchdog, and whatever fault is inflicted on it.

use super::codec::{self, Request};
use super::fault::{Act, FOUND_OUT_S, Reply, Sensor};
use super::motor::{Hidden, Motor};

/// Unit address.
const UNIT: u8 = 1;
/// One character at 115200 8N1, s.
const BYTE_S: f64 = 10.0 / 115_200.0;
/// From the end of a request until its values are taken and its writes act, and from there until the reply begins, s.
const ACTS_S: f64 = 0.0004;
const ANSWERS_S: f64 = 0.0004;
/// How much the latter varies, s.
const JITTER_S: f64 = 0.0004;
/// Bytes that stay alone for so long are no request, s.
const FRAGMENT_S: f64 = 0.05;
/// Between the two parts of a reply that an adapter splits, s.
const SPLIT_S: f64 = 0.004;
/// Beyond the pulse of the checks, V: only a run asks for so much.
const RUN_V: f64 = 30.0;
/// Highest voltage that the bridge gives, V.
const BUS_V: f64 = 140.0;
/// The drive's own trip, A.
const TRIP_A: f64 = 40.0;
/// Between two rows of the log at least, unless something is switched, s.
const LOG_S: f64 = 0.01;
/// Counts per turn of the angle.
const COUNTS: f64 = 4096.0;
const RPM: f64 = std::f64::consts::TAU / 60.0;
/// What has to be between a value that is told and the true one before anybody can see it: r/min, 0.01 A, V. Each is
/// what brushes and bridge may drop, 3 % to 5 % of the rated voltage, through resistance and back-EMF constant.
const SEEN_RPM: f64 = 100.0;
const SEEN_CENTIAMPERES: f64 = 500.0;
const SEEN_V: f64 = 5.0;
/// By so much another master wants less, 0.1 V.
const OTHER_DECIVOLTS: i16 = 60;
/// Torque of somebody who drives the shaft, N.m.
const PUSH_N_M: f64 = 4.5;

const STATUS: u16 = 100;
/// The telemetry: status, fault code, speed, current, voltage, bus, angle in two.
const TOLD: usize = 8;
const MODEL: u16 = 109;
const CONTROL: u16 = 200;
const REFERENCE: u16 = 201;
const WATCHDOG: u16 = 210;
/// What register 109 holds.
const MODEL_CODE: u16 = 0x5746;

const ENABLE: u16 = 0x01;
const RUN: u16 = 0x02;
const RESET: u16 = 0x80;

const READY: u16 = 0x01;
const ENABLED: u16 = 0x02;
const RUNNING: u16 = 0x04;
const FAULT: u16 = 0x08;
const COMM_LOSS: u16 = 0x10;
const LOCAL: u16 = 0x20;

/// The drive as its manual would describe it, as a profile.
pub(crate) const PROFILE: &str = include_str!("drive.toml");
/// What is done with it.
pub(crate) const BENCH: &str = include_str!("bench.toml");

/// The truth at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Row {
    pub(crate) time_s: f64,
    /// What the bridge puts out; 0 when it is off.
    pub(crate) volts: f64,
    pub(crate) current_a: f64,
    pub(crate) speed_rad_s: f64,
    pub(crate) is_on: bool,
}

/// Bytes that leave for the host, and when the last of them has left.
pub(crate) type Sent = (f64, Vec<u8>);

#[derive(Debug, Default)]
pub(crate) struct Drive {
    now_s: f64,
    motor: Motor,
    control: u16,
    reference: i16,
    watchdog_ms: u16,
    fault_code: u16,
    comm_loss: bool,
    kicked_s: f64,
    heard: Vec<u8>,
    heard_s: f64,
    noise: u64,
    act: Act,
    /// After the run asks for more than a pulse, s.
    delay_s: f64,
    /// When the fault begins, once that is known.
    pub(crate) from_s: Option<f64>,
    /// Since when every reading has told something else than the truth, s.
    apart_s: Option<f64>,
    /// When the host could first have seen it.
    pub(crate) visible_s: Option<f64>,
    /// Last write that was heard while the output was on.
    pub(crate) written_s: f64,
    done_once: bool,
    /// What the sensors told when they froze.
    frozen: Option<[u16; TOLD]>,
    stuck_v: f64,
    replies: u32,
    pub(crate) log: Vec<Row>,
}

impl Drive {
    pub(crate) fn new(act: Act, seed: u64) -> Self {
        let mut drive = Self {
            watchdog_ms: 500,
            noise: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1),
            act,
            ..Self::default()
        };
        drive.delay_s = 0.15 + 0.4 * drive.uniform();
        if act == Act::EnableIgnored {
            drive.from_s = Some(0.0);
        }
        drive
    }

    /// The same with a motor that has this besides.
    pub(crate) fn hiding(mut self, hidden: Hidden) -> Self {
        self.motor.hidden = hidden;
        self
    }

    /// Watchdog that is in force, s.
    pub(crate) fn watchdog_s(&self) -> f64 {
        f64::from(self.watchdog_ms) * 1e-3
    }

    /// When the host could first have seen the fault; where it was found out before it had to be, when the output went.
    pub(crate) fn seen_s(&self) -> Option<f64> {
        let found_out = || {
            let last = self.log.iter().rposition(|row| row.volts != 0.0)?;
            self.from_s.and(self.log.get(last + 1)).map(|row| row.time_s)
        };
        self.visible_s.or_else(found_out)
    }

    pub(crate) fn is_unplugged(&self) -> bool {
        self.act == Act::Unplugged && self.is_faulty()
    }

    pub(crate) fn is_on(&self) -> bool {
        self.control & RUN != 0
    }

    pub(crate) fn volts(&self) -> f64 {
        if !self.is_on() {
            return 0.0;
        }
        if self.is_faulty() && self.act == Act::SetPointsIgnored {
            return self.stuck_v;
        }
        (f64::from(self.reference) * 0.1).clamp(-BUS_V, BUS_V)
    }

    pub(crate) fn angle_rad(&self) -> f64 {
        self.motor.angle_rad
    }

    /// Uniform from 0 to 1.
    fn uniform(&mut self) -> f64 {
        self.noise ^= self.noise << 13;
        self.noise ^= self.noise >> 7;
        self.noise ^= self.noise << 17;
        (self.noise >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// The fault is there.
    pub(crate) fn is_faulty(&self) -> bool {
        self.from_s.is_some_and(|from_s| self.now_s >= from_s)
    }

    /// Time since it began, s.
    fn faulty_for_s(&self) -> Option<f64> {
        self.from_s.map(|from_s| self.now_s - from_s).filter(|for_s| *for_s >= 0.0)
    }

    /// Neither side hears the other.
    fn is_deaf(&self) -> bool {
        let Some(for_s) = self.faulty_for_s() else {
            return false;
        };
        match self.act {
            Act::Dead(seconds) | Act::PowerLost(seconds) => for_s < seconds,
            Act::Unplugged => true,
            _ => false,
        }
    }

    /// Lets time pass; a time that has passed changes nothing.
    pub(crate) fn advance(&mut self, to_s: f64) {
        // In pieces, so that watchdog and faults begin when they should.
        while self.now_s < to_s {
            let next_s = to_s.min(self.now_s + 0.001);
            let volts = self.is_on().then(|| self.volts());
            self.motor.advance(volts, next_s - self.now_s);
            self.now_s = next_s;
            self.supervise();
            let logged_s = self.log.last().map_or(f64::NEG_INFINITY, |row| row.time_s);
            if self.now_s - logged_s >= LOG_S {
                self.note();
            }
        }
    }

    fn note(&mut self) {
        self.log.push(Row {
            time_s: self.now_s,
            volts: self.volts(),
            current_a: self.motor.current_a,
            speed_rad_s: self.motor.speed_rad_s,
            is_on: self.is_on(),
        });
    }

    fn off(&mut self) {
        self.control = 0;
        self.reference = 0;
        self.note();
    }

    fn supervise(&mut self) {
        if self.control & ENABLE != 0
            && self.watchdog_ms > 0
            && self.now_s - self.kicked_s > self.watchdog_s()
        {
            self.comm_loss = true;
            self.off();
        }
        if self.motor.current_a.abs() > TRIP_A && self.fault_code == 0 {
            self.fault_code = 1;
            self.off();
        }
        if self.from_s.is_none() && self.volts().abs() > RUN_V {
            self.from_s = Some(self.now_s + self.delay_s);
        }
        if self.is_faulty() && !std::mem::replace(&mut self.done_once, true) {
            self.begin();
        }
    }

    /// What the fault does by itself when it begins.
    fn begin(&mut self) {
        match self.act {
            Act::Trip => {
                self.fault_code = 7;
                self.off();
            }
            Act::CommLoss => {
                self.comm_loss = true;
                self.off();
            }
            Act::PowerLost(_) => {
                self.off();
                self.watchdog_ms = 500;
            }
            Act::SetPointsIgnored => self.stuck_v = f64::from(self.reference) * 0.1,
            Act::Blocked => self.motor.is_blocked = true,
            Act::Driven => self.motor.pushed_n_m = PUSH_N_M * self.motor.speed_rad_s.signum(),
            Act::FrozenRegisters | Act::Speed(Sensor::Frozen) | Act::Current(Sensor::Frozen) => {
                self.frozen = Some(self.truth());
            }
            _ => {}
        }
        if matches!(
            self.act,
            Act::Dead(_) | Act::Mute | Act::Unplugged | Act::Busy(_) | Act::PowerLost(_)
        ) {
            self.visible_s = self.from_s;
        }
    }

    /// Bytes from the host, all of them there at this time; what goes back, and when.
    pub(crate) fn hear(&mut self, now_s: f64, bytes: &[u8]) -> Vec<Sent> {
        self.advance(now_s);
        if self.is_deaf() {
            self.heard.clear();
            return Vec::new();
        }
        if now_s - self.heard_s > FRAGMENT_S {
            self.heard.clear();
        }
        self.heard_s = now_s;
        self.heard.extend(bytes);
        let mut sent = Vec::new();
        loop {
            match codec::request(&self.heard) {
                None => return sent,
                Some(Err(_)) => self.heard.clear(),
                Some(Ok((unit, request, count))) => {
                    self.heard.drain(..count);
                    if unit == UNIT {
                        self.advance(now_s + count as f64 * BYTE_S + ACTS_S);
                        let reply = self.serve(&request);
                        self.send(reply, &mut sent);
                    }
                }
            }
        }
    }

    fn serve(&mut self, request: &Request) -> Vec<u8> {
        // Writes are taken: the stop has to arrive.
        if let (Act::Exception(code), Request::Read { function, .. }) = (self.act, request)
            && self.is_faulty()
        {
            self.see();
            return codec::exception(UNIT, *function, code);
        }
        match request {
            Request::Read { function, address, count } => match self.read(*address, *count) {
                Some(values) => codec::registers(UNIT, *function, &values),
                None => codec::exception(UNIT, *function, 2),
            },
            Request::Write { function, address, values } => {
                if self.write(*address, values) {
                    codec::written(UNIT, *function, *address, values)
                } else {
                    codec::exception(UNIT, *function, 2)
                }
            }
            Request::WriteRead { read: (address, count), write, values } => {
                let written = self.write(*write, values);
                match self.read(*address, *count).filter(|_| written) {
                    Some(values) => codec::registers(UNIT, 23, &values),
                    None => codec::exception(UNIT, 23, 2),
                }
            }
            Request::Echo(body) => codec::framed(&[&[UNIT, 8][..], body].concat()),
            Request::Unknown(function) => codec::exception(UNIT, *function, 1),
        }
    }

    fn status(&self) -> u16 {
        let healthy = self.fault_code == 0 && !self.comm_loss;
        let runs = self.is_on() && self.act != Act::EnableIgnored;
        let local = self.act == Act::LocalControl && self.is_faulty();
        [
            (healthy, READY),
            (self.control & ENABLE != 0, ENABLED),
            (runs, RUNNING),
            (self.fault_code != 0, FAULT),
            (self.comm_loss, COMM_LOSS),
            (local, LOCAL),
        ]
        .into_iter()
        .filter_map(|(holds, bit)| holds.then_some(bit))
        .sum()
    }

    /// The telemetry as it is.
    fn truth(&self) -> [u16; TOLD] {
        let raw = |value: f64| (value.round() as i16).cast_unsigned();
        let angle = (self.motor.angle_rad / std::f64::consts::TAU * COUNTS).floor() as i64 as u32;
        [
            self.status(),
            self.fault_code,
            raw(self.motor.speed_rad_s / RPM),
            raw(self.motor.current_a * 100.0),
            raw(self.volts() * 10.0),
            raw(BUS_V * 10.0),
            (angle >> 16) as u16,
            angle as u16,
        ]
    }

    /// The telemetry as it is told.
    fn told(&mut self) -> [u16; TOLD] {
        let mut true_words = self.truth();
        let ripple = (self.uniform() - 0.5) * 6.0;
        let current = f64::from(true_words[3].cast_signed()) + ripple;
        true_words[3] = (current.round() as i16).cast_unsigned();
        if !self.is_faulty() {
            return true_words;
        }
        let mut told = true_words;
        let scaled = |word: u16, by: f64| {
            (f64::from(word.cast_signed()) * by).round().clamp(-32_000.0, 32_000.0) as i16
        };
        match (self.act, self.frozen) {
            (Act::FrozenRegisters, Some(frozen)) => told = frozen,
            (Act::Speed(Sensor::Frozen), Some(frozen)) => {
                told[2] = frozen[2];
                told[6..].copy_from_slice(&frozen[6..]);
            }
            (Act::Current(Sensor::Frozen), Some(frozen)) => told[3] = frozen[3],
            (Act::Speed(Sensor::Scaled(by)), _) => told[2] = scaled(told[2], by).cast_unsigned(),
            (Act::Current(Sensor::Scaled(by)), _) => told[3] = scaled(told[3], by).cast_unsigned(),
            (Act::InvalidCodes, _) => (told[2], told[3]) = (0x7FFF, 0x7FFF),
            _ => {}
        }
        let apart = |at: usize| {
            let [told, truth] = [told[at], true_words[at]].map(|w| f64::from(w.cast_signed()));
            (told - truth).abs()
        };
        let asked = f64::from(self.reference) * 0.1;
        let is_seen = match self.act {
            Act::Speed(_) => apart(2) >= SEEN_RPM,
            Act::Current(_) => apart(3) >= SEEN_CENTIAMPERES,
            Act::FrozenRegisters => apart(2) >= SEEN_RPM || apart(3) >= SEEN_CENTIAMPERES,
            Act::SetPointsIgnored => (asked - self.volts()).abs() >= SEEN_V,
            Act::Blocked => self.motor.current_a.abs() >= 13.0,
            Act::Driven => self.motor.speed_rad_s.abs() >= 175.0,
            Act::SecondMaster | Act::LateOnce(_) => false,
            _ => true,
        };
        let is_seen = is_seen && self.is_on() || matches!(self.act, Act::Trip | Act::CommLoss);
        // A single reading says nothing of its sensor. A current that is read four times as large for less than the time in
        // which it has to be found out, at the end of an acceleration, and then differs not enough for as long as a loop holds
        // its speed, cannot be told from a true one.
        let shown_s = match self.act {
            Act::Speed(_) => Some(0.0),
            Act::Current(_) => Some(FOUND_OUT_S),
            _ => None,
        };
        let since_s = self.apart_s.filter(|_| shown_s.is_some());
        self.apart_s = is_seen.then(|| since_s.unwrap_or(self.now_s));
        let for_s = since_s.map(|since_s| self.now_s - since_s);
        let is_shown = shown_s.is_none_or(|shown_s| for_s.is_some_and(|for_s| for_s >= shown_s));
        if is_seen && is_shown {
            self.visible_s = self.visible_s.or(self.apart_s);
        }
        told
    }

    fn see(&mut self) {
        self.visible_s.get_or_insert(self.now_s);
    }

    fn read(&mut self, address: u16, count: u16) -> Option<Vec<u16>> {
        let told = self.told();
        (address..address.checked_add(count)?)
            .map(|address| match address {
                MODEL => Some(MODEL_CODE),
                108 => Some(0),
                CONTROL => Some(self.control),
                REFERENCE => Some(self.reference.cast_unsigned()),
                WATCHDOG => Some(self.watchdog_ms),
                _ => {
                    let at = usize::from(address.checked_sub(STATUS)?);
                    told.get(at).copied()
                }
            })
            .collect()
    }

    fn write(&mut self, address: u16, values: &[u16]) -> bool {
        self.kicked_s = self.now_s;
        if self.is_on() {
            self.written_s = self.now_s;
        }
        let deaf = matches!(self.act, Act::StopIgnored(_)) && self.is_faulty();
        for (address, value) in (address..).zip(values) {
            match address {
                CONTROL | REFERENCE if deaf => {}
                CONTROL => self.command(*value),
                REFERENCE => self.reference = value.cast_signed(),
                WATCHDOG => self.watchdog_ms = *value,
                _ => return false,
            }
        }
        self.note();
        true
    }

    fn command(&mut self, word: u16) {
        if word & RESET != 0 {
            (self.fault_code, self.comm_loss) = (0, false);
            self.control = 0;
            return;
        }
        if self.fault_code != 0 || self.comm_loss {
            return;
        }
        self.control = word & (ENABLE | RUN);
        if self.control & ENABLE == 0 {
            self.control = 0;
            self.reference = 0;
        }
        if self.act == Act::EnableIgnored {
            self.control &= ENABLE;
        }
    }

    /// Puts a reply on the line, and whatever is done to it.
    fn send(&mut self, reply: Vec<u8>, sent: &mut Vec<Sent>) {
        self.replies += 1;
        let drawn = self.uniform() * 1000.0;
        let mut begin_s = self.now_s + ANSWERS_S + JITTER_S * self.uniform();
        let mut reply = reply;
        let (mut again, mut spoilt) = (None, None);
        if let Some(for_s) = self.faulty_for_s() {
            match self.act {
                Act::Mute => return,
                Act::Busy(seconds) if for_s < seconds => begin_s += seconds - for_s,
                Act::LateOnce(late_s) if self.visible_s.is_none() => {
                    self.see();
                    begin_s += late_s;
                }
                Act::Replies(what, per_mille) if drawn < f64::from(per_mille) => {
                    self.see();
                    spoilt = Some(what);
                }
                Act::PoorLine(late_s, per_mille) if drawn < 3.0 * f64::from(per_mille) => {
                    let kinds = [Reply::Late(late_s), Reply::Lost, Reply::Doubled];
                    spoilt = Some(kinds[(drawn / f64::from(per_mille)) as usize]);
                }
                Act::RoughLine(late_s, per_mille) if drawn < f64::from(per_mille) => {
                    let kinds = [
                        Reply::Late(late_s),
                        Reply::Lost,
                        Reply::Doubled,
                        Reply::GarbageBefore,
                        Reply::GarbageAfter,
                        Reply::WrongCrc,
                        Reply::Truncated,
                        Reply::OtherUnit,
                        Reply::Split(SPLIT_S),
                    ];
                    let at = drawn / f64::from(per_mille) * kinds.len() as f64;
                    spoilt = Some(kinds[at as usize]);
                }
                _ => {}
            }
        }
        let mut pause_s = 0.0;
        match spoilt {
            None => {}
            Some(Reply::Late(late_s)) => begin_s += late_s,
            Some(Reply::Split(seconds)) => pause_s = seconds,
            Some(Reply::Lost) => return,
            Some(Reply::Doubled) => again = Some(reply.clone()),
            Some(Reply::GarbageBefore) => {
                reply.splice(0..0, [0x5A, 0x00, 0xC3]);
            }
            Some(Reply::GarbageAfter) => reply.extend([0xFF, 0x12]),
            Some(Reply::WrongCrc) => {
                if let Some(last) = reply.last_mut() {
                    *last ^= 0x55;
                }
            }
            Some(Reply::Truncated) => reply.truncate(reply.len() / 2),
            Some(Reply::OtherUnit) => {
                let body = reply.len() - 2;
                reply[0] = UNIT + 1;
                reply = codec::framed(&reply[..body]);
            }
        }
        let mut put = |bytes: Vec<u8>, begin_s: f64| {
            let end_s = begin_s + bytes.len() as f64 * BYTE_S + std::mem::take(&mut pause_s);
            let mut bytes = bytes;
            let rest = bytes.split_off(1.min(bytes.len()));
            sent.push((begin_s + BYTE_S, bytes));
            sent.push((end_s, rest));
            end_s
        };
        let end_s = put(reply, begin_s);
        if let Some(reply) = again {
            put(reply, end_s + 0.001);
        }
        // Between two of our exchanges the line is somebody else's.
        if self.is_faulty() && self.replies.is_multiple_of(8) {
            match self.act {
                Act::ForeignFrames => {
                    self.see();
                    let end_s = put(codec::framed(&[7, 3, 0, 10, 0, 2]), end_s + 0.002);
                    put(codec::registers(7, 3, &[17, 4]), end_s + 0.002);
                }
                Act::SecondMaster => {
                    let other = self.reference - OTHER_DECIVOLTS * self.reference.signum();
                    let [high, low] = other.to_be_bytes();
                    let frame = codec::framed(&[UNIT, 6, 0, 201, high, low]);
                    let end_s = put(frame.clone(), end_s + 0.002);
                    put(frame, end_s + 0.002);
                    let was = self.volts();
                    self.reference = other;
                    self.note();
                    if (was - self.volts()).abs() >= SEEN_V {
                        self.see();
                    }
                }
                _ => {}
            }
        }
    }
}

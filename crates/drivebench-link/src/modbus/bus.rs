//! The Modbus link as a bus of registers, proven as a drive's profile allows.
//!
//! ```text
//! in step? (proof.rs) -> read -> reply -> the time that replies usually take, and the gap
//!                                                  -> nothing else came? -> value
//! ```
//!
//! A copy of an earlier reply that comes in the place of the true one is followed by it: so a value is handed on only
//! when the time of the true one is over. The gap is waited for behind the reply instead of before the next request.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::time::Duration;

use tokio_modbus::Request;
use tokio_modbus::prelude::ReadCode;

use super::{
    LinkError, ModbusLink, NAMES, NAMES_BYTES, Question, acknowledged, identification, now,
    object_text, objects, words,
};
use crate::framing::FrameKind;
use crate::link::{DriveLink, LinkName, LinkStatistics, Result, RoundTrips};
use crate::proof::Method;
use crate::register_bus::{RTU, ReadRequest, RegisterBus, RegistersRead, Span, registers};
use crate::register_map::{PollRate, ReadBlock, RegisterMap, Resync, plan_reads};
use crate::timing::wait_until;
use crate::transaction::{LineCounts, StopRequest};

/// Round trips from which the usual time of a reply is estimated.
const ROUND_TRIPS: usize = 32;

/// A Modbus link that proves the match of request and reply by a method that the drive supports.
pub struct ModbusBus {
    link: ModbusLink,
    emulated: bool,
    /// The unit answers no probe.
    silence_proves: bool,
    /// Of the latest reads, and how much longer than their wire time they took.
    round_trips: VecDeque<(Duration, Duration)>,
}

impl ModbusBus {
    pub fn new(mut link: ModbusLink, map: &RegisterMap) -> Self {
        let is_exact = |block: &ReadBlock| {
            let whole = (block.read.address, block.read.count);
            map.exact_reads.contains(&whole)
        };
        // Registers that can be read in any number up to the whole, for the length code.
        let blocks = plan_reads(map, PollRate::Fast).into_iter();
        let place = blocks.filter(|block| !is_exact(block)).max_by_key(|block| block.read.count);
        let method = match map.resync {
            Resync::Fc08 => Method::Nonce,
            Resync::Length => Method::Length,
            Resync::Tid | Resync::None => Method::Silence,
        };
        let place = place.map(|block| (block.read, block.read.count));
        link.exchange.proof.set_policy(method, place);
        Self {
            link,
            silence_proves: method == Method::Silence,
            emulated: false,
            round_trips: VecDeque::with_capacity(ROUND_TRIPS),
        }
    }

    /// Whether the far end is the software drive of this process.
    #[must_use]
    pub const fn emulated(mut self, emulated: bool) -> Self {
        self.emulated = emulated;
        self
    }

    /// A read whose reply is accepted only if no second one comes within the usual time of a reply.
    fn alone(
        &mut self,
        question: Question<'_>,
        count: u16,
        wire: Duration,
    ) -> Result<RegistersRead> {
        let what = question.query.what;
        let sent = now();
        let stale_frames =
            |bus: &Self| bus.link.exchange.filter.inner().reception.line.stale_frames;
        let before = stale_frames(self);
        let usual = self.longest(|(took, _)| *took);
        if self.link.exchange.core.bound.ends_before(sent + usual) {
            // Its reply would arrive outside an exchange and put the line in doubt.
            return Err(self.link.exchange.unproven());
        }
        let answer = self.link.call(question, words(count.into()))?;
        let answer = RegistersRead { words: answer.value, span: answer.span };
        if self.link.exchange.kind == FrameKind::Tcp {
            return Ok(answer);
        }
        let took = now().saturating_duration_since(sent);
        self.remember(took, wire);
        if took < usual {
            wait_until(sent + usual);
        }
        if !self.link.exchange.proof.is_doubtful() {
            self.link.exchange.listen_out()?;
        }
        if self.link.exchange.proof.is_doubtful() {
            let name = self.link.exchange.core.name.clone();
            return Err(if stale_frames(self) > before {
                LinkError::Stale(name, format!("another reply came with that to {what}"))
            } else {
                LinkError::Corrupt(name, format!("other bytes came with the reply to {what}"))
            });
        }
        Ok(answer)
    }

    /// Time of one exchange: a bounded one belongs to a cycle.
    fn allowed(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        let core = &self.link.exchange.core;
        if core.bound.is_set() {
            core.timing.hurried(request_bytes, reply_bytes)
        } else {
            core.timing.allowed(request_bytes, reply_bytes)
        }
    }

    /// Updates the usual time of a reply; a silence that is the only proof keeps its length.
    fn remember(&mut self, took: Duration, wire: Duration) {
        if self.round_trips.len() == ROUND_TRIPS {
            self.round_trips.pop_front();
        }
        let lag = took.saturating_sub(wire);
        self.round_trips.push_back((took, lag));
        if self.round_trips.len() == ROUND_TRIPS && !self.silence_proves {
            let lag = self.longest(|(_, lag)| *lag);
            let timing = &mut self.link.exchange.core.timing;
            timing.measured(lag);
            self.link.exchange.proof.set_quiet(timing.quiet());
        }
    }

    /// Longest of the latest round trips except the two longest, which a busy host may have delayed.
    fn longest(&self, of: impl Fn(&(Duration, Duration)) -> Duration) -> Duration {
        let mut longest: Vec<Duration> = self.round_trips.iter().map(of).collect();
        longest.sort_unstable_by(|a, b| b.cmp(a));
        longest.get(2).copied().unwrap_or_default()
    }

    fn put(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
        allowed: Duration,
    ) -> Result<Span> {
        let what = format!("write {values:04x?} at {address}");
        let [high, low] = address.to_be_bytes();
        let request = match (function, values) {
            (6, [value]) => Request::WriteSingleRegister(address, *value),
            _ => Request::WriteMultipleRegisters(address, Cow::Borrowed(values)),
        };
        let question = Question::plain(request, [function, high, low, 0, 0], &what, allowed);
        Ok(self.link.call(question, acknowledged)?.span)
    }
}

impl RegisterBus for ModbusBus {
    fn name(&self) -> LinkName {
        self.link.name()
    }

    fn now_s(&self) -> f64 {
        self.link.exchange.core.host_s(now())
    }

    fn pause_until_s(&mut self, time_s: f64) {
        if let Ok(since) = Duration::try_from_secs_f64(time_s) {
            wait_until(self.link.exchange.core.epoch + since);
        }
    }

    fn read(&mut self, read: ReadRequest) -> Result<RegistersRead> {
        let (what, reply) = (read.text(), read.reply_bytes());
        let mut attempt = 1;
        loop {
            let result = self.link.in_step(&read.pdu()).and_then(|()| {
                let question = Question::read(read, &what, self.allowed(RTU.read, reply));
                let wire = self.link.exchange.core.timing.wire(RTU.read, reply);
                self.alone(question, read.count, wire)
            });
            match result {
                Err(error) if self.link.exchange.may_retry(&error, attempt) => attempt += 1,
                result => return result,
            }
        }
    }

    fn write(&mut self, function: u8, address: u16, values: &[u16]) -> Result<Span> {
        self.link.in_step(&[function])?;
        let allowed = self.allowed(RTU.write + 2 * values.len(), RTU.written);
        self.put(function, address, values, allowed)
    }

    fn write_at_once(&mut self, function: u8, address: u16, values: &[u16]) -> Result<Span> {
        self.link.exchange.listen()?;
        let bytes = RTU.write + 2 * values.len();
        let timing = &self.link.exchange.core.timing;
        let mut allowed = timing.allowed(bytes, RTU.written);
        if self.link.exchange.proof.is_doubtful() {
            // On a line in doubt the reply is awaited no longer than usual.
            allowed = allowed.min(timing.brief(bytes, RTU.written));
        }
        // What stops a drive has its own short time, whatever is left of that for reading.
        let bound = std::mem::take(&mut self.link.exchange.core.bound);
        let result = self.put(function, address, values, allowed);
        self.link.exchange.core.bound = bound;
        result
    }

    fn read_write(
        &mut self,
        (to, values): (u16, &[u16]),
        (from, count): (u16, u16),
    ) -> Result<RegistersRead> {
        let read = ReadRequest::holding(from, count);
        let [_, a, b, c, d] = read.pdu();
        let pdu = [23, a, b, c, d];
        self.link.in_step(&pdu)?;
        let (bytes, reply) = (RTU.read_write + 2 * values.len(), read.reply_bytes());
        let read = registers(count.into());
        let what = format!("write {values:04x?} at {to} and read {read} at {from}");
        let request = Request::ReadWriteMultipleRegisters(from, count, to, Cow::Borrowed(values));
        let question = Question::plain(request, pdu, &what, self.allowed(bytes, reply));
        let wire = self.link.exchange.core.timing.wire(bytes, reply);
        self.alone(question, count, wire)
    }

    fn object(&mut self, object: u8) -> Result<Option<String>> {
        let allowed = self.link.exchange.core.timing.allowed(NAMES_BYTES.0, NAMES_BYTES.1);
        let question = identification(ReadCode::Specific, object, NAMES, allowed);
        match self.link.ask(question, objects) {
            Ok(objects) => Ok(object_text(&objects.value, object)),
            Err(LinkError::Exception { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn is_emulated(&self) -> bool {
        self.emulated
    }

    fn close(&mut self) {
        self.link.close();
    }

    fn statistics(&self) -> LinkStatistics {
        self.link.statistics()
    }

    fn round_trips(&self) -> Option<&RoundTrips> {
        self.link.round_trips()
    }

    fn line(&self) -> Option<LineCounts> {
        self.link.line()
    }

    fn bound(&mut self, left_s: f64) {
        DriveLink::bound(&mut self.link, left_s);
    }

    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        self.link.stop_request()
    }

    fn wire_s(&self, request_bytes: usize, reply_bytes: usize) -> Option<f64> {
        let timing = &self.link.exchange.core.timing;
        timing.shortest_cycle_s(request_bytes, reply_bytes)
    }
}

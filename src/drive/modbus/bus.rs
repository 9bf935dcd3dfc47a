//! The Modbus link as a bus of registers, proven as a drive's profile allows.
//!
//! ```text
//! in step? (transaction/proof.rs) -> read -> reply -> the time that replies usually take, and the gap
//!                                                  -> nothing else came? -> value
//! ```
//!
//! A copy of an earlier reply that comes in the place of the true one is followed by it: so a value is handed on only
//! when the time of the true one is over. The gap is waited for behind the reply instead of before the next request.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::time::Duration;

use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Request, Response};

use super::{LinkError, ModbusLink, NAMES, Question, RegisterTable, now, question, words};
use crate::drive::link::{DriveLink, LinkName, LinkStatistics};
use crate::drive::raw::{ReadRequest, registers};
use crate::drive::register_bus::{Carried, RegisterBus, RegistersRead};
use crate::drive::register_map::{PollRate, ReadBlock, RegisterMap, Resync, plan_reads};
use crate::drive::reply::FrameKind;
use crate::drive::tally::RoundTrips;
use crate::drive::timing::wait_until;
use crate::drive::transaction::{CutIn, LineCounts, Method};

/// Round trips that tell how long replies usually take, and how many of them a busy host may have made too long.
const REMEMBERED: usize = 32;
const OUTLIERS: usize = 2;

/// A Modbus link that proves itself fresh in the way that the far end knows.
pub struct ModbusBus {
    link: ModbusLink,
    emulated: bool,
    /// The far end answers no probe.
    silence_proves: bool,
    /// Of the latest reads, and how much longer than their wire time they took.
    round_trips: VecDeque<(Duration, Duration)>,
}

impl ModbusBus {
    pub fn new(mut link: ModbusLink, map: &RegisterMap) -> Self {
        let exact = |block: &ReadBlock| {
            map.exact_reads
                .iter()
                .any(|(first, count)| (*first, *count) == (block.address, block.count))
        };
        // Registers that can be read in any number up to the whole, for the length code.
        let blocks = plan_reads(map, PollRate::Fast).into_iter();
        let place = blocks.filter(|block| !exact(block));
        let place = place.max_by_key(|block| block.count).map(|block| {
            let read = ReadRequest {
                table: block.table,
                address: block.address,
                count: block.count,
            };
            (read, block.count)
        });
        let method = match map.resync {
            Resync::Fc08 => Method::Nonce,
            Resync::Length => Method::Length,
            Resync::Tid | Resync::None => Method::Silence,
        };
        link.proof.set_policy(method, place);
        Self {
            link,
            silence_proves: method == Method::Silence,
            emulated: false,
            round_trips: VecDeque::with_capacity(REMEMBERED),
        }
    }

    /// Whether the far end is the software drive of this process.
    #[must_use]
    pub const fn emulated(mut self, emulated: bool) -> Self {
        self.emulated = emulated;
        self
    }

    /// A read whose reply is taken only where no other came within the time that one usually takes.
    fn ask_alone(&mut self, read: ReadRequest) -> Result<RegistersRead, LinkError> {
        let what = format!("read {} at {}", registers(read.count.into()), read.address);
        let allowed = self.allowed(READ_BYTES, read.reply_bytes());
        let wire = self.link.timing.wire(READ_BYTES, read.reply_bytes());
        self.alone(question(read, &what, allowed), wire, words(read))
    }

    /// A question whose answer is taken only where no other came within the time that one usually takes.
    fn alone(
        &mut self,
        question: Question<'_>,
        wire: Duration,
        check: impl FnOnce(Response) -> Result<Vec<u16>, String>,
    ) -> Result<RegistersRead, LinkError> {
        let what = question.what;
        let sent = now();
        let answer = self.link.call(question, check)?;
        let answer = RegistersRead {
            words: answer.value,
            asked_s: answer.asked_s,
            answered_s: answer.answered_s,
        };
        if self.link.kind == FrameKind::Tcp {
            return Ok(answer);
        }
        let took = now().saturating_duration_since(sent);
        let usual = self.longest(|(took, _)| *took);
        self.remember(took, wire);
        if took < usual {
            wait_until(sent + usual);
        }
        if !self.link.proof.is_suspect() {
            self.link.listen()?;
        }
        if self.link.proof.is_suspect() {
            return Err(LinkError::Stale {
                link: self.link.name.clone(),
                reason: format!("something else came with the reply to {what}"),
            });
        }
        Ok(answer)
    }

    /// Time of one exchange: a bounded one belongs to a cycle.
    fn allowed(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        let timing = &self.link.timing;
        if self.link.bound.is_set() {
            timing.hurried(request_bytes, reply_bytes)
        } else {
            timing.allowed(request_bytes, reply_bytes)
        }
    }

    /// What replies have shown of how long they take; silence that alone has to prove the line stays as long as it was.
    fn remember(&mut self, took: Duration, wire: Duration) {
        if self.round_trips.len() == REMEMBERED {
            self.round_trips.pop_front();
        }
        self.round_trips
            .push_back((took, took.saturating_sub(wire)));
        if self.round_trips.len() == REMEMBERED && !self.silence_proves {
            let lag = self.longest(|(_, lag)| *lag);
            self.link.timing.measured(lag);
            self.link.proof.set_quiet(self.link.timing.quiet());
        }
    }

    /// Longest of the latest replies, a busy host left out.
    fn longest(&self, of: impl Fn(&(Duration, Duration)) -> Duration) -> Duration {
        let mut longest: Vec<Duration> = self.round_trips.iter().map(of).collect();
        longest.sort_unstable_by(|a, b| b.cmp(a));
        longest.get(OUTLIERS).copied().unwrap_or_default()
    }

    fn put(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
        allowed: Duration,
    ) -> Result<Carried, LinkError> {
        let what = format!("write {values:04x?} at {address}");
        let [high, low] = address.to_be_bytes();
        let request = match (function, values) {
            (6, [value]) => Request::WriteSingleRegister(address, *value),
            _ => Request::WriteMultipleRegisters(address, Cow::Borrowed(values)),
        };
        let question = Question::plain(request, [function, high, low, 0, 0], &what, allowed);
        let answer = self.link.call(question, |response| match response {
            Response::WriteSingleRegister(..) | Response::WriteMultipleRegisters(..) => Ok(()),
            other => Err(format!("{other:?}")),
        });
        answer.map(|answer| Carried {
            asked_s: answer.asked_s,
            answered_s: answer.answered_s,
        })
    }
}

/// RTU frames of a read, of a write of several registers and of a request of function code 23, beside the registers that
/// they write, and of the acknowledgement of a write.
const READ_BYTES: usize = 8;
const WRITE_BYTES: usize = 9;
const READ_WRITE_BYTES: usize = 13;
const WRITTEN_BYTES: usize = 8;

impl RegisterBus for ModbusBus {
    fn name(&self) -> LinkName {
        LinkName(self.link.name.clone())
    }

    fn now_s(&self) -> f64 {
        self.link.host_s(now())
    }

    fn pause_until_s(&mut self, time_s: f64) {
        if let Ok(since) = Duration::try_from_secs_f64(time_s) {
            wait_until(self.link.epoch + since);
        }
    }

    fn read(
        &mut self,
        table: RegisterTable,
        address: u16,
        count: u16,
    ) -> Result<RegistersRead, LinkError> {
        let read = ReadRequest {
            table,
            address,
            count,
        };
        let mut attempt = 1;
        loop {
            let result = self.link.in_step(&read.pdu());
            match result.and_then(|()| self.ask_alone(read)) {
                Err(error) if self.link.may_retry(&error, attempt) => attempt += 1,
                result => return result,
            }
        }
    }

    fn write(&mut self, function: u8, address: u16, values: &[u16]) -> Result<Carried, LinkError> {
        self.link.in_step(&[function])?;
        let allowed = self.allowed(WRITE_BYTES + 2 * values.len(), WRITTEN_BYTES);
        self.put(function, address, values, allowed)
    }

    fn write_at_once(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
    ) -> Result<Carried, LinkError> {
        self.link.listen()?;
        let allowed = self
            .link
            .brief(WRITE_BYTES + 2 * values.len(), WRITTEN_BYTES);
        // What stops a drive has its own short time, whatever is left of that for reading.
        let bound = std::mem::take(&mut self.link.bound);
        let result = self.put(function, address, values, allowed);
        self.link.bound = bound;
        result
    }

    fn read_write(
        &mut self,
        (to, values): (u16, &[u16]),
        (from, count): (u16, u16),
    ) -> Result<RegistersRead, LinkError> {
        let [from_high, from_low] = from.to_be_bytes();
        let [count_high, count_low] = count.to_be_bytes();
        let pdu = [23, from_high, from_low, count_high, count_low];
        self.link.in_step(&pdu)?;
        let words = usize::from(count);
        let request_bytes = READ_WRITE_BYTES + 2 * values.len();
        let allowed = self.allowed(request_bytes, 5 + 2 * words);
        let what = format!(
            "write {values:04x?} at {to} and read {} at {from}",
            registers(words)
        );
        let request = Request::ReadWriteMultipleRegisters(from, count, to, Cow::Borrowed(values));
        let question = Question::plain(request, pdu, &what, allowed);
        let wire = self.link.timing.wire(request_bytes, 5 + 2 * words);
        self.alone(question, wire, |response| match response {
            Response::ReadWriteMultipleRegisters(values) if values.len() == words => Ok(values),
            other => Err(format!("{other:?}")),
        })
    }

    fn object(&mut self, object: u8) -> Result<Option<String>, LinkError> {
        let pdu = [43, 14, 4, object, 0];
        self.link.in_step(&pdu)?;
        let request = Request::ReadDeviceIdentification(ReadCode::Specific, object);
        let allowed = self.link.timing.allowed(7, 256);
        let question = Question::plain(request, pdu, NAMES, allowed);
        let answer = self.link.call(question, |response| match response {
            Response::ReadDeviceIdentification(names) => Ok(names.device_id_objects),
            other => Err(format!("{other:?}")),
        });
        match answer {
            Ok(objects) => Ok(objects
                .value
                .iter()
                .find(|found| found.id == object)
                .and_then(|found| found.value_as_str())
                .map(str::to_owned)),
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
        self.link.tally.statistics
    }

    fn round_trips(&self) -> Option<&RoundTrips> {
        Some(&self.link.tally.round_trips)
    }

    fn line(&self) -> Option<LineCounts> {
        Some(self.link.line_counts())
    }

    fn bound(&mut self, left_s: f64) {
        DriveLink::bound(&mut self.link, left_s);
    }

    fn cut_in(&mut self) -> Option<&mut CutIn> {
        self.link.cut_in()
    }

    fn wire_s(&self, request_bytes: usize, reply_bytes: usize) -> Option<f64> {
        self.link
            .timing
            .shortest_cycle_s(request_bytes, reply_bytes)
    }
}

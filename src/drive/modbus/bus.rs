//! The Modbus link as a bus of registers, resynchronised as a drive's profile allows.
//!
//! ```text
//! suspect? -> silence for the longest turnaround -> fc08: a number of our own comes back
//!                                                  length: a read of a length that nobody waits for
//!                                                  none: silence is all there is
//! read     -> reply -> the time that replies usually take, and the gap -> nothing else came? -> value
//! ```
//!
//! A copy of an earlier reply that comes in the place of the true one is followed by it: so a value is handed on only
//! when the time of the true one is over. The gap is waited for behind the reply instead of before the next request.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::time::Duration;

use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Request, Response};

use super::{LinkError, ModbusLink, PROBES, RegisterTable, now};
use crate::drive::guard::LineCounts;
use crate::drive::link::{DriveLink, LinkName, LinkStatistics};
use crate::drive::raw::registers;
use crate::drive::register_bus::{Carried, RegisterBus, RegistersRead};
use crate::drive::register_map::{PollRate, ReadBlock, RegisterMap, Resync, plan_reads};
use crate::drive::reply::FrameKind;
use crate::drive::tally::RoundTrips;
use crate::drive::timing::wait_until;

/// Times that a question without effect is asked before it counts as failed.
const READ_ATTEMPTS: usize = 3;
/// Round trips that tell how long replies usually take, and how many of them a busy host may have made too long.
const REMEMBERED: usize = 32;
const OUTLIERS: usize = 2;

/// A Modbus link that proves itself fresh in the way that the far end knows.
pub struct ModbusBus {
    link: ModbusLink,
    resync: Resync,
    emulated: bool,
    /// Registers that can be read in any number up to the whole, for the length code.
    probe: Option<ReadBlock>,
    /// Lengths of reads that were never answered.
    unanswered: Vec<u16>,
    /// Of the latest reads.
    round_trips: VecDeque<Duration>,
}

impl ModbusBus {
    pub fn new(link: ModbusLink, map: &RegisterMap) -> Self {
        let exact = |block: &ReadBlock| {
            map.exact_reads
                .iter()
                .any(|(first, count)| (*first, *count) == (block.address, block.count))
        };
        let blocks = plan_reads(map, PollRate::Fast);
        let probe = blocks
            .into_iter()
            .filter(|block| !exact(block))
            .max_by_key(|block| block.count);
        Self {
            link,
            resync: map.resync,
            emulated: false,
            probe,
            unanswered: Vec::new(),
            round_trips: VecDeque::with_capacity(REMEMBERED),
        }
    }

    /// Whether the far end is the software drive of this process.
    #[must_use]
    pub const fn emulated(mut self, emulated: bool) -> Self {
        self.emulated = emulated;
        self
    }

    fn fresh(&mut self) -> Result<(), LinkError> {
        if self.link.kind == FrameKind::Tcp || self.resync == Resync::Fc08 {
            return self.link.prove_fresh();
        }
        self.link.listen()?;
        for _ in 0..PROBES {
            if !self.link.suspect {
                return Ok(());
            }
            self.link.silence()?;
            if self.resync == Resync::Length {
                self.probe_by_length()?;
            }
            self.link.suspect = false;
            self.unanswered.clear();
            // What came during the probe, or comes in the gap behind it, was not asked for either.
            self.link.listen()?;
        }
        Err(LinkError::Corrupt {
            link: self.link.name.clone(),
            reason: format!("something nobody asked for came behind each of {PROBES} probes"),
        })
    }

    /// The reply to a read of another length than all that are unanswered can be no old one.
    fn probe_by_length(&mut self) -> Result<(), LinkError> {
        let Some(block) = self.probe.clone() else {
            return Ok(());
        };
        let mut last = None;
        for count in (1..=block.count).rev() {
            if self.unanswered.contains(&count) {
                continue;
            }
            self.link.listen()?;
            match self.ask(block.table, block.address, count) {
                Ok(_) => return Ok(()),
                Err(error) if error.is_transient() => {
                    self.unanswered.push(count);
                    last = Some(error);
                }
                Err(error) => return Err(error),
            }
        }
        // Silence was all that could be had; the lengths are used up.
        last.map_or(Ok(()), Err)
    }

    /// A line that has once brought an old reply may do so again: from then on reads that look alike are kept apart, as
    /// they are while nothing is known of the line. On all others that would only cost their rate.
    fn keep_apart(&mut self, count: u16) -> Result<(), LinkError> {
        let known = self.round_trips.len() == REMEMBERED;
        if known && self.link.guard.line().stale_frames == 0 {
            self.link.recent.clear();
            return Ok(());
        }
        self.link.keep_apart(reply_bytes(count))
    }

    /// A read whose reply is taken only where no other came within the time that one usually takes.
    fn ask_alone(
        &mut self,
        table: RegisterTable,
        address: u16,
        count: u16,
    ) -> Result<RegistersRead, LinkError> {
        self.alone(count, address, |bus| bus.ask(table, address, count))
    }

    fn alone(
        &mut self,
        count: u16,
        address: u16,
        ask: impl FnOnce(&mut Self) -> Result<RegistersRead, LinkError>,
    ) -> Result<RegistersRead, LinkError> {
        let sent = now();
        let read = ask(self)?;
        if self.link.kind == FrameKind::Tcp {
            return Ok(read);
        }
        let took = now().saturating_duration_since(sent);
        let usual = self.usual();
        if self.round_trips.len() == REMEMBERED {
            self.round_trips.pop_front();
        }
        self.round_trips.push_back(took);
        if took < usual {
            wait_until(sent + usual);
        }
        if !self.link.suspect {
            self.link.listen()?;
        }
        if self.link.suspect {
            return Err(LinkError::Stale {
                link: self.link.name.clone(),
                reason: format!(
                    "something else came with the reply to {count} registers at {address}"
                ),
            });
        }
        Ok(read)
    }

    /// How long a reply takes at the most, a busy host left out.
    fn usual(&self) -> Duration {
        let mut longest: Vec<Duration> = self.round_trips.iter().copied().collect();
        longest.sort_unstable_by(|a, b| b.cmp(a));
        longest.get(OUTLIERS).copied().unwrap_or_default()
    }

    fn ask(
        &mut self,
        table: RegisterTable,
        address: u16,
        count: u16,
    ) -> Result<RegistersRead, LinkError> {
        let allowed = self.link.timing.allowed(8, reply_bytes(count));
        let what = format!("read {} at {address}", registers(count.into()));
        let request = match table {
            RegisterTable::Holding => Request::ReadHoldingRegisters(address, count),
            RegisterTable::Input => Request::ReadInputRegisters(address, count),
        };
        let answer = self
            .link
            .call(request, &what, allowed, |response| match response {
                Response::ReadHoldingRegisters(values) | Response::ReadInputRegisters(values)
                    if values.len() == usize::from(count) =>
                {
                    Ok(values)
                }
                other => Err(format!("{other:?}")),
            });
        answer.map(|answer| RegistersRead {
            words: answer.value,
            asked_s: answer.sent_s,
            answered_s: answer.received_s,
        })
    }

    fn put(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
        allowed: Duration,
    ) -> Result<Carried, LinkError> {
        let what = format!("write {values:04x?} at {address}");
        let request = match (function, values) {
            (6, [value]) => Request::WriteSingleRegister(address, *value),
            _ => Request::WriteMultipleRegisters(address, Cow::Borrowed(values)),
        };
        let answer = self
            .link
            .call(request, &what, allowed, |response| match response {
                Response::WriteSingleRegister(..) | Response::WriteMultipleRegisters(..) => Ok(()),
                other => Err(format!("{other:?}")),
            });
        answer.map(|answer| Carried {
            asked_s: answer.sent_s,
            answered_s: answer.received_s,
        })
    }

    /// As `put`, on a line in doubt too; the doubt stays.
    fn put_in_doubt(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
        allowed: Duration,
    ) -> Result<Carried, LinkError> {
        self.link.listen()?;
        let was_suspect = self.link.suspect;
        let result = self.put(function, address, values, allowed);
        self.link.suspect |= was_suspect;
        result
    }

    /// One transaction of function code 23: the drive writes first, then reads.
    fn put_and_ask(
        &mut self,
        (to, values): (u16, &[u16]),
        (from, count): (u16, u16),
    ) -> Result<RegistersRead, LinkError> {
        let request_bytes = READ_WRITE_BYTES + 2 * values.len();
        let allowed = self.link.timing.allowed(request_bytes, reply_bytes(count));
        let what = format!(
            "write {values:04x?} at {to} and read {} at {from}",
            registers(count.into())
        );
        let request = Request::ReadWriteMultipleRegisters(from, count, to, Cow::Borrowed(values));
        let answer = self
            .link
            .call(request, &what, allowed, |response| match response {
                Response::ReadWriteMultipleRegisters(values)
                    if values.len() == usize::from(count) =>
                {
                    Ok(values)
                }
                other => Err(format!("{other:?}")),
            });
        answer.map(|answer| RegistersRead {
            words: answer.value,
            asked_s: answer.sent_s,
            answered_s: answer.received_s,
        })
    }
}

/// RTU frame of a write of several registers beside these.
const WRITE_BYTES: usize = 9;
/// RTU frame of a request of function code 23 beside the registers that it writes.
const READ_WRITE_BYTES: usize = 13;
/// RTU frame of the acknowledgement of a write.
const WRITTEN_BYTES: usize = 8;

/// RTU frame of the reply to a read.
fn reply_bytes(count: u16) -> usize {
    5 + 2 * usize::from(count)
}

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
        let mut attempt = 1;
        loop {
            let result = self
                .fresh()
                .and_then(|()| self.keep_apart(count))
                .and_then(|()| self.ask_alone(table, address, count));
            self.link.recent.push((reply_bytes(count), now()));
            match result {
                Err(error) if error.is_transient() => {
                    self.unanswered.push(count);
                    if attempt == READ_ATTEMPTS {
                        return Err(error);
                    }
                    attempt += 1;
                }
                result => return result,
            }
        }
    }

    fn write(&mut self, function: u8, address: u16, values: &[u16]) -> Result<Carried, LinkError> {
        self.fresh()?;
        let bytes = WRITE_BYTES + 2 * values.len();
        let allowed = self.link.timing.allowed(bytes, WRITTEN_BYTES);
        self.put(function, address, values, allowed)
    }

    fn write_at_once(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
    ) -> Result<Carried, LinkError> {
        let bytes = WRITE_BYTES + 2 * values.len();
        let allowed = self.link.timing.allowed(bytes, WRITTEN_BYTES);
        self.put_in_doubt(function, address, values, allowed)
    }

    fn write_briefly(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
    ) -> Result<Carried, LinkError> {
        let bytes = WRITE_BYTES + 2 * values.len();
        let allowed = self.link.timing.brief(bytes, WRITTEN_BYTES);
        self.put_in_doubt(function, address, values, allowed)
    }

    fn read_write(
        &mut self,
        write: (u16, &[u16]),
        read: (u16, u16),
    ) -> Result<RegistersRead, LinkError> {
        let (from, count) = read;
        self.fresh()?;
        self.keep_apart(count)?;
        let result = self.alone(count, from, |bus| bus.put_and_ask(write, read));
        self.link.recent.push((reply_bytes(count), now()));
        if result.as_ref().is_err_and(LinkError::is_transient) {
            self.unanswered.push(count);
        }
        result
    }

    fn object(&mut self, object: u8) -> Result<Option<String>, LinkError> {
        let allowed = self.link.timing.allowed(7, 256);
        self.fresh()?;
        let request = Request::ReadDeviceIdentification(ReadCode::Specific, object);
        let answer =
            self.link.call(
                request,
                "the device identification",
                allowed,
                |response| match response {
                    Response::ReadDeviceIdentification(names) => Ok(names.device_id_objects),
                    other => Err(format!("{other:?}")),
                },
            );
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
        Some(self.link.guard.line())
    }

    fn wire_s(&self, request_bytes: usize, reply_bytes: usize) -> Option<f64> {
        self.link
            .timing
            .shortest_cycle_s(request_bytes, reply_bytes)
    }
}

//! One request, one reply, one absolute deadline: which bytes answer is decided by the exact match of `reply`.

use std::collections::VecDeque;
use std::io;
use std::time::{Duration, Instant};

use firmware_protocol::modbus::{rtu, tcp};

use super::super::guard::now;
use super::super::link::LinkError;
use super::super::reply::{Expected, FrameKind, search};
use super::super::tap::Tap;
use super::counters::{Class, RawCounters};
use super::proof::Method;
use super::request::{ReadRequest, WriteFunction, exception_name, registers, values, write_pdu};
use super::wire::Wire;

/// Bytes kept while a reply is awaited; a line that babbles beyond loses its oldest.
const LONGEST_WAIT_BYTES: usize = 1024;
/// Requests remembered since the last proof, to tell their late replies from strangers'.
const REMEMBERED: usize = 32;

/// A thread that sleeps may wake up this much late without anyone to blame; the rest of a gap is watched on the clock,
/// because a gap that is 0.1 ms too long already costs one request in twenty.
const WATCHED: Duration = Duration::from_micros(300);

/// A request that went out since the line was last proven to be in step.
pub(super) struct Sent {
    pub(super) function: u8,
    /// Registers that a read asked for.
    pub(super) count: u16,
    /// It got data in reply; else a refusal may still come late.
    pub(super) is_answered: bool,
}

/// A blocking Modbus client for raw registers.
pub struct RawClient {
    pub(super) name: String,
    /// Settings of a serial line, for messages; empty over a network.
    pub(super) line: String,
    wire: Wire,
    pub(super) kind: FrameKind,
    unit: u8,
    pub(super) timeout: Duration,
    pub(super) gap: Duration,
    pub(super) counters: RawCounters,
    tap: Option<Tap>,
    expected: Expected,
    received: Vec<u8>,
    reply: Vec<u8>,
    transaction: u16,
    last_activity: Instant,
    /// Duration of the last exchange that got a reply.
    last_round_trip: Duration,
    /// Times that something was wrong on the line.
    pub(super) anomalies: u64,
    /// What comes next may be old.
    pub(super) suspect: bool,
    /// The unit has ever answered.
    pub(super) heard: bool,
    gone: bool,
    pub(super) since_proof: VecDeque<Sent>,
    /// A read that was answered: a probe may ask for the same place.
    pub(super) known: Option<ReadRequest>,
    /// The way of proving that has worked.
    pub(super) method: Option<Method>,
    pub(super) nonce: u16,
}

impl RawClient {
    pub(super) fn new(
        name: String,
        wire: Wire,
        kind: FrameKind,
        unit: u8,
        timeout: Duration,
        gap: Duration,
        tap: Option<Tap>,
    ) -> Self {
        let [.., high, low] = std::process::id().to_be_bytes();
        Self {
            name,
            line: String::new(),
            wire,
            kind,
            unit,
            timeout,
            gap,
            counters: RawCounters::default(),
            tap,
            expected: Expected::default(),
            received: Vec::with_capacity(2 * LONGEST_WAIT_BYTES),
            reply: Vec::with_capacity(rtu::MAX_FRAME),
            transaction: u16::from_be_bytes([low, high]),
            last_activity: now(),
            last_round_trip: Duration::ZERO,
            anomalies: 0,
            suspect: false,
            heard: false,
            gone: false,
            since_proof: VecDeque::with_capacity(REMEMBERED),
            known: None,
            method: None,
            nonce: u16::from_be_bytes([high, low]),
        }
    }

    /// From here on another unit of the line is asked.
    pub fn set_unit(&mut self, unit: u8) {
        self.unit = unit;
        self.heard = false;
        self.known = None;
        self.method = None;
    }

    pub const fn counters(&self) -> RawCounters {
        self.counters
    }

    /// Time from the request to the whole reply, of the last exchange that got one.
    pub const fn last_round_trip(&self) -> Duration {
        self.last_round_trip
    }

    /// Times that something was wrong on the line; as long as it stays the same nothing was.
    pub const fn anomalies(&self) -> u64 {
        self.anomalies
    }

    /// The unit has ever answered.
    pub const fn is_heard(&self) -> bool {
        self.heard
    }

    /// Host time, for durations between exchanges.
    pub fn clock(&self) -> Instant {
        now()
    }

    /// Reads registers, once. Whether the reply is that to this very request and not to an equal one before it, only
    /// [`RawClient::vouch`] can say.
    pub fn read(&mut self, request: ReadRequest) -> Result<Vec<u16>, LinkError> {
        self.in_step()?;
        let what = || {
            format!(
                "read {} at {}",
                registers(request.count.into()),
                request.address
            )
        };
        let pdu = request.pdu();
        self.transact(&pdu, request.count, self.timeout, what)?;
        self.known = Some(request);
        Ok(values(self.response()))
    }

    /// Writes registers, once and never again by itself: after an error nobody knows whether it was applied.
    pub fn write(
        &mut self,
        function: WriteFunction,
        address: u16,
        values: &[u16],
    ) -> Result<(), LinkError> {
        self.in_step()?;
        let what = || format!("write {} at {address}", registers(values.len()));
        let pdu = write_pdu(function, address, values);
        self.transact(&pdu, 0, self.timeout, what)
    }

    /// Any request; returns the PDU of the reply.
    pub fn ask(&mut self, pdu: &[u8], what: &str) -> Result<&[u8], LinkError> {
        self.in_step()?;
        self.transact(pdu, 0, self.timeout, || what.to_owned())?;
        Ok(self.response())
    }

    /// Nothing lies on the line, and what comes next answers what is asked next.
    fn in_step(&mut self) -> Result<(), LinkError> {
        if self.gone {
            return Err(self.broken("it broke before"));
        }
        self.drain()?;
        if self.suspect {
            self.resynchronise()?;
        }
        Ok(())
    }

    /// PDU of the reply.
    pub(super) fn response(&self) -> &[u8] {
        let end = self.reply.len();
        match self.kind {
            FrameKind::Rtu => self.reply.get(1..end.saturating_sub(2)),
            FrameKind::Tcp => self.reply.get(tcp::HEADER..),
        }
        .unwrap_or_default()
    }

    /// Reads away whatever lies on the line; bytes that nobody asked for make the line suspect.
    pub(super) fn drain(&mut self) -> Result<usize, LinkError> {
        let mut dropped = 0;
        // A line that babbles faster than it is read must not hold us here.
        while dropped < 1 << 16 {
            self.received.clear();
            match self.receive()? {
                0 => break,
                count => dropped += count,
            }
        }
        self.received.clear();
        if dropped > 0 {
            self.counters.bytes_dropped += dropped as u64;
            self.anomaly();
        }
        Ok(dropped)
    }

    pub(super) fn anomaly(&mut self) {
        self.anomalies += 1;
        // Over TCP every reply carries the number of its request.
        self.suspect |= self.kind == FrameKind::Rtu;
    }

    /// Waits until the line was silent for `quiet`; false when it never was within the timeout.
    pub(super) fn silence(&mut self, quiet: Duration) -> Result<bool, LinkError> {
        let deadline = now() + self.timeout.max(quiet) + quiet;
        loop {
            let until = now() + quiet;
            let mut left = quiet;
            while !left.is_zero() {
                let waited = self.wire.wait_readable(left);
                waited.map_err(|error| self.lost(&error))?;
                if self.drain()? > 0 {
                    break;
                }
                left = until.saturating_duration_since(now());
            }
            if left.is_zero() {
                return Ok(true);
            }
            if now() >= deadline {
                return Ok(false);
            }
        }
    }

    /// One exchange, booked in its class. Data in reply are `Ok`; they are in [`RawClient::response`].
    pub(super) fn transact(
        &mut self,
        pdu: &[u8],
        count: u16,
        timeout: Duration,
        what: impl Fn() -> String,
    ) -> Result<(), LinkError> {
        self.frame(pdu);
        pause_until(self.last_activity + self.gap);
        let begun = now();
        let deadline = begun + timeout;
        let result = self
            .send(deadline)
            .and_then(|()| self.await_reply(deadline))
            .map_err(|error| self.lost(&error));
        let ended = now();
        let (class, result) = match result {
            Err(gone) => (Class::Aborted, Err(gone)),
            Ok(false) => {
                let (class, error) = self.missing(timeout, &what());
                self.anomaly();
                (class, Err(error))
            }
            Ok(true) => {
                self.heard = true;
                self.last_round_trip = ended.saturating_duration_since(begun);
                match *self.response() {
                    [function, code] if function & 0x80 != 0 => {
                        (Class::Exception, Err(self.refusal(code, &what())))
                    }
                    _ => (Class::Ok, Ok(())),
                }
            }
        };
        self.counters.book(class);
        self.expected.retire();
        if self.kind == FrameKind::Rtu {
            if self.since_proof.len() >= REMEMBERED {
                self.since_proof.pop_front();
            }
            self.since_proof.push_back(Sent {
                function: pdu.first().copied().unwrap_or_default(),
                count,
                is_answered: class == Class::Ok,
            });
        }
        result
    }

    fn frame(&mut self, pdu: &[u8]) {
        self.expected.request.clear();
        match self.kind {
            FrameKind::Rtu => {
                let mut frame = [0; rtu::MAX_FRAME];
                let length = rtu::encode_frame(self.unit, pdu, &mut frame);
                self.expected.request.extend_from_slice(&frame[..length]);
            }
            FrameKind::Tcp => {
                self.transaction = self.transaction.wrapping_add(1);
                let mut frame = [0; tcp::MAX_FRAME];
                let length = tcp::encode_frame(self.transaction, self.unit, pdu, &mut frame);
                self.expected.request.extend_from_slice(&frame[..length]);
            }
        }
    }

    /// What does not get out in time ends as a timeout of the reply.
    fn send(&mut self, deadline: Instant) -> io::Result<()> {
        let mut at = 0;
        loop {
            at += self.wire.write(&self.expected.request[at..])?;
            if at == self.expected.request.len() {
                break;
            }
            let left = deadline.saturating_duration_since(now());
            if left.is_zero() {
                break;
            }
            self.wire.wait_writable(left)?;
        }
        self.last_activity = now();
        self.counters.bytes_sent += at as u64;
        if let Some(tap) = &mut self.tap {
            tap.sent(&self.expected.request[..at]);
        }
        Ok(())
    }

    /// True when the reply is there.
    fn await_reply(&mut self, deadline: Instant) -> io::Result<bool> {
        loop {
            let left = deadline.saturating_duration_since(now());
            if left.is_zero() {
                return Ok(false);
            }
            self.wire.wait_readable(left)?;
            if self.receive_raw()? > 0 && self.accept()? {
                return Ok(true);
            }
        }
    }

    fn receive(&mut self) -> Result<usize, LinkError> {
        self.receive_raw().map_err(|error| self.lost(&error))
    }

    /// Appends what is there to what was received.
    fn receive_raw(&mut self) -> io::Result<usize> {
        let mut bytes = [0; 512];
        let Some(count) = self.wire.read(&mut bytes)? else {
            return Ok(0);
        };
        self.received.extend_from_slice(&bytes[..count]);
        self.counters.bytes_received += count as u64;
        self.last_activity = now();
        if let Some(tap) = &mut self.tap {
            tap.received(&bytes[..count]);
        }
        Ok(count)
    }

    /// Takes the reply out of what was received, if it is there; anything beside it is an anomaly.
    fn accept(&mut self) -> io::Result<bool> {
        let found = search(self.kind, &self.expected, &self.received).map_err(|_| {
            io::Error::new(
                io::ErrorKind::ConnectionAborted,
                "the peer speaks no Modbus TCP",
            )
        })?;
        if let Some((begin, end)) = found.reply {
            let echo = if found.echo {
                self.expected.request.len()
            } else {
                0
            };
            self.counters.echoes |= found.echo;
            self.expected.echoes |= found.echo;
            let dropped = self.received.len() - (end - begin);
            self.counters.bytes_dropped += dropped as u64;
            self.reply.clear();
            self.reply.extend_from_slice(&self.received[begin..end]);
            self.received.clear();
            if dropped > echo {
                self.anomaly();
            }
            return Ok(true);
        }
        if self.received.len() > LONGEST_WAIT_BYTES && self.kind == FrameKind::Rtu {
            let excess = self.received.len() - LONGEST_WAIT_BYTES;
            self.received.drain(..excess);
            self.counters.bytes_dropped += excess as u64;
        }
        Ok(false)
    }

    /// No reply in time: what came instead tells the class.
    fn missing(&mut self, timeout: Duration, what: &str) -> (Class, LinkError) {
        let link = self.name.clone();
        let bytes = self.received.len();
        let found = search(self.kind, &self.expected, &self.received).unwrap_or_default();
        let only_echo = self.received == self.expected.request;
        let answer = if bytes == 0 || only_echo {
            let deadline_ms = u64::try_from(timeout.as_millis()).unwrap_or(u64::MAX);
            let request = format!("{what} of unit {}{}", self.unit, self.line);
            (
                Class::Timeout,
                LinkError::Timeout {
                    link,
                    deadline_ms,
                    request,
                },
            )
        } else if found.stale > 0 {
            let reason = format!("only the reply to an earlier request came after {what}");
            (Class::Stale, LinkError::Mismatch { link, reason })
        } else if found.foreign > 0 {
            let reason = format!("only frames that do not answer {what} came");
            (Class::Mismatch, LinkError::Mismatch { link, reason })
        } else {
            let reason = format!("{bytes} bytes without a valid frame came in reply to {what}");
            (Class::Crc, LinkError::Corrupt { link, reason })
        };
        self.counters.bytes_dropped += bytes as u64;
        self.received.clear();
        answer
    }

    fn refusal(&self, code: u8, what: &str) -> LinkError {
        LinkError::Exception {
            link: self.name.clone(),
            request: what.to_owned(),
            code,
            name: exception_name(code),
        }
    }

    fn lost(&mut self, error: &io::Error) -> LinkError {
        self.gone = true;
        self.broken(&error.to_string())
    }

    fn broken(&self, reason: &str) -> LinkError {
        LinkError::Gone {
            link: self.name.clone(),
            reason: reason.to_owned(),
        }
    }
}

fn pause_until(at: Instant) {
    let left = at.saturating_duration_since(now());
    std::thread::sleep(left.saturating_sub(WATCHED));
    while now() < at {
        std::hint::spin_loop();
    }
}

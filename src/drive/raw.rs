//! Raw registers of any Modbus unit: the everyday tool beside the drive links, in as few system calls as can be.
//!
//! ```text
//! batch.rs  reads, again and again -> values that are vouched for
//!    |
//! RawClient drain -> steps of proof.rs -> gap -> write -> ppoll, read until the one reply is there
//!    |
//! wire.rs   serial port or TCP, non-blocking
//! ```

mod batch;
#[cfg(test)]
mod tests;
mod wire;

use std::io;
use std::time::{Duration, Instant};

use firmware_protocol::modbus::{rtu, tcp};
use firmware_protocol::registers::{IDENTITY_ADDRESS, IDENTITY_WORDS};
use serde::Serialize;

use super::guard::now;
use super::link::{Identity, LinkError, LinkStatistics};
use super::open::Target;
use super::proof::{End, Policy, Proof, Step};
use super::register_bus::{MOST_READ, ReadRequest, exception_name, registers};
use super::reply::FrameKind;
use super::settings::Framing;
use super::tap::{Tap, TapFile};
use super::timeline::identity;
use super::timing::{standard_gap_s, wait_until};
use super::transaction::{LineCounts, Reception, out_of_step, restless};
use wire::Wire;

pub use batch::{Batch, Read, read_batch};

/// Silence after which an adapter has handed over all it had (the latency timer of FTDI is 16 ms).
const QUIET: Duration = Duration::from_millis(20);

/// Every request ends in exactly one class of the statistics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RawCounters {
    #[serde(flatten)]
    pub requests: LinkStatistics,
    /// Requests among `sent` that only proved that the line is in step.
    pub probes: u64,
    pub resynchronisations: u64,
    #[serde(flatten)]
    pub line: LineCounts,
}

/// How a write is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriteFunction {
    /// Function code 6: one register.
    Single,
    /// Function code 16: any number.
    Multiple,
}

/// A blocking Modbus client for raw registers.
pub struct RawClient {
    name: String,
    /// Settings of a serial line, for messages; empty over a network.
    line: String,
    wire: Wire,
    unit: u8,
    timeout: Duration,
    gap: Duration,
    counters: RawCounters,
    tap: Option<Tap>,
    reception: Reception,
    proof: Proof,
    transaction: u16,
    /// Duration of the last exchange that got a reply.
    last_round_trip: Duration,
    gone: bool,
}

impl RawClient {
    fn new(
        name: String,
        wire: Wire,
        kind: FrameKind,
        unit: u8,
        timeout: Duration,
        gap: Duration,
        tap: Option<Tap>,
    ) -> Self {
        let [.., high, low] = std::process::id().to_be_bytes();
        let policy = match kind {
            FrameKind::Rtu => Policy::Trial(timeout),
            FrameKind::Tcp => Policy::Numbered,
        };
        Self {
            name,
            line: String::new(),
            wire,
            unit,
            timeout,
            gap,
            counters: RawCounters::default(),
            tap,
            reception: Reception::new(kind, now()),
            proof: Proof::new(policy, QUIET.max(gap), now()),
            transaction: u16::from_be_bytes([low, high]),
            last_round_trip: Duration::ZERO,
            gone: false,
        }
    }

    /// From here on another unit of the line is asked.
    pub fn set_unit(&mut self, unit: u8) {
        self.unit = unit;
        self.proof.forget_unit();
    }

    pub const fn counters(&self) -> RawCounters {
        let mut counters = self.counters;
        counters.line = self.reception.line;
        counters
    }

    /// Time from the request to the whole reply, of the last exchange that got one.
    pub const fn last_round_trip(&self) -> Duration {
        self.last_round_trip
    }

    /// The unit has ever answered.
    pub const fn is_heard(&self) -> bool {
        self.proof.heard
    }

    /// Reads registers, once. Whether the reply is that to this very request and not to an equal one before it, only
    /// [`RawClient::vouch`] can say.
    pub fn read(&mut self, request: ReadRequest) -> Result<Vec<u16>, LinkError> {
        let pdu = request.pdu();
        self.in_step(&pdu)?;
        self.transact(&pdu, false, || request.text())?;
        self.proof.known(request);
        Ok(values(self.response()))
    }

    /// Writes registers, once and never again by itself: after an error nobody knows whether it was applied.
    pub fn write(
        &mut self,
        function: WriteFunction,
        address: u16,
        values: &[u16],
    ) -> Result<(), LinkError> {
        let what = || format!("write {} at {address}", registers(values.len()));
        let pdu = write_pdu(function, address, values);
        self.in_step(&pdu)?;
        self.transact(&pdu, false, what)
    }

    /// Any request; returns the PDU of the reply.
    pub fn ask(&mut self, pdu: &[u8], what: &str) -> Result<&[u8], LinkError> {
        self.in_step(pdu)?;
        self.transact(pdu, false, || what.to_owned())?;
        Ok(self.response())
    }

    /// Whether everything since the last proof was answered in step: true when a probe came back and nothing beside it.
    /// After false the line is in step again.
    pub fn vouch(&mut self) -> Result<bool, LinkError> {
        if !self.proof.heard {
            return Ok(true);
        }
        let before = self.proof.anomalies;
        self.proof.doubt();
        self.in_step(&[])?;
        Ok(self.proof.anomalies == before)
    }

    /// Proves the line so far that the reply to this request is unmistakable.
    pub fn prove_for(&mut self, request: ReadRequest) -> Result<(), LinkError> {
        if self.proof.could_confuse(&request.pdu()) || !self.proof.proven {
            self.proof.doubt();
        }
        self.in_step(&request.pdu())
    }

    /// Whether a late or second reply to a request since the last proof could be taken for the reply to this one.
    pub fn could_confuse(&self, request: ReadRequest) -> bool {
        self.proof.could_confuse(&request.pdu())
    }

    /// An answer that was taken turns out to be doubtful: it is counted as stale.
    pub const fn withdraw(&mut self) {
        self.counters.requests.withdraw();
    }

    /// Nothing lies on the line, and what comes next answers this request.
    fn in_step(&mut self, pdu: &[u8]) -> Result<(), LinkError> {
        if self.gone {
            return Err(self.broken("it broke before"));
        }
        self.drain()?;
        let mut begun = false;
        loop {
            match self.proof.next(pdu, now()) {
                Step::Go => return Ok(()),
                Step::Silence(until) => self.keep_silent(until)?,
                Step::Probe(probe) => {
                    let is_new = self.proof.dirty && !std::mem::replace(&mut begun, true);
                    self.counters.resynchronisations += u64::from(is_new);
                    self.counters.probes += 1;
                    let ended = self.transact(&probe, true, || "the probe".to_owned());
                    // How else it ended is known to the proof.
                    if let Err(error @ LinkError::Gone { .. }) = ended {
                        return Err(error);
                    }
                }
                Step::Restless => return Err(restless(&self.name)),
                Step::GiveUp => return Err(out_of_step(&self.name)),
            }
        }
    }

    /// PDU of the reply.
    fn response(&self) -> &[u8] {
        let reply = &self.reception.reply;
        match self.reception.kind {
            FrameKind::Rtu => reply.get(1..reply.len().saturating_sub(2)),
            FrameKind::Tcp => reply.get(tcp::HEADER..),
        }
        .unwrap_or_default()
    }

    /// Reads away whatever lies on the line; bytes that nobody asked for are a doubt.
    fn drain(&mut self) -> Result<usize, LinkError> {
        let mut dropped = 0;
        // A line that babbles faster than it is read must not hold us here.
        while dropped < 1 << 16 {
            match self.receive().map_err(|error| self.lost(&error))? {
                0 => break,
                count => dropped += count,
            }
        }
        if self.reception.drop_strays() > 0 {
            self.reception.take_anomaly();
            let heard = self.reception.take_heard();
            self.proof.disturbed(&heard, now());
        }
        Ok(dropped)
    }

    /// Silence up to this instant, or until something comes.
    fn keep_silent(&mut self, until: Instant) -> Result<(), LinkError> {
        loop {
            let left = until.saturating_duration_since(now());
            if left.is_zero() {
                return Ok(());
            }
            let waited = self.wire.wait_readable(left);
            waited.map_err(|error| self.lost(&error))?;
            if self.drain()? > 0 {
                return Ok(());
            }
        }
    }

    /// One exchange, booked in its class. Data in reply are `Ok`; they are in [`RawClient::response`].
    fn transact(
        &mut self,
        pdu: &[u8],
        is_probe: bool,
        what: impl Fn() -> String,
    ) -> Result<(), LinkError> {
        self.frame(pdu);
        wait_until(self.reception.last_activity + self.gap);
        let begun = now();
        let deadline = begun + self.timeout;
        self.proof.asked(pdu, is_probe, begun);
        let result = self
            .send(deadline)
            .and_then(|()| self.await_reply(deadline))
            .map_err(|error| self.lost(&error));
        let ended = now();
        let result = result.and_then(|is_there| {
            if !is_there {
                let request = format!("{} of unit {}{}", what(), self.unit, self.line);
                let left = self.reception.leftover();
                return Err(left.error(&self.name, request, self.timeout));
            }
            self.last_round_trip = ended.saturating_duration_since(begun);
            match *self.response() {
                [function, code] if function & 0x80 != 0 => Err(LinkError::Exception {
                    link: self.name.clone(),
                    request: what(),
                    code,
                    name: exception_name(code),
                }),
                _ => Ok(()),
            }
        });
        self.counters.requests.settle(&result);
        let end = End::of(&result);
        if end == End::Missing {
            self.reception.retire();
        } else {
            self.reception.expected.retire();
        }
        self.proof.settle(end, &mut self.reception, false, ended);
        result
    }

    fn frame(&mut self, pdu: &[u8]) {
        let (mut short, mut long) = ([0; rtu::MAX_FRAME], [0; tcp::MAX_FRAME]);
        let frame = match self.reception.kind {
            FrameKind::Rtu => {
                let length = rtu::encode_frame(self.unit, pdu, &mut short);
                &short[..length]
            }
            FrameKind::Tcp => {
                self.transaction = self.transaction.wrapping_add(1);
                let length = tcp::encode_frame(self.transaction, self.unit, pdu, &mut long);
                &long[..length]
            }
        };
        frame.clone_into(&mut self.reception.expected.request);
    }

    /// What does not get out in time ends as a timeout of the reply.
    fn send(&mut self, deadline: Instant) -> io::Result<()> {
        let mut at = 0;
        let request = &self.reception.expected.request;
        loop {
            at += self.wire.write(&request[at..])?;
            if at == request.len() {
                break;
            }
            let left = deadline.saturating_duration_since(now());
            if left.is_zero() {
                break;
            }
            self.wire.wait_writable(left)?;
        }
        if let Some(tap) = &mut self.tap {
            tap.sent(&request[..at]);
        }
        self.reception.sent(at, now());
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
            if self.receive()? > 0 && self.reception.accept()? {
                return Ok(true);
            }
        }
    }

    /// Takes what is there.
    fn receive(&mut self) -> io::Result<usize> {
        let mut bytes = [0; 512];
        let Some(count) = self.wire.read(&mut bytes)? else {
            return Ok(0);
        };
        self.reception.push(&bytes[..count], now());
        if let Some(tap) = &mut self.tap {
            tap.received(&bytes[..count]);
        }
        Ok(count)
    }

    fn lost(&mut self, error: &io::Error) -> LinkError {
        self.gone = true;
        self.broken(&error.to_string())
    }

    fn broken(&self, reason: &str) -> LinkError {
        LinkError::Gone(self.name.clone(), reason.to_owned())
    }
}

/// Values of a reply to a read whose length was checked.
fn values(response: &[u8]) -> Vec<u16> {
    let words = response.get(2..).unwrap_or_default().as_chunks().0;
    words.iter().map(|word| u16::from_be_bytes(*word)).collect()
}

fn write_pdu(function: WriteFunction, address: u16, values: &[u16]) -> Vec<u8> {
    let [a, b] = address.to_be_bytes();
    let mut pdu = match function {
        WriteFunction::Single => vec![6, a, b],
        WriteFunction::Multiple => {
            // At most MOST_WRITTEN, which the caller has checked.
            let count = u8::try_from(values.len()).unwrap_or(u8::MAX);
            vec![16, a, b, 0, count, count.saturating_mul(2)]
        }
    };
    pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
    pdu
}

/// How a unit is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawSettings {
    /// Baud rate of a serial port for which the target names none.
    pub baud: u32,
    pub framing: Framing,
    /// Unit for which the target names none.
    pub unit: u8,
    /// Time for one exchange, from the request to the whole reply.
    pub timeout: Duration,
    /// Silence before a request; `None`: as the standard says for the baud rate.
    pub gap: Option<Duration>,
}

impl RawClient {
    /// Opens the port or connects; nothing is sent yet.
    ///
    /// # Errors
    /// [`LinkError::Open`], with what to do about it.
    pub fn open(
        target: &Target,
        settings: &RawSettings,
        tap: Option<&TapFile>,
    ) -> Result<Self, LinkError> {
        let name = target.to_string();
        // The kernel may put off the end of a sleep by 50 us to save wake-ups; where it refuses, gaps are a little longer.
        #[cfg(target_os = "linux")]
        let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
        let mut line = String::new();
        let (wire, kind, unit, gap) = match target {
            Target::Serial { path, baud, unit } => {
                let baud = baud.unwrap_or(settings.baud);
                let wire = Wire::serial(path, baud, settings.framing)?;
                line = format!(" at {baud} {}", settings.framing.name());
                let standard = standard_gap_s(baud, settings.framing);
                let gap = settings
                    .gap
                    .unwrap_or_else(|| Duration::try_from_secs_f64(standard).unwrap_or_default());
                (wire, FrameKind::Rtu, unit, gap)
            }
            Target::Tcp { host, port, unit } => {
                let wire = Wire::tcp(&name, host, *port)?;
                // A network has no silences; one that is asked for is kept.
                (wire, FrameKind::Tcp, unit, settings.gap.unwrap_or_default())
            }
        };
        let tap = tap.map(|file| match wire.ends {
            Some((ours, peer)) => file.tcp(ours, peer),
            None => file.rtu(),
        });
        let unit = unit.unwrap_or(settings.unit);
        let mut client = Self::new(name, wire, kind, unit, settings.timeout, gap, tap);
        client.line = line;
        Ok(client)
    }

    /// Who the unit is, where it has our register map; `None`: it is something else, which must count as hardware.
    pub fn identify(&mut self) -> Result<Option<Identity>, LinkError> {
        let words = u16::try_from(IDENTITY_WORDS).unwrap_or(MOST_READ);
        let block = match self.read(ReadRequest::holding(IDENTITY_ADDRESS, words)) {
            Ok(block) => block,
            Err(LinkError::Exception { .. }) => return Ok(None),
            Err(error) => return Err(error),
        };
        if !self.vouch()? {
            return Ok(None);
        }
        let block = block.as_slice().try_into().ok();
        let block = block.and_then(|b| firmware_protocol::Identity::from_registers(b).ok());
        Ok(block.map(|block| identity(&block)))
    }
}

/// Silence after which a server that took an unknown request for the start of another one listens again (libmodbus:
/// one second).
const RECOVERY: Duration = Duration::from_millis(1200);

impl RawClient {
    /// Vendor, product and revision as the unit gives them; empty where it does not.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only: a unit that has no names is no fault.
    pub fn names(&mut self) -> Result<Vec<String>, LinkError> {
        // Read device identification, basic objects, from the first.
        let objects = self.optional(&[43, 14, 1, 0], "the device identification")?;
        Ok(objects.map_or_else(Vec::new, |pdu| object_texts(&pdu)))
    }

    /// One object of the identification; `None` where the unit does not have it.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only.
    pub fn object(&mut self, object: u8) -> Result<Option<String>, LinkError> {
        let objects = self.optional(&[43, 14, 4, object], "an object of the identification")?;
        Ok(objects.and_then(|pdu| object_texts(&pdu).into_iter().next()))
    }

    /// Whether the unit sends a number back; `None` where it has never answered anything.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only.
    pub fn sends_back(&mut self) -> Result<Option<bool>, LinkError> {
        if !self.is_heard() {
            return Ok(None);
        }
        let echo = self.optional(&[8, 0, 0, 0x5A, 0xC3], "the diagnostic echo")?;
        Ok(Some(echo.is_some()))
    }

    /// The answer to a question that not every unit knows.
    fn optional(&mut self, pdu: &[u8], what: &str) -> Result<Option<Vec<u8>>, LinkError> {
        if !self.is_heard() {
            return Ok(None);
        }
        match self.ask(pdu, what) {
            Ok(answer) => Ok(Some(answer.to_vec())),
            Err(error @ LinkError::Gone { .. }) => Err(error),
            Err(LinkError::Exception { .. }) => Ok(None),
            Err(_) => {
                std::thread::sleep(RECOVERY);
                Ok(None)
            }
        }
    }
}

/// The texts of the objects of a device identification; what does not fit its own lengths ends the list.
fn object_texts(pdu: &[u8]) -> Vec<String> {
    let mut rest = pdu.get(7..).unwrap_or_default();
    let mut texts = Vec::new();
    while let [_, length, tail @ ..] = rest
        && let Some((text, after)) = tail.split_at_checked(usize::from(*length))
    {
        texts.push(String::from_utf8_lossy(text).into_owned());
        rest = after;
    }
    texts
}

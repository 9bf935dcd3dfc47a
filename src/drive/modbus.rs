//! The Modbus link: one exchange is one request of function code 23, which writes the command and reads the sample.
//!
//! ```text
//! exchange: gap, listen -> FC23 { sequence, control, set-point | 16 registers } -> only a reply that echoes the sequence
//! read:     gap, listen, the steps of transaction/proof.rs -> FC03 | 04
//! ```
//!
//! A command is its own proof: its sequence number comes back with the sample. The reply to a plain read says neither
//! what was read nor when: only function, unit and length.
//!
//! This file owns the clock of the exchanges.
//! bus.rs shows the link as registers, for drives with a map of their own.

mod bus;

use std::borrow::Cow;
use std::time::{Duration, Instant};

use firmware_protocol::registers::{
    COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS, IDENTITY_WORDS, SEQUENCE_ECHO,
    TELEMETRY_ADDRESS, TELEMETRY_WORDS,
};
use firmware_protocol::{DriveCommand, Telemetry};
use tokio::runtime::Runtime;
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Error, Request, Response, Slave};

use super::burst::Burst;
use super::clock_map::ClockMap;
use super::guard::{Guard, Port, now};
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use super::raw::{ReadRequest, exception_name, registers};
use super::reply::{Echo, FrameKind};
use super::tally::{RoundTrips, Tally};
use super::timeline::{Timeline, control, identity, identity_error, low_word};
use super::timing::{LineTiming, wait_until};
use super::transaction::{
    Bound, CutIn, End, LineCounts, Method, PATIENCE, Policy, Proof, Step, out_of_step, restless,
};
use crate::sample::{Command, Demand, DriveState, Sample};

pub use bus::ModbusBus;

/// Times that a question without effect is asked before it counts as failed.
const READ_ATTEMPTS: usize = 3;
/// Probes of one bounded exchange, which has other things to do.
const MOST_PROBES: usize = 3;
/// Times that a stop is asked for.
const STOP_ATTEMPTS: usize = 5;
/// Commands that fail one after the other before the line is given time to fall silent: the first may have been bad luck.
const FAILURES_BEFORE_SILENCE: u32 = 2;
/// Where the sequence number stands in the PDU of the reply: behind function, length, and the registers before it.
const ECHO_AT: usize = 2 + 2 * (SEQUENCE_ECHO.address - TELEMETRY_ADDRESS) as usize;
/// With less time left nothing is asked any more.
const SHORTEST_EXCHANGE: Duration = Duration::from_millis(1);
const NAMES: &str = "the device identification";
/// RTU frames of a command and of its reply.
pub(super) const COMMAND_BYTES: usize = 13 + 2 * COMMAND_WORDS;
pub(super) const TELEMETRY_BYTES: usize = 5 + 2 * TELEMETRY_WORDS;

/// Which of the two register tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegisterTable {
    Holding,
    Input,
}

/// A drive behind Modbus RTU or TCP.
pub struct ModbusLink {
    name: String,
    // The order matters: what uses the runtime goes before it.
    context: Context,
    guard: Guard,
    runtime: Runtime,
    kind: FrameKind,
    unit: u8,
    timing: LineTiming,
    tally: Tally,
    timeline: Timeline,
    epoch: Instant,
    last_seq: u64,
    proof: Proof,
    bound: Bound,
    /// Distance of captured samples as the drive tells it, s; 0: it captures nothing.
    capture_period_s: f64,
    retries: u64,
    /// Time spent in silences and probes.
    resync: Duration,
    /// Commands without a sample since the last one that had one.
    failed_in_a_row: u32,
    gone: bool,
}

/// What an exchange gave, with its host times, s since the epoch.
struct Answer<T> {
    value: T,
    /// First byte of the request out.
    asked_s: f64,
    /// First byte of its reply in.
    answered_s: f64,
    /// The reply was complete.
    complete_s: f64,
}

/// What goes out, as tokio-modbus and as the proof want it.
struct Question<'a> {
    request: Request<'a>,
    pdu: [u8; 5],
    what: &'a str,
    allowed: Duration,
    /// It can be given up at once where a stop is wanted.
    is_probe: bool,
    /// Its reply carries its own number.
    is_numbered: bool,
}

impl<'a> Question<'a> {
    const fn plain(request: Request<'a>, pdu: [u8; 5], what: &'a str, allowed: Duration) -> Self {
        Self {
            request,
            pdu,
            what,
            allowed,
            is_probe: false,
            is_numbered: false,
        }
    }
}

impl ModbusLink {
    /// A link over a port that was opened within `runtime`.
    pub(super) fn new(
        name: String,
        runtime: Runtime,
        port: Box<dyn Port>,
        kind: FrameKind,
        unit: u8,
        timing: LineTiming,
        epoch: Instant,
    ) -> Self {
        let guard = Guard::new(port, kind);
        let policy = match kind {
            FrameKind::Rtu => Policy::Fixed(Method::Nonce),
            FrameKind::Tcp => Policy::Numbered,
        };
        Self {
            context: attach(&guard, kind, unit),
            name,
            guard,
            runtime,
            kind,
            unit,
            timing,
            tally: Tally::default(),
            timeline: Timeline::default(),
            epoch,
            last_seq: 0,
            proof: Proof::new(policy, timing.quiet(), now()).always_apart(),
            bound: Bound::default(),
            capture_period_s: 0.0,
            retries: 0,
            resync: Duration::ZERO,
            failed_in_a_row: 0,
            gone: false,
        }
    }

    /// Raw registers, 1 to 125 of them.
    pub fn read_registers(
        &mut self,
        table: RegisterTable,
        address: u16,
        count: u16,
    ) -> Result<Vec<u16>, LinkError> {
        let what = format!("read {} at {address}", registers(count.into()));
        let read = ReadRequest {
            table,
            address,
            count,
        };
        let allowed = self.timing.allowed(8, read.reply_bytes());
        let answer = self.read_with_retries(|| question(read, &what, allowed), words(read))?;
        Ok(answer.value)
    }

    /// Writes raw registers, 1 to 123 of them; never repeated by itself.
    pub fn write_registers(&mut self, address: u16, values: &[u16]) -> Result<(), LinkError> {
        let what = format!("write {} at {address}", registers(values.len()));
        let request = Request::WriteMultipleRegisters(address, Cow::Borrowed(values));
        let allowed = self.timing.allowed(9 + 2 * values.len(), 8);
        let question = Question::plain(request, [16, 0, 0, 0, 0], &what, allowed);
        self.in_step(&question.pdu)?;
        self.call(question, |response| match response {
            Response::WriteMultipleRegisters(..) => Ok(()),
            other => Err(format!("{other:?}")),
        })
        .map(|answer| answer.value)
    }

    /// One command on the wire. Only a reply that carries its number is its sample.
    fn command(&mut self, command: Command) -> Result<Sample, LinkError> {
        let seq = low_word(command.seq);
        self.guard.expect(Echo {
            at: ECHO_AT,
            bytes: seq.to_be_bytes(),
        });
        let words: [u16; COMMAND_WORDS] = DriveCommand {
            seq,
            control: control(command.demand),
        }
        .to_registers();
        self.last_seq = command.seq;
        let request = Request::ReadWriteMultipleRegisters(
            TELEMETRY_ADDRESS,
            quantity(TELEMETRY_WORDS),
            COMMAND_ADDRESS,
            Cow::Borrowed(&words),
        );
        let [a, b] = TELEMETRY_ADDRESS.to_be_bytes();
        let [c, d] = quantity(TELEMETRY_WORDS).to_be_bytes();
        let allowed = self.timing.allowed(COMMAND_BYTES, TELEMETRY_BYTES);
        let question = Question {
            is_numbered: true,
            ..Question::plain(request, [23, a, b, c, d], "the command", allowed)
        };
        let answer = self.call(question, |response| match response {
            Response::ReadWriteMultipleRegisters(values) => telemetry(&values),
            other => Err(format!("{other:?}")),
        });
        self.failed_in_a_row = match &answer {
            Ok(_) => 0,
            Err(_) => self.failed_in_a_row.saturating_add(1),
        };
        let answer = answer?;
        let mut sample = self.timeline.sample(
            &answer.value,
            command.seq,
            answer.asked_s,
            answer.answered_s,
        );
        sample.host_time_s = Some(answer.complete_s);
        Ok(sample)
    }

    /// Reads the drive's clock: raw, us, and on the time axis of the samples, s.
    fn note_clock(&mut self) -> Result<(u32, f64), LinkError> {
        let read = ReadRequest {
            table: RegisterTable::Holding,
            address: TELEMETRY_ADDRESS,
            count: quantity(TELEMETRY_WORDS),
        };
        let allowed = self.timing.allowed(8, read.reply_bytes());
        let ask = || question(read, "the telemetry", allowed);
        let values = words(read);
        let answer = self.read_with_retries(ask, |response| telemetry(&values(response)?))?;
        let time_us = answer.value.time_us;
        let time_s = self
            .timeline
            .note(time_us, answer.asked_s, answer.answered_s);
        Ok((time_us, time_s))
    }

    /// A question without effect on the drive may be asked again.
    fn read_with_retries<'a, T>(
        &mut self,
        question: impl Fn() -> Question<'a>,
        check: impl Fn(Response) -> Result<T, String>,
    ) -> Result<Answer<T>, LinkError> {
        let mut attempt = 1;
        loop {
            let question = question();
            let result = self
                .in_step(&question.pdu)
                .and_then(|()| self.call(question, &check));
            match result {
                Err(error) if self.may_retry(&error, attempt) => attempt += 1,
                result => return result,
            }
        }
    }

    /// Whether a question that ended so is asked once more: within the time of the exchange, and of nobody who wants a stop.
    fn may_retry(&mut self, error: &LinkError, attempt: usize) -> bool {
        let may = error.is_transient()
            && !matches!(error, LinkError::Unproven { .. })
            && attempt < READ_ATTEMPTS
            && !self.bound.is_over(now());
        self.retries += u64::from(may);
        may
    }

    /// Waits out the gap before a request and looks at what came meanwhile: nobody asked for it.
    fn listen(&mut self) -> Result<(), LinkError> {
        self.live()?;
        if self.kind == FrameKind::Rtu {
            let last = self.guard.inner().reception.last_activity;
            wait_until(last + self.timing.gap());
        }
        let strays = self.runtime.block_on(self.guard.begin());
        self.judge(strays).map(drop)
    }

    /// What came while nothing was outstanding.
    fn judge(&mut self, strays: std::io::Result<usize>) -> Result<usize, LinkError> {
        let count = strays.map_err(|error| self.lost(&error))?;
        if count > 0 {
            let heard = self.guard.inner().reception.take_heard();
            self.proof.disturbed(&heard, now());
        }
        Ok(count)
    }

    /// Silence up to this instant, or until something comes (false); an error where the exchange must not take so long.
    fn keep_silent(&mut self, until: Instant) -> Result<bool, LinkError> {
        loop {
            let now = now();
            if now >= until {
                return Ok(true);
            }
            if self.bound.is_over(now) {
                return Err(self.unproven());
            }
            let look = self.guard.listen_until(self.bound.next_look(now, until));
            let came = self.runtime.block_on(look);
            if self.judge(came)? > 0 {
                return Ok(false);
            }
        }
    }

    /// Carries out what has to be done before this request: whatever comes next is then no reply to something older. In a
    /// bounded exchange a few probes are asked, and the next exchange goes on from there.
    fn in_step(&mut self, pdu: &[u8]) -> Result<(), LinkError> {
        let begun = now();
        let result = self.carry_out(pdu);
        self.resync += now().saturating_duration_since(begun);
        result
    }

    fn carry_out(&mut self, pdu: &[u8]) -> Result<(), LinkError> {
        self.listen()?;
        let mut probes = 0;
        loop {
            match self.proof.next(pdu, now()) {
                Step::Go => return Ok(()),
                Step::Silence(until) => drop(self.keep_silent(until)?),
                Step::Probe(_)
                    if self.bound.is_set()
                        && (probes == MOST_PROBES || self.bound.is_over(now())) =>
                {
                    return Err(self.unproven());
                }
                Step::Probe(pdu) => {
                    probes += 1;
                    self.listen()?;
                    match self.probe(pdu) {
                        Err(error @ LinkError::Gone { .. }) => return Err(error),
                        // How it ended is known to the proof.
                        _ => self.listen()?,
                    }
                }
                Step::Restless => return Err(restless(&self.name)),
                Step::GiveUp => return Err(out_of_step(&self.name)),
            }
        }
    }

    /// One probe. The guard compares all its bytes.
    fn probe(&mut self, pdu: [u8; 5]) -> Result<(), LinkError> {
        let [function, data @ ..] = pdu;
        let [a, b, c, d] = data;
        let (address, count) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        let (request, words) = match function {
            3 => (Request::ReadHoldingRegisters(address, count), count),
            4 => (Request::ReadInputRegisters(address, count), count),
            _ => (Request::Custom(8, Cow::Owned(data.to_vec())), 2),
        };
        let allowed = self.timing.hurried(8, 5 + 2 * usize::from(words));
        let question = Question {
            is_probe: true,
            ..Question::plain(request, pdu, "the probe", allowed)
        };
        self.call(question, |_| Ok(())).map(drop)
    }

    /// One request and its reply, booked in the statistics; who calls has listened. `check` turns the reply into a
    /// value or says what is wrong with it.
    fn call<T>(
        &mut self,
        question: Question<'_>,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>, LinkError> {
        let sent = now();
        let deadline = self.bound.earlier(sent + question.allowed);
        if deadline < sent + SHORTEST_EXCHANGE {
            return Err(self.unproven());
        }
        // What came before the request has been judged.
        self.guard.inner().reception.take_anomaly();
        self.proof.asked(&question.pdu, question.is_probe, sent);
        let Question {
            request,
            what,
            is_probe,
            ..
        } = question;
        let (context, bound) = (&mut self.context, &self.bound);
        let reply = self.runtime.block_on(async {
            let mut call = std::pin::pin!(context.call(request));
            loop {
                let now = now();
                let look = if is_probe {
                    bound.next_look(now, deadline)
                } else {
                    deadline
                };
                match tokio::time::timeout_at(look.into(), call.as_mut()).await {
                    Err(_) if look < deadline && !bound.is_over(look) => {}
                    reply => break reply,
                }
            }
        });
        let received = now();
        let waited = received.saturating_duration_since(sent);
        let result = match reply {
            Ok(Ok(Ok(response))) => check(response).map_err(|reason| self.mismatch(reason)),
            Ok(Ok(Err(code))) => Err(self.exception(what, code.into())),
            Ok(Err(Error::Protocol(error))) => Err(self.mismatch(error.to_string())),
            Ok(Err(Error::Transport(error))) => Err(self.broken(&error)),
            // No reply in time: what came instead tells the class.
            Err(_) => {
                let left = self.guard.inner().reception.leftover();
                Err(left.error(&self.name, what, waited))
            }
        };
        let end = match &result {
            Ok(_) => End::Data,
            Err(LinkError::Exception { .. }) => End::Refused,
            Err(_) => End::Missing,
        };
        let (asked, answered) = {
            let reception = &mut self.guard.inner().reception;
            if end == End::Missing {
                reception.retire();
            }
            let strays = reception.take_anomaly();
            let heard = reception.take_heard();
            let is_numbered = question.is_numbered;
            self.proof.ended(end, &heard, strays, is_numbered, received);
            (reception.asked, reception.answered)
        };
        if result.is_err() && self.kind == FrameKind::Rtu {
            // A request that was cut off must not stay in the client's buffer. Over TCP the client keeps the
            // transaction number, and the guard drops replies to older ones.
            self.context = attach(&self.guard, self.kind, self.unit);
        }
        self.tally.settle(&result, waited.as_secs_f64());
        result.map(|value| Answer {
            value,
            asked_s: self.host_s(asked.unwrap_or(sent)),
            answered_s: self.host_s(answered.unwrap_or(received)),
            complete_s: self.host_s(received),
        })
    }

    fn host_s(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.epoch).as_secs_f64()
    }

    fn live(&self) -> Result<(), LinkError> {
        if self.gone {
            return Err(LinkError::Gone {
                link: self.name.clone(),
                reason: "it broke before".to_owned(),
            });
        }
        Ok(())
    }

    fn lost(&mut self, error: &std::io::Error) -> LinkError {
        self.close();
        LinkError::Gone {
            link: self.name.clone(),
            reason: error.to_string(),
        }
    }

    fn broken(&mut self, error: &std::io::Error) -> LinkError {
        if error.kind() == std::io::ErrorKind::InvalidData {
            LinkError::Corrupt {
                link: self.name.clone(),
                reason: error.to_string(),
            }
        } else {
            self.lost(error)
        }
    }

    fn mismatch(&self, reason: String) -> LinkError {
        LinkError::Mismatch {
            link: self.name.clone(),
            reason,
        }
    }

    fn exception(&self, what: &str, code: u8) -> LinkError {
        LinkError::Exception {
            link: self.name.clone(),
            request: what.to_owned(),
            code,
            name: exception_name(code),
        }
    }

    /// The time of the exchange is over, or a stop is wanted, before the line was in step.
    fn unproven(&self) -> LinkError {
        LinkError::Unproven {
            link: self.name.clone(),
            reason:
                "the line is not proven to be in step yet, and the time of this exchange is over"
                    .to_owned(),
        }
    }

    /// What goes out at once ends after this, s at the most: on a line in doubt nothing that is slower is waited for.
    fn brief(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        let allowed = self.timing.allowed(request_bytes, reply_bytes);
        if self.proof.is_suspect() {
            allowed.min(self.timing.brief(request_bytes, reply_bytes))
        } else {
            allowed
        }
    }

    fn line_counts(&self) -> LineCounts {
        LineCounts {
            retries: self.retries,
            resync_ms: u64::try_from(self.resync.as_millis()).unwrap_or(u64::MAX),
            ..self.guard.inner().reception.line
        }
    }
}

impl DriveLink for ModbusLink {
    fn name(&self) -> LinkName {
        LinkName(self.name.clone())
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        let block = self.read_registers(
            RegisterTable::Holding,
            IDENTITY_ADDRESS,
            quantity(IDENTITY_WORDS),
        )?;
        let block = block
            .as_slice()
            .try_into()
            .map_err(|_| self.mismatch(format!("{} registers of identity", block.len())))?;
        let block = firmware_protocol::Identity::from_registers(block)
            .map_err(|error| identity_error(&self.name, error))?;
        let mut identity = identity(&block);
        // Names are a comfort that a drive need not offer.
        let allowed = self.timing.allowed(7, 256);
        let ask = || {
            let request = Request::ReadDeviceIdentification(ReadCode::Regular, 0);
            Question::plain(request, [43, 14, 2, 0, 0], NAMES, allowed)
        };
        let names = self.read_with_retries(ask, |response| match response {
            Response::ReadDeviceIdentification(names) => Ok(names.device_id_objects),
            other => Err(format!("{other:?}")),
        });
        match names {
            Ok(names) => {
                let text = |id| {
                    names
                        .value
                        .iter()
                        .find(|object| object.id == id)
                        .and_then(|object| object.value_as_str())
                };
                text(0).unwrap_or_default().clone_into(&mut identity.vendor);
                let product = text(4).or_else(|| text(1)).unwrap_or_default();
                product.clone_into(&mut identity.product);
                if let Some(revision) = text(2) {
                    revision.clone_into(&mut identity.firmware);
                }
            }
            Err(LinkError::Exception { .. }) => {}
            Err(error) => return Err(error),
        }
        self.capture_period_s = f64::from(block.capture_period_us) * 1e-6;
        // The origin of the time axis.
        self.note_clock()?;
        Ok(identity)
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        self.listen()?;
        let waits = self.failed_in_a_row >= FAILURES_BEFORE_SILENCE && self.kind == FrameKind::Rtu;
        // A stop goes out at once, also where the line is never silent.
        if waits && command.demand.energises() {
            let quiet = self.timing.quiet();
            let patience = now() + PATIENCE * quiet;
            while !self.keep_silent(now() + quiet)? {
                if now() >= patience {
                    return Err(restless(&self.name));
                }
            }
        }
        self.command(command)
    }

    /// Goes out at once even on a suspect line: the echo of its own sequence number proves that it was applied.
    fn stop(&mut self) -> Result<(), LinkError> {
        self.bound.set(f64::INFINITY, now());
        let stop = Command {
            seq: self.last_seq.wrapping_add(1),
            demand: Demand::Stop,
        };
        let mut last = LinkError::Corrupt {
            link: self.name.clone(),
            reason: format!("the drive still runs after {STOP_ATTEMPTS} requests to stop"),
        };
        for _ in 0..STOP_ATTEMPTS {
            self.listen()?;
            match self.command(stop) {
                Ok(sample) if sample.state != Some(DriveState::Running) => return Ok(()),
                Ok(_) => {}
                Err(error @ LinkError::Gone { .. }) => return Err(error),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn close(&mut self) {
        self.gone = true;
        self.guard.close();
    }

    fn statistics(&self) -> LinkStatistics {
        self.tally.statistics
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        self.timing.shortest_cycle_s(COMMAND_BYTES, TELEMETRY_BYTES)
    }

    fn round_trips(&self) -> Option<&RoundTrips> {
        Some(&self.tally.round_trips)
    }

    fn line(&self) -> Option<LineCounts> {
        Some(self.line_counts())
    }

    fn bound(&mut self, left_s: f64) {
        self.bound.set(left_s, now());
    }

    fn cut_in(&mut self) -> Option<&mut CutIn> {
        Some(&mut self.bound.cut_in)
    }

    fn burst(&mut self) -> Option<&mut dyn Burst> {
        (self.capture_period_s > 0.0).then_some(self as &mut dyn Burst)
    }

    fn clock_map(&self) -> Option<&ClockMap> {
        Some(&self.timeline.map)
    }
}

fn attach(guard: &Guard, kind: FrameKind, unit: u8) -> Context {
    match kind {
        FrameKind::Rtu => rtu::attach_slave(guard.clone(), Slave(unit)),
        FrameKind::Tcp => tcp::attach_slave(guard.clone(), Slave(unit)),
    }
}

fn telemetry(values: &[u16]) -> Result<Telemetry, String> {
    let block: &[u16; TELEMETRY_WORDS] = values
        .try_into()
        .map_err(|_| format!("it has {} registers, not {TELEMETRY_WORDS}", values.len()))?;
    Ok(Telemetry::from_registers(block))
}

/// A block of the register table as a quantity of a request.
fn quantity(words: usize) -> u16 {
    u16::try_from(words).expect("blocks of the register table fit a request")
}

/// The question for registers.
fn question(read: ReadRequest, what: &str, allowed: Duration) -> Question<'_> {
    let request = match read.table {
        RegisterTable::Holding => Request::ReadHoldingRegisters(read.address, read.count),
        RegisterTable::Input => Request::ReadInputRegisters(read.address, read.count),
    };
    Question::plain(request, read.pdu(), what, allowed)
}

/// The registers that were asked for.
fn words(read: ReadRequest) -> impl Fn(Response) -> Result<Vec<u16>, String> {
    move |response| match response {
        Response::ReadHoldingRegisters(values) | Response::ReadInputRegisters(values)
            if values.len() == usize::from(read.count) =>
        {
            Ok(values)
        }
        other => Err(format!("{other:?}")),
    }
}

#[path = "modbus_burst.rs"]
mod burst;

#[cfg(test)]
#[path = "modbus_tests.rs"]
mod tests;

//! The Modbus link: one exchange is one request of function code 23, which writes the command and reads the sample.
//!
//! ```text
//! exchange: gap, listen -> FC23 { sequence, control, set-point | 16 registers } -> only a reply that echoes the sequence
//! read:     gap, listen, the steps of proof.rs -> FC03 | 04
//! ```
//!
//! A command is its own proof: its sequence number comes back with the sample. The reply to a plain read shows neither
//! what was read nor when: only function, unit and length. Windows of a burst carry their own index in front, so no late
//! window can be taken for another.
//!
//! This file owns the clock of the exchanges.
//! bus.rs shows the link as registers, for drives with a map of their own; raw.rs as registers of any unit.

mod bus;
mod raw;

use std::borrow::Cow;
use std::time::{Duration, Instant};

use firmware_protocol::registers::{
    CAPTURE_CONTROL, CAPTURE_STATE, COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS,
    IDENTITY_WORDS, SEQUENCE_ECHO, TELEMETRY_ADDRESS, TELEMETRY_WORDS,
};
use firmware_protocol::{CaptureControl, CaptureState, Telemetry};
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Error, ProtocolError, Request, Response, Slave};

use super::burst::{Burst, Capture, WINDOW_ADDRESS, WINDOW_WORDS, window_samples};
use super::exceptions::{BusyPauses, Requested, exception_name};
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics, Result, RoundTrips};
use super::link_core::{Answer, LinkCore, READ_ATTEMPTS, own_link, stop_confirmed};
use super::proof::{DEADLINE_SILENCES, End, Method, Policy, Proof, Step};
use super::register_bus::{RTU, ReadRequest, RegisterTable, registers};
use super::reply::{Echo, FrameKind};
use super::reply_filter::{Port, ReplyFilter};
use super::timeline::{identity, identity_error, signed_difference};
use super::timing::{LineTiming, wait_until};
use super::transaction::{LineCounts, StopRequest, never_silent, out_of_step};
use super::unexpected::Unexpected;
use super::waiting::{Waiting, now};
use drivebench_model::sample::{Command, Sample};

pub use bus::ModbusBus;
pub use raw::{
    Batch, RawClient, RawCounters, RawSettings, Read, WriteFunction, WriteOutcome, Written,
    read_batch,
};

/// Frames of the device identification, bytes: its request, and the longest reply.
const NAMES_BYTES: (usize, usize) = (7, 256);
const NAMES: &str = "the device identification";
/// RTU frames of a command and of its reply.
pub(super) const COMMAND_BYTES: usize = RTU.read_write + 2 * COMMAND_WORDS;
pub(super) const TELEMETRY_BYTES: usize = RTU.read_reply + 2 * TELEMETRY_WORDS;

pub struct ModbusLink {
    core: LinkCore,
    // The order matters: what uses the runtime that waits goes before it.
    context: Context,
    filter: ReplyFilter,
    waiting: Waiting,
    kind: FrameKind,
    unit: u8,
    proof: Proof,
    retries: u64,
    /// Reads that were repeated because the unit was busy.
    busy_repeats: u64,
    /// It was busy to the end of the last of them: it gets no more time before it has answered.
    stays_busy: bool,
    resync: Duration,
    /// Probes for resynchronisation, and the number of disturbances that caused them.
    probes: u64,
    resynchronisations: u64,
    /// Duration of the last exchange that got a reply.
    last_round_trip: Duration,
    /// Commands without a sample since the last one that had one.
    failed_in_a_row: u32,
    /// Settings of the line, for the error of a unit that never answers.
    at: Option<String>,
}

/// A request in the form of tokio-modbus and as the PDU for the proof.
#[derive(Clone)]
struct Question<'a> {
    request: Request<'a>,
    pdu: [u8; 5],
    what: &'a str,
    allowed: Duration,
    /// Interrupted when a stop is requested.
    is_probe: bool,
    /// Its reply carries its own number.
    is_numbered: bool,
}

impl<'a> Question<'a> {
    const fn plain(request: Request<'a>, pdu: [u8; 5], what: &'a str, allowed: Duration) -> Self {
        Self { request, pdu, what, allowed, is_probe: false, is_numbered: false }
    }

    fn read(read: ReadRequest, what: &'a str, allowed: Duration) -> Self {
        let request = match read.table {
            RegisterTable::Holding => Request::ReadHoldingRegisters(read.address, read.count),
            RegisterTable::Input => Request::ReadInputRegisters(read.address, read.count),
        };
        Self::plain(request, read.pdu(), what, allowed)
    }

    /// For the help of an exception.
    fn requested(&self) -> Requested {
        let count = match &self.request {
            Request::ReadHoldingRegisters(_, count)
            | Request::ReadInputRegisters(_, count)
            | Request::ReadWriteMultipleRegisters(_, count, ..) => *count,
            Request::WriteMultipleRegisters(_, values) => quantity(values.len()),
            _ => 1,
        };
        Requested { function: self.pdu[0], count, is_of_profile: false }
    }

    const fn numbered(mut self) -> Self {
        self.is_numbered = true;
        self
    }
}

impl ModbusLink {
    /// A link over a port that was opened within the runtime that waits for it.
    pub(super) fn new(
        name: String,
        waiting: Waiting,
        port: Box<dyn Port>,
        kind: FrameKind,
        unit: u8,
        timing: LineTiming,
        epoch: Instant,
    ) -> Self {
        let filter = ReplyFilter::new(port, kind);
        let policy = match kind {
            FrameKind::Rtu => Policy::Fixed(Method::Nonce),
            FrameKind::Tcp => Policy::Numbered,
        };
        Self {
            proof: Proof::new(policy, timing.quiet(), now()).always_apart(),
            core: LinkCore::new(name, timing, epoch),
            context: attach(&filter, kind, unit),
            filter,
            waiting,
            kind,
            unit,
            retries: 0,
            busy_repeats: 0,
            stays_busy: false,
            resync: Duration::ZERO,
            probes: 0,
            resynchronisations: 0,
            last_round_trip: Duration::ZERO,
            failed_in_a_row: 0,
            at: None,
        }
    }

    /// Raw registers, 1 to 125 of them.
    pub fn read_registers(
        &mut self,
        table: RegisterTable,
        address: u16,
        count: u16,
    ) -> Result<Vec<u16>> {
        let read = ReadRequest { table, address, count };
        Ok(self.read_checked(read, &read.text())?.value)
    }

    fn read_checked(&mut self, read: ReadRequest, what: &str) -> Result<Answer<Vec<u16>>> {
        let allowed = self.core.timing.allowed(RTU.read, read.reply_bytes());
        self.read_with_retries(&Question::read(read, what, allowed), words(read.count.into()))
    }

    /// Writes raw registers, 1 to 123 of them; never repeated by itself.
    pub fn write_registers(&mut self, address: u16, values: &[u16]) -> Result<()> {
        let what = format!("write {} at {address}", registers(values.len()));
        let request = Request::WriteMultipleRegisters(address, Cow::Borrowed(values));
        let bytes = RTU.write + 2 * values.len();
        let allowed = self.core.timing.allowed(bytes, RTU.written);
        let question = Question::plain(request, [16, 0, 0, 0, 0], &what, allowed);
        self.ask(question, acknowledged).map(|answer| answer.value)
    }

    /// One command on the wire. Only a reply that carries its number is its sample.
    fn command(&mut self, command: Command) -> Result<Sample> {
        let travels = self.core.command(command);
        // Position in the PDU of the reply: after function code, byte count and the registers before it.
        let at = 2 + 2 * usize::from(SEQUENCE_ECHO.address - TELEMETRY_ADDRESS);
        self.filter.expect(Echo { at, bytes: travels.seq.to_be_bytes() });
        let sent: [u16; COMMAND_WORDS] = travels.to_registers();
        let read = telemetry_request();
        let request = Request::ReadWriteMultipleRegisters(
            read.address,
            read.count,
            COMMAND_ADDRESS,
            Cow::Borrowed(&sent),
        );
        let [_, pdu @ ..] = read.pdu();
        let [a, b, c, d] = pdu;
        let allowed = self.core.timing.allowed(COMMAND_BYTES, TELEMETRY_BYTES);
        let question = Question::plain(request, [23, a, b, c, d], "the command", allowed);
        let answer = self.call(question.numbered(), telemetry);
        self.failed_in_a_row = match &answer {
            Ok(_) => 0,
            Err(_) => self.failed_in_a_row.saturating_add(1),
        };
        Ok(self.core.sample(command, &answer?))
    }

    /// Reads the drive's clock: raw, us, and on the time axis of the samples, s.
    fn note_clock(&mut self) -> Result<(u32, f64)> {
        let read = telemetry_request();
        let allowed = self.core.timing.allowed(RTU.read, read.reply_bytes());
        let question = Question::read(read, "the telemetry", allowed);
        let answer = self.read_with_retries(&question, telemetry)?;
        let time_us = answer.value.time_us;
        Ok((time_us, self.core.timeline.note(time_us, answer.span)))
    }

    fn window(&mut self, index: u16) -> Result<Vec<u16>> {
        let sent = [index];
        let bytes = (RTU.read_write + 2, RTU.read_reply + 2 * WINDOW_WORDS);
        let allowed = self.core.timing.unhurried(bytes.0, bytes.1);
        let request = Request::ReadWriteMultipleRegisters(
            WINDOW_ADDRESS,
            quantity(WINDOW_WORDS),
            WINDOW_ADDRESS,
            Cow::Borrowed(&sent),
        );
        let question = Question::plain(request, [23, 0, 0, 0, 0], "captured samples", allowed);
        self.with_retries(|link| {
            link.listen()?;
            link.filter.expect(Echo { at: 2, bytes: index.to_be_bytes() });
            let answer = link.call(question.clone().numbered(), words(WINDOW_WORDS))?;
            Ok(answer.value)
        })
    }

    /// A request without side effects may be repeated.
    fn read_with_retries<T>(
        &mut self,
        question: &Question<'_>,
        check: impl Fn(Response) -> Result<T, String>,
    ) -> Result<Answer<T>> {
        self.with_retries(|link| link.ask(question.clone(), &check))
    }

    /// One request on a synchronised line.
    fn ask<T>(
        &mut self,
        question: Question<'_>,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>> {
        self.in_step(&question.pdu)?;
        self.call(question, check)
    }

    /// Repeats a read for a while as long as the unit is busy. Not within the bound of an exchange: there the next cycle reads again.
    fn while_busy<T>(&mut self, mut ask: impl FnMut(&mut Self) -> Result<T>) -> Result<T> {
        let mut pauses = BusyPauses::default();
        loop {
            let result = ask(self);
            let may_wait = !self.stays_busy && !self.core.bound.is_set();
            let pause = result.as_ref().err().filter(|_| may_wait).and_then(|e| pauses.next(e));
            let Some(pause) = pause else {
                self.stays_busy = matches!(result, Err(LinkError::Exception { code: 5 | 6, .. }));
                return result;
            };
            self.busy_repeats += 1;
            wait_until(now() + pause);
        }
    }

    /// Until the bound of the exchange is over.
    fn with_retries<T>(&mut self, mut ask: impl FnMut(&mut Self) -> Result<T>) -> Result<T> {
        let mut attempt = 1;
        loop {
            match ask(self) {
                Err(error) if self.may_retry(&error, attempt) => attempt += 1,
                result => return result,
            }
        }
    }

    fn may_retry(&mut self, error: &LinkError, attempt: usize) -> bool {
        let may = error.is_transient()
            && !matches!(error, LinkError::Unproven { .. })
            && attempt < READ_ATTEMPTS
            && !self.core.bound.is_over(now());
        self.retries += u64::from(may);
        may
    }

    /// Waits for the gap before a request; bytes received meanwhile answer nothing.
    fn listen(&mut self) -> Result<()> {
        self.core.live()?;
        let strays = self.after_gap();
        self.judge(strays)?;
        self.drop_rest().map(drop)
    }

    /// Drops what is left, and returns how many bytes of it disturb.
    fn drop_rest(&mut self) -> Result<usize> {
        let rest = self.filter.inner().reception.drop_rest();
        self.judge(Ok(rest))
    }

    fn after_gap(&mut self) -> std::io::Result<usize> {
        let last = self.filter.inner().reception.last_activity;
        wait_until(last + self.core.timing.gap());
        self.waiting.at_once(self.filter.begin()).unwrap_or(Ok(0))
    }

    /// The same, and waits for the end of a copy of the last reply that is still coming.
    fn listen_out(&mut self) -> Result<()> {
        self.core.live()?;
        let until = now() + self.core.timing.quiet();
        loop {
            let strays = self.after_gap();
            self.judge(strays)?;
            let is_over = now() >= until || self.core.bound.is_over(now());
            if is_over || !self.filter.inner().reception.is_copying() {
                return self.drop_rest().map(drop);
            }
            let step = self.core.timing.gap().max(Duration::from_millis(1));
            let came = self.waiting.until(now() + step, self.filter.listen());
            self.judge(came.unwrap_or(Ok(0)))?;
        }
    }

    /// Handles bytes received while no request was outstanding.
    fn judge(&mut self, strays: std::io::Result<usize>) -> Result<usize> {
        let count = strays.map_err(|error| self.lost(&error))?;
        if count > 0 {
            let old = self.filter.inner().reception.take_old_replies();
            self.proof.disturbed(&old, now());
        }
        Ok(count)
    }

    /// Silence up to this instant, or until something comes (false); an error where the exchange must not take so long.
    fn keep_silent(&mut self, until: Instant) -> Result<bool> {
        loop {
            let now = now();
            if now >= until {
                return Ok(true);
            }
            if self.core.bound.is_over(now) {
                return Err(self.unproven());
            }
            let look = self.core.bound.next_look(now, until);
            let came = self.waiting.until(look, self.filter.listen());
            // Also what looks like the beginning of a copy: it may be that of a late reply.
            if self.judge(came.unwrap_or(Ok(0)))? + self.drop_rest()? > 0 {
                return Ok(false);
            }
        }
    }

    /// Synchronises the line before a request, so that the next reply cannot be that to an earlier one. A bounded exchange sends at
    /// most a few probes, and the next exchange continues.
    fn in_step(&mut self, pdu: &[u8]) -> Result<()> {
        let begun = now();
        let result = self.carry_out(pdu);
        self.resync += now().saturating_duration_since(begun);
        result
    }

    fn carry_out(&mut self, pdu: &[u8]) -> Result<()> {
        self.listen()?;
        let (mut probes, mut begun) = (0, false);
        let mut failed = None;
        loop {
            let is_late = |bound: &super::transaction::Bound| {
                // Most probes of one bounded exchange.
                bound.is_set() && (probes == 3 || bound.is_over(now()))
            };
            match self.proof.next(pdu, now()) {
                Step::Go => return Ok(()),
                Step::Silence(until) => drop(self.keep_silent(until)?),
                Step::Probe(_) if is_late(&self.core.bound) => return Err(self.unproven()),
                Step::Probe(pdu) => {
                    let is_new = self.proof.is_disturbed() && !std::mem::replace(&mut begun, true);
                    self.resynchronisations += u64::from(is_new);
                    self.probes += 1;
                    probes += 1;
                    self.listen()?;
                    match self.probe(pdu) {
                        Err(error @ LinkError::Gone { .. }) => return Err(error),
                        // How it ended is known to the proof.
                        probed => {
                            failed = probed.err();
                            self.listen_out()?;
                        }
                    }
                }
                Step::NeverSilent => return Err(never_silent(&self.core.name)),
                Step::GiveUp => return Err(unprobed(&self.core.name, failed)),
            }
        }
    }

    /// One probe. The filter compares all its bytes.
    fn probe(&mut self, pdu: [u8; 5]) -> Result<()> {
        let [function, data @ ..] = pdu;
        let [a, b, c, d] = data;
        let (address, count) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        let (request, words) = match function {
            3 => (Request::ReadHoldingRegisters(address, count), count),
            4 => (Request::ReadInputRegisters(address, count), count),
            _ => (Request::Custom(8, Cow::Owned(data.to_vec())), 2),
        };
        let reply = RTU.read_reply + 2 * usize::from(words);
        let allowed = self.core.timing.hurried(RTU.read, reply);
        let question =
            Question { is_probe: true, ..Question::plain(request, pdu, "the probe", allowed) };
        self.call(question, |_| Ok(())).map(drop)
    }

    /// One request and its reply, booked in the statistics; who calls has listened. `check` turns the reply into a
    /// value or says what is wrong with it.
    fn call<T>(
        &mut self,
        question: Question<'_>,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>> {
        let sent = now();
        let deadline = self.core.bound.earlier(sent + question.allowed);
        // With less time left no request goes out.
        if deadline < sent + Duration::from_millis(1) {
            return Err(self.unproven());
        }
        // What came before the request has been judged.
        self.filter.inner().reception.take_anomaly();
        self.proof.sent(&question.pdu, question.is_probe, sent);
        let requested = question.requested();
        let Question { request, what, is_probe, .. } = question;
        let reply = {
            let bound = &self.core.bound;
            let mut call = std::pin::pin!(self.context.call(request));
            loop {
                let look = if is_probe { bound.next_look(now(), deadline) } else { deadline };
                match self.waiting.until(look, call.as_mut()) {
                    None if look < deadline && !bound.is_over(look) => {}
                    reply => break reply,
                }
            }
        };
        let received = now();
        let waited = received.saturating_duration_since(sent);
        let result = match reply {
            Some(Ok(Ok(response))) => check(response).map_err(|reason| self.mismatch(reason)),
            Some(Ok(Err(code))) => Err(self.refusal(what, requested, code.into())),
            // The client takes the refusal of a diagnosis for one of another function; the filter has compared both.
            Some(Err(Error::Protocol(ProtocolError::FunctionCodeMismatch {
                result: Err(refused),
                ..
            }))) => Err(self.refusal(what, requested, refused.exception.into())),
            Some(Err(Error::Protocol(error))) => Err(self.mismatch(error.to_string())),
            Some(Err(Error::Transport(error))) => Err(self.broken(&error, what)),
            // No reply in time: what came instead tells the class.
            None => {
                let left = self.filter.inner().reception.leftover();
                let of = |at| format!("{what} of unit {}{at}", self.unit);
                let what = self.at.as_ref().map_or_else(|| what.to_owned(), of);
                Err(left.error(&self.core.name, what, waited.min(deadline - sent)))
            }
        };
        let end = End::of(&result);
        if end != End::Missing {
            self.last_round_trip = waited;
        }
        let (asked, answered) = {
            let reception = &mut self.filter.inner().reception;
            self.core.is_unsent = reception.asked.is_none();
            if end == End::Missing {
                reception.retire();
            }
            self.proof.settle(end, reception, question.is_numbered, received);
            (reception.asked, reception.answered)
        };
        if result.is_err() && self.kind == FrameKind::Rtu {
            // A request that was cut off must not stay in the client's buffer. Over TCP the client keeps the
            // transaction number, and the filter drops replies to older ones.
            self.attach();
        }
        let core = &mut self.core;
        core.tally.settle(&result, waited.as_secs_f64());
        result.map(|value| Answer {
            value,
            span: core.span(asked.unwrap_or(sent), answered.unwrap_or(received)),
            complete_s: core.host_s(received),
        })
    }

    fn attach(&mut self) {
        self.context = attach(&self.filter, self.kind, self.unit);
    }

    fn lost(&mut self, error: &std::io::Error) -> LinkError {
        self.close();
        self.core.gone(error)
    }

    fn broken(&mut self, error: &std::io::Error, request: &str) -> LinkError {
        if self.filter.inner().reception.is_rtu_over_tcp() {
            self.close();
            let (link, request) = (self.core.name.clone(), request.to_owned());
            return LinkError::Unexpected { link, request, what: Unexpected::RtuFrames };
        }
        if error.kind() == std::io::ErrorKind::InvalidData {
            LinkError::Corrupt(self.core.name.clone(), error.to_string())
        } else {
            self.lost(error)
        }
    }

    fn refusal(&self, what: &str, requested: Requested, code: u8) -> LinkError {
        LinkError::Exception {
            link: self.core.name.clone(),
            request: what.to_owned(),
            code,
            name: exception_name(code),
            requested,
        }
    }

    fn mismatch(&self, reason: String) -> LinkError {
        LinkError::Mismatch(self.core.name.clone(), reason)
    }

    /// Deadline of the exchange, or a stop request, before the line was synchronised.
    fn unproven(&self) -> LinkError {
        LinkError::Unproven(
            self.core.name.clone(),
            "the line is not proven to be in step yet, and the time of this exchange is over"
                .to_owned(),
        )
    }

    fn line_counts(&self) -> LineCounts {
        LineCounts {
            retries: self.retries,
            resync_ms: u64::try_from(self.resync.as_millis()).unwrap_or(u64::MAX),
            ..self.filter.inner().reception.line
        }
    }

    /// Sent at once even on a doubtful line: the echo of its sequence number proves that it was applied.
    fn stop_once(&mut self, stop: Command) -> Result<Sample> {
        self.core.is_unsent = true;
        self.listen()?;
        self.command(stop)
    }
}

impl DriveLink for ModbusLink {
    own_link!();

    fn identify(&mut self) -> Result<Identity> {
        let read = ReadRequest::holding(IDENTITY_ADDRESS, quantity(IDENTITY_WORDS));
        let block = self.while_busy(|link| link.read_checked(read, &read.text()));
        let block = block.map_err(LinkError::of_profile)?.value;
        let block = block
            .as_slice()
            .try_into()
            .map_err(|_| self.mismatch(format!("{} registers of identity", block.len())))?;
        let block = firmware_protocol::Identity::from_registers(block)
            .map_err(|error| identity_error(&self.core.name, error))?;
        let mut identity = identity(&block);
        // The device identification is optional.
        let allowed = self.core.timing.allowed(NAMES_BYTES.0, NAMES_BYTES.1);
        let question = identification(ReadCode::Regular, 0, NAMES, allowed);
        match self.while_busy(|link| link.read_with_retries(&question, objects)) {
            Ok(names) => {
                let text = |id| object_text(&names.value, id);
                identity.vendor = text(0).unwrap_or_default();
                identity.product = text(4).or_else(|| text(1)).unwrap_or_default();
                identity.firmware = text(2).unwrap_or(identity.firmware);
            }
            Err(LinkError::Exception { .. }) => {}
            Err(error) => return Err(error),
        }
        self.core.capture_period_s = f64::from(block.capture_period_us) * 1e-6;
        // The origin of the time axis.
        self.while_busy(Self::note_clock)?;
        Ok(identity)
    }

    fn exchange(&mut self, command: Command) -> Result<Sample> {
        self.core.is_unsent = true;
        self.listen()?;
        // After two failed commands in a row the line is given time to become silent.
        let waits = self.failed_in_a_row >= 2 && self.kind == FrameKind::Rtu;
        // A stop goes out at once, also where the line is never silent.
        if waits && command.demand.energises() {
            let quiet = self.core.timing.quiet();
            let deadline = now() + DEADLINE_SILENCES * quiet;
            while !self.keep_silent(now() + quiet)? {
                if now() >= deadline {
                    return Err(never_silent(&self.core.name));
                }
            }
        }
        self.command(command)
    }

    fn close(&mut self) {
        self.core.gone = true;
        self.filter.close();
    }

    fn line(&self) -> Option<LineCounts> {
        Some(self.line_counts())
    }

    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        Some(&mut self.core.bound.stop_request)
    }
}

/// Over the registers a burst is armed by one write and read back window by window.
impl Burst for ModbusLink {
    fn arm(&mut self) -> Result<()> {
        self.write_registers(CAPTURE_CONTROL.address, &[CaptureControl::Arm.code()])
    }

    fn fetch(&mut self) -> Result<Option<Capture>> {
        let table = RegisterTable::Holding;
        // State, count and the drive time of the first sample of a burst.
        let head = self.read_registers(table, CAPTURE_STATE.address, 4)?;
        let [state, count, high, low] = head[..] else {
            return Err(self.mismatch(format!("{} registers of a capture", head.len())));
        };
        if state != CaptureState::Complete.code() {
            return Ok(None);
        }
        let (time_us, now_s) = self.note_clock()?;
        let age_us = signed_difference(time_us, u32::from(high) << 16 | u32::from(low));
        let first_s = now_s - f64::from(age_us) * 1e-6;
        let period_s = self.core.capture_period_s;
        let name = self.core.name.clone();
        let block = |index| Ok(window_samples(index, &self.window(index)?));
        Capture::collect(&name, first_s, period_s, count, block).map(Some)
    }
}

/// Why the line could not be proven. Where the probes got nothing, a refusal or damage, that is what is wrong with it.
fn unprobed(name: &str, last: Option<LinkError>) -> LinkError {
    match last {
        Some(
            error @ (LinkError::Timeout { .. }
            | LinkError::Exception { .. }
            | LinkError::Unexpected { .. }
            | LinkError::Corrupt { .. }),
        ) => error,
        _ => out_of_step(name),
    }
}

fn attach(filter: &ReplyFilter, kind: FrameKind, unit: u8) -> Context {
    match kind {
        FrameKind::Rtu => rtu::attach_slave(filter.clone(), Slave(unit)),
        FrameKind::Tcp => tcp::attach_slave(filter.clone(), Slave(unit)),
    }
}

/// A block of the register table as a quantity of a request.
fn quantity(words: usize) -> u16 {
    u16::try_from(words).expect("blocks of the register table fit a request")
}

fn telemetry_request() -> ReadRequest {
    ReadRequest::holding(TELEMETRY_ADDRESS, quantity(TELEMETRY_WORDS))
}

fn telemetry(response: Response) -> Result<Telemetry, String> {
    let block =
        words(TELEMETRY_WORDS)(response)?.try_into().map_err(|values| format!("{values:?}"))?;
    Ok(Telemetry::from_registers(&block))
}

/// The registers that were asked for; that the function is that of the request the filter has seen to.
fn words(count: usize) -> impl Fn(Response) -> Result<Vec<u16>, String> {
    move |response| match response {
        Response::ReadHoldingRegisters(values)
        | Response::ReadInputRegisters(values)
        | Response::ReadWriteMultipleRegisters(values)
            if values.len() == count =>
        {
            Ok(values)
        }
        other => Err(format!("{other:?}")),
    }
}

fn acknowledged(response: Response) -> Result<(), String> {
    match response {
        Response::WriteSingleRegister(..) | Response::WriteMultipleRegisters(..) => Ok(()),
        other => Err(format!("{other:?}")),
    }
}

fn identification(code: ReadCode, object: u8, what: &str, allowed: Duration) -> Question<'_> {
    let request = Request::ReadDeviceIdentification(code, object);
    Question::plain(request, [43, 14, code.value(), object, 0], what, allowed)
}

/// Number and text of each object of the device identification.
type Names = Vec<(u8, Option<String>)>;

fn objects(response: Response) -> Result<Names, String> {
    let objects = match response {
        Response::ReadDeviceIdentification(names) => names.device_id_objects,
        other => return Err(format!("{other:?}")),
    };
    let texts = objects.iter().map(|object| (object.id, object.value_as_str().map(str::to_owned)));
    Ok(texts.collect())
}

fn object_text(names: &Names, id: u8) -> Option<String> {
    let (_, text) = names.iter().find(|(found, _)| *found == id)?;
    text.clone()
}

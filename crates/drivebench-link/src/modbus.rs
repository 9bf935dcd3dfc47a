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
//! Over the exchanges of exchange.rs. `line_bus.rs` shows the link as cells, for drives with a map of their own; raw.rs as registers of
//! any unit.

mod raw;

use std::borrow::Cow;
use std::time::Duration;

use firmware_protocol::registers::{
    CAPTURE_CONTROL, CAPTURE_STATE, COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS,
    IDENTITY_WORDS, SEQUENCE_ECHO, TELEMETRY_ADDRESS, TELEMETRY_WORDS,
};
use firmware_protocol::{CaptureControl, CaptureState, Telemetry};
use tokio_modbus::client::{Client as _, Context, rtu, tcp};
use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Error, ProtocolError, Request, Response, Slave};

use super::burst::{Burst, Capture, WINDOW_ADDRESS, WINDOW_WORDS, window_samples};
use super::cell_bus::{CellBus, CellTable, Put, ReadRequest, registers};
use super::exceptions::{BusyPauses, Requested, exception_name};
use super::exchange::{Exchange, NoData, Query};
use super::framing::{Echo, FrameKind, Turn, read_bytes, read_write_bytes, write_bytes};
use super::line_bus::{Language, LineBus};
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics, Result, RoundTrips};
use super::link_core::{Answer, own_link, stop_confirmed};
use super::register_map::RegisterMap;
use super::reply_filter::ReplyFilter;
use super::timeline::{identity, identity_error, signed_difference};
use super::timing::{LineTiming, wait_until};
use super::transaction::{LineCounts, StopRequest};
use super::waiting::now;
use drivebench_model::sample::{Command, Sample};

pub use raw::{
    Batch, RawClient, RawCounters, RawSettings, Read, WriteFunction, WriteOutcome, Written,
    read_batch,
};

/// Frames of the device identification, bytes: its request, and the longest reply.
const NAMES_BYTES: (usize, usize) = (7, 256);
const NAMES: &str = "the device identification";
/// RTU frames of a command and of its reply.
pub(super) const COMMAND_BYTES: usize = read_write_bytes(COMMAND_WORDS, TELEMETRY_WORDS).0;
pub(super) const TELEMETRY_BYTES: usize = read_write_bytes(COMMAND_WORDS, TELEMETRY_WORDS).1;

pub struct ModbusLink {
    // Before the exchange, whose runtime it uses.
    client: Client,
    exchange: Exchange,
    /// Reads that were repeated because the unit was busy.
    busy_repeats: u64,
    /// It was busy to the end of the last of them: it gets no more time before it has answered.
    stays_busy: bool,
    /// Commands without a sample since the last one that had one.
    failed_in_a_row: u32,
}

/// The client of tokio-modbus on the line of an exchange.
pub(super) struct Client {
    context: Context,
    unit: u8,
}

/// A request in the form of tokio-modbus and as the proof takes it.
#[derive(Clone)]
struct Question<'a> {
    request: Request<'a>,
    query: Query<'a>,
}

impl<'a> Question<'a> {
    fn plain(request: Request<'a>, pdu: [u8; 5], what: &'a str, allowed: Duration) -> Self {
        let count = match &request {
            Request::ReadHoldingRegisters(_, count)
            | Request::ReadInputRegisters(_, count)
            | Request::ReadWriteMultipleRegisters(_, count, ..) => *count,
            Request::WriteMultipleRegisters(_, values) => quantity(values.len()),
            _ => 1,
        };
        let requested = Requested { function: pdu[0], count, is_of_profile: false };
        let query = Query { pdu, what, allowed, is_probe: false, is_numbered: false, requested };
        Self { request, query }
    }

    fn read(read: ReadRequest, what: &'a str, allowed: Duration) -> Self {
        Self::plain(read_registers(read), read.pdu(), what, allowed)
    }

    /// A probe of the proof. The filter compares all its bytes.
    fn probe(pdu: [u8; 5], timing: &LineTiming) -> Self {
        let [function, data @ ..] = pdu;
        let [a, b, c, d] = data;
        let (address, count) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        let (request, words) = match function {
            3 => (Request::ReadHoldingRegisters(address, count), count),
            4 => (Request::ReadInputRegisters(address, count), count),
            _ => (Request::Custom(8, Cow::Owned(data.to_vec())), 2),
        };
        let (request_bytes, reply_bytes) = read_bytes(words.into());
        let allowed = timing.hurried(request_bytes, reply_bytes);
        let mut question = Self::plain(request, pdu, "the probe", allowed);
        question.query.is_probe = true;
        question
    }

    const fn numbered(mut self) -> Self {
        self.query.is_numbered = true;
        self
    }
}

fn read_registers<'a>(read: ReadRequest) -> Request<'a> {
    match read.table {
        CellTable::Input => Request::ReadInputRegisters(read.address, read.count),
        _ => Request::ReadHoldingRegisters(read.address, read.count),
    }
}

impl Client {
    fn new(filter: &ReplyFilter, kind: FrameKind, unit: u8) -> Self {
        let context = match kind {
            FrameKind::Tcp => tcp::attach_slave(filter.clone(), Slave(unit)),
            _ => rtu::attach_slave(filter.clone(), Slave(unit)),
        };
        Self { context, unit }
    }

    fn attach(&mut self, exchange: &Exchange) {
        *self = Self::new(&exchange.filter, exchange.kind, self.unit);
    }

    /// One request and its reply; who calls has listened.
    fn ask<T>(
        &mut self,
        exchange: &mut Exchange,
        question: Question<'_>,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>> {
        let call = self.context.call(question.request);
        let reply = async { data(call.await) };
        let answer = exchange.call(question.query, reply, check);
        if answer.is_err() && exchange.kind == FrameKind::Rtu {
            // A request that was cut off must not stay in the client's buffer. Over TCP the client keeps the
            // transaction number, and the filter drops replies to older ones.
            self.attach(exchange);
        }
        answer
    }
}

impl Language for Client {
    fn call(
        &mut self,
        exchange: &mut Exchange,
        turn: Turn<'_>,
        query: Query<'_>,
    ) -> Result<Answer<Vec<u16>>> {
        let request = match (turn.put, turn.read) {
            (None, read) => read_registers(read.unwrap_or(ReadRequest::holding(0, 0))),
            (Some(Put { function: 6, address, cells: [value] }), None) => {
                Request::WriteSingleRegister(address, *value)
            }
            (Some(put), None) => {
                Request::WriteMultipleRegisters(put.address, Cow::Borrowed(put.cells))
            }
            (Some(put), Some(read)) => Request::ReadWriteMultipleRegisters(
                read.address,
                read.count,
                put.address,
                Cow::Borrowed(put.cells),
            ),
        };
        let count = turn.read.map(|read| usize::from(read.count));
        self.ask(exchange, Question { request, query }, |response| match count {
            Some(count) => words(count)(response),
            None => acknowledged(response).map(|()| Vec::new()),
        })
    }

    fn probe(&mut self, exchange: &mut Exchange, pdu: [u8; 5]) -> Result<()> {
        let question = Question::probe(pdu, &exchange.core.timing);
        self.ask(exchange, question, |_| Ok(())).map(drop)
    }

    fn object(&mut self, exchange: &mut Exchange, object: u8) -> Result<Option<String>> {
        let allowed = exchange.core.timing.allowed(NAMES_BYTES.0, NAMES_BYTES.1);
        let question = identification(ReadCode::Specific, object, NAMES, allowed);
        exchange.in_step(&question.query.pdu, |exchange, pdu| self.probe(exchange, pdu))?;
        match self.ask(exchange, question, objects) {
            Ok(objects) => Ok(object_text(&objects.value, object)),
            Err(LinkError::Exception { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }
}

/// The response of the client, or why there is none.
fn data(reply: tokio_modbus::Result<Response>) -> Result<Response, NoData> {
    match reply {
        Ok(Ok(response)) => Ok(response),
        Ok(Err(code)) => Err(refused(code.into())),
        // The client takes the refusal of a diagnosis for one of another function; the filter has compared both.
        Err(Error::Protocol(ProtocolError::FunctionCodeMismatch {
            result: Err(refused), ..
        })) => Err(self::refused(refused.exception.into())),
        Err(Error::Protocol(error)) => Err(NoData::Mismatch(error.to_string())),
        Err(Error::Transport(error)) => Err(NoData::Transport(error)),
    }
}

const fn refused(code: u8) -> NoData {
    NoData::Refused { code, name: exception_name(code) }
}

impl ModbusLink {
    /// A link over a port that was opened within the runtime that waits for it.
    pub(super) fn new(exchange: Exchange, unit: u8) -> Self {
        Self {
            client: Client::new(&exchange.filter, exchange.kind, unit),
            exchange,
            busy_repeats: 0,
            stays_busy: false,
            failed_in_a_row: 0,
        }
    }

    /// The link as a bus of cells, for a drive with a map of its own.
    pub fn into_bus(self, map: &RegisterMap, is_emulated: bool) -> impl CellBus + use<> {
        LineBus::new(self.client, self.exchange, map).emulated(is_emulated)
    }

    fn allowed(&self, (request_bytes, reply_bytes): (usize, usize)) -> Duration {
        self.exchange.core.timing.allowed(request_bytes, reply_bytes)
    }

    /// Raw registers, 1 to 125 of them.
    pub fn read_registers(
        &mut self,
        table: CellTable,
        address: u16,
        count: u16,
    ) -> Result<Vec<u16>> {
        let read = ReadRequest { table, address, count };
        Ok(self.read_checked(read, &read.text())?.value)
    }

    fn read_checked(&mut self, read: ReadRequest, what: &str) -> Result<Answer<Vec<u16>>> {
        let allowed = self.allowed(read_bytes(read.count.into()));
        self.read_with_retries(&Question::read(read, what, allowed), words(read.count.into()))
    }

    /// Writes raw registers, 1 to 123 of them; never repeated by itself.
    pub fn write_registers(&mut self, address: u16, values: &[u16]) -> Result<()> {
        let what = format!("write {} at {address}", registers(values.len()));
        let request = Request::WriteMultipleRegisters(address, Cow::Borrowed(values));
        let allowed = self.allowed(write_bytes(16, values.len()));
        let question = Question::plain(request, [16, 0, 0, 0, 0], &what, allowed);
        self.ask(question, acknowledged).map(|answer| answer.value)
    }

    /// One command on the wire. Only a reply that carries its number is its sample.
    fn command(&mut self, command: Command) -> Result<Sample> {
        let travels = self.exchange.core.command(command);
        // Position in the PDU of the reply: after function code, byte count and the registers before it.
        let at = 2 + 2 * usize::from(SEQUENCE_ECHO.address - TELEMETRY_ADDRESS);
        self.exchange.filter.expect(Echo { at, bytes: travels.seq.to_be_bytes() });
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
        let allowed = self.exchange.core.timing.allowed(COMMAND_BYTES, TELEMETRY_BYTES);
        let question = Question::plain(request, [23, a, b, c, d], "the command", allowed);
        let answer = self.call(question.numbered(), telemetry);
        self.failed_in_a_row = match &answer {
            Ok(_) => 0,
            Err(_) => self.failed_in_a_row.saturating_add(1),
        };
        Ok(self.exchange.core.sample(command, &answer?))
    }

    /// Reads the drive's clock: raw, us, and on the time axis of the samples, s.
    fn note_clock(&mut self) -> Result<(u32, f64)> {
        let read = telemetry_request();
        let allowed = self.allowed(read_bytes(read.count.into()));
        let question = Question::read(read, "the telemetry", allowed);
        let answer = self.read_with_retries(&question, telemetry)?;
        let time_us = answer.value.time_us;
        Ok((time_us, self.exchange.core.timeline.note(time_us, answer.span)))
    }

    fn window(&mut self, index: u16) -> Result<Vec<u16>> {
        let sent = [index];
        let bytes = read_write_bytes(1, WINDOW_WORDS);
        let allowed = self.exchange.core.timing.unhurried(bytes.0, bytes.1);
        let request = Request::ReadWriteMultipleRegisters(
            WINDOW_ADDRESS,
            quantity(WINDOW_WORDS),
            WINDOW_ADDRESS,
            Cow::Borrowed(&sent),
        );
        let question = Question::plain(request, [23, 0, 0, 0, 0], "captured samples", allowed);
        self.with_retries(|link| {
            link.exchange.listen()?;
            link.exchange.filter.expect(Echo { at: 2, bytes: index.to_be_bytes() });
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
        self.in_step(&question.query.pdu)?;
        self.call(question, check)
    }

    fn in_step(&mut self, pdu: &[u8]) -> Result<()> {
        let Self { client, exchange, .. } = self;
        exchange.in_step(pdu, |exchange, pdu| client.probe(exchange, pdu))
    }

    fn call<T>(
        &mut self,
        question: Question<'_>,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>> {
        self.client.ask(&mut self.exchange, question, check)
    }

    /// Repeats a read for a while as long as the unit is busy. Not within the bound of an exchange: there the next cycle reads again.
    fn while_busy<T>(&mut self, mut ask: impl FnMut(&mut Self) -> Result<T>) -> Result<T> {
        let mut pauses = BusyPauses::default();
        loop {
            let result = ask(self);
            let may_wait = !self.stays_busy && !self.exchange.core.bound.is_set();
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
                Err(error) if self.exchange.may_retry(&error, attempt) => attempt += 1,
                result => return result,
            }
        }
    }

    /// Sent at once even on a doubtful line: the echo of its sequence number proves that it was applied.
    fn stop_once(&mut self, stop: Command) -> Result<Sample> {
        self.exchange.core.is_unsent = true;
        self.exchange.listen()?;
        self.command(stop)
    }
}

impl DriveLink for ModbusLink {
    own_link!(exchange.core);

    fn identify(&mut self) -> Result<Identity> {
        let read = ReadRequest::holding(IDENTITY_ADDRESS, quantity(IDENTITY_WORDS));
        let block = self.while_busy(|link| link.read_checked(read, &read.text()));
        let block = block.map_err(LinkError::of_profile)?.value;
        let block = block.as_slice().try_into().map_err(|_| {
            self.exchange.mismatch(format!("{} registers of identity", block.len()))
        })?;
        let block = firmware_protocol::Identity::from_registers(block)
            .map_err(|error| identity_error(&self.exchange.core.name, error))?;
        let mut identity = identity(&block);
        // The device identification is optional.
        let allowed = self.exchange.core.timing.allowed(NAMES_BYTES.0, NAMES_BYTES.1);
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
        self.exchange.core.capture_period_s = f64::from(block.capture_period_us) * 1e-6;
        // The origin of the time axis.
        self.while_busy(Self::note_clock)?;
        Ok(identity)
    }

    fn exchange(&mut self, command: Command) -> Result<Sample> {
        self.exchange.core.is_unsent = true;
        self.exchange.listen()?;
        // After two failed commands in a row the line is given time to become silent.
        let waits = self.failed_in_a_row >= 2 && self.exchange.kind == FrameKind::Rtu;
        // A stop goes out at once, also where the line is never silent.
        if waits && command.demand.energises() {
            self.exchange.wait_for_quiet()?;
        }
        self.command(command)
    }

    fn close(&mut self) {
        self.exchange.close();
    }

    fn line(&self) -> Option<LineCounts> {
        Some(self.exchange.line_counts())
    }

    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        Some(&mut self.exchange.core.bound.stop_request)
    }
}

/// Over the registers a burst is armed by one write and read back window by window.
impl Burst for ModbusLink {
    fn arm(&mut self) -> Result<()> {
        self.write_registers(CAPTURE_CONTROL.address, &[CaptureControl::Arm.code()])
    }

    fn fetch(&mut self) -> Result<Option<Capture>> {
        let table = CellTable::Holding;
        // State, count and the drive time of the first sample of a burst.
        let head = self.read_registers(table, CAPTURE_STATE.address, 4)?;
        let [state, count, high, low] = head[..] else {
            return Err(self.exchange.mismatch(format!("{} registers of a capture", head.len())));
        };
        if state != CaptureState::Complete.code() {
            return Ok(None);
        }
        let (time_us, now_s) = self.note_clock()?;
        let age_us = signed_difference(time_us, u32::from(high) << 16 | u32::from(low));
        let first_s = now_s - f64::from(age_us) * 1e-6;
        let period_s = self.exchange.core.capture_period_s;
        let name = self.exchange.core.name.clone();
        let block = |index| Ok(window_samples(index, &self.window(index)?));
        Capture::collect(&name, first_s, period_s, count, block).map(Some)
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

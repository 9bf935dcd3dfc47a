//! Modbus as a language: the turns of a drive as requests of tokio-modbus, over the exchanges of exchange.rs.
//!
//! `own.rs` is the link to our own drive, `line_bus.rs` shows a line as cells, for drives with a map of their own; raw.rs as registers
//! of any unit.

mod raw;

use std::borrow::Cow;
use std::time::Duration;

use tokio_modbus::client::{Client as _, Context, rtu, tcp};
use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Error, ProtocolError, Request, Response, Slave};

use super::cell_bus::{CellTable, Put, ReadRequest};
use super::exceptions::{Requested, exception_name};
use super::exchange::{Exchange, NoData, Query};
use super::framing::{FrameKind, Turn, read_bytes};
use super::line_bus::{Language, LineBus, Names};
use super::link::{LinkError, Result};
use super::link_core::Answer;
use super::own::OwnLink;
use super::register_map::RegisterMap;
use super::reply_filter::ReplyFilter;

pub use raw::{
    Batch, RawClient, RawCounters, RawSettings, Read, WriteFunction, WriteOutcome, Written,
    read_batch,
};

/// Frames of the device identification, bytes: its request, and the longest reply.
const NAMES_BYTES: (usize, usize) = (7, 256);
/// The client of tokio-modbus on the line of an exchange.
pub(super) struct Client {
    context: Context,
    unit: u8,
}

/// A request in the form of tokio-modbus and as the proof takes it.
struct Question<'a> {
    request: Request<'a>,
    query: Query<'a>,
}

impl<'a> Question<'a> {
    fn plain(request: Request<'a>, pdu: [u8; 5], what: &'a str, allowed: Duration) -> Self {
        let requested = Requested { function: pdu[0], count: 1, is_of_profile: false };
        Self { request, query: Query::plain(pdu, what, allowed, requested) }
    }
}

fn read_registers<'a>(read: ReadRequest) -> Request<'a> {
    match read.table {
        CellTable::Input => Request::ReadInputRegisters(read.address, read.count),
        _ => Request::ReadHoldingRegisters(read.address, read.count),
    }
}

impl Client {
    pub(super) fn new(filter: &ReplyFilter, kind: FrameKind, unit: u8) -> Self {
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

    fn identification(
        &mut self,
        exchange: &mut Exchange,
        code: ReadCode,
        object: u8,
    ) -> Result<Names> {
        let allowed = exchange.core.timing.allowed(NAMES_BYTES.0, NAMES_BYTES.1);
        let question = identification(code, object, "the device identification", allowed);
        exchange.in_step(&question.query.pdu, |exchange, pdu| self.probe(exchange, pdu))?;
        Ok(self.ask(exchange, question, objects)?.value)
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
        let [function, data @ ..] = pdu;
        let [a, b, c, d] = data;
        let (address, count) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        let (request, words) = match function {
            3 => (Request::ReadHoldingRegisters(address, count), count),
            4 => (Request::ReadInputRegisters(address, count), count),
            _ => (Request::Custom(8, Cow::Owned(data.to_vec())), 2),
        };
        let (request_bytes, reply_bytes) = read_bytes(words.into());
        let allowed = exchange.core.timing.hurried(request_bytes, reply_bytes);
        let Question { request, query } = Question::plain(request, pdu, "the probe", allowed);
        let requested = Requested { count: words, ..query.requested };
        let query = Query { is_probe: true, requested, ..query };
        // The filter compares all its bytes.
        self.ask(exchange, Question { request, query }, |_| Ok(())).map(drop)
    }

    fn object(&mut self, exchange: &mut Exchange, object: u8) -> Result<Option<String>> {
        match self.identification(exchange, ReadCode::Specific, object) {
            Ok(mut texts) => Ok(texts.remove(&object)),
            Err(LinkError::Exception { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn names(&mut self, exchange: &mut Exchange) -> Result<Names> {
        self.identification(exchange, ReadCode::Regular, 0)
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

impl OwnLink<Client> {
    /// The link as a bus of cells, for a drive with a map of its own.
    pub(super) fn into_bus(self, map: &RegisterMap, is_emulated: bool) -> LineBus<Client> {
        LineBus::new(self.language, self.exchange, map).emulated(is_emulated)
    }

    /// One request on a synchronised line.
    fn ask<T>(
        &mut self,
        question: Question<'_>,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>> {
        self.in_step(&question.query.pdu)?;
        self.language.ask(&mut self.exchange, question, check)
    }
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

fn objects(response: Response) -> Result<Names, String> {
    let objects = match response {
        Response::ReadDeviceIdentification(names) => names.device_id_objects,
        other => return Err(format!("{other:?}")),
    };
    Ok(objects.iter().filter_map(|o| Some((o.id, o.value_as_str()?.to_owned()))).collect())
}

//! Framings: which bytes on the line answer the one outstanding request, and which do not. One file each; this one dispatches.

mod dynamixel;
mod lines;
mod modbus;
mod stream;
mod vesc;

use std::collections::VecDeque;

use firmware_protocol::modbus::expected_response_len;
use firmware_protocol::{CaptureSample, Telemetry};

use super::burst::window_samples;
use super::cell_bus::{Put, ReadRequest};
use super::exceptions::Requested;
use super::exchange::NoData;
use super::settings::Protocol;
use super::unexpected::Unexpected;

pub(super) use self::lines::{Awaited, LINE_CELLS};
pub use self::lines::{Grammar, Line};
pub(super) use self::vesc::width as fields_width;
pub(super) use modbus::{
    begins_with_rtu, read_bytes, read_write_bytes, rtu_frame_len, write_bytes,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FrameKind {
    Rtu,
    Tcp,
    Stream,
    Vesc,
    Dynamixel,
    Lines,
}

impl FrameKind {
    /// On a serial line, or where a network carries one.
    pub(super) const fn serial(protocol: Protocol) -> Self {
        match protocol {
            Protocol::Stream => Self::Stream,
            Protocol::Vesc => Self::Vesc,
            Protocol::Dynamixel => Self::Dynamixel,
            Protocol::Lines => Self::Lines,
            _ => Self::Rtu,
        }
    }

    /// Whether every reply carries the number of its request.
    pub(super) const fn is_numbered(self) -> bool {
        matches!(self, Self::Tcp | Self::Stream | Self::Vesc)
    }

    /// Whether a write is a frame of its own in front of a read that goes out with it.
    pub(super) const fn writes_apart(self) -> bool {
        matches!(self, Self::Vesc | Self::Lines)
    }

    /// Frames whose ends only silence separates.
    pub(super) const fn needs_gaps(self) -> bool {
        matches!(self, Self::Rtu)
    }

    /// Different lengths of a read, where nothing but the length of a reply identifies its request; 1: not needed.
    pub(super) const fn lengths(self) -> u16 {
        match self {
            Self::Dynamixel => 32,
            _ => 1,
        }
    }

    /// The number of a turn after that of the one before it.
    pub(super) fn number(self, turn: Turn<'_>, last: u32) -> u32 {
        match self {
            Self::Stream => stream::number(turn, last),
            _ => last.wrapping_add(1),
        }
    }

    /// The bytes of a turn, for the languages that are ours; `number` is another one for each.
    pub(super) fn request(self, unit: u8, turn: Turn<'_>, number: u32) -> Vec<u8> {
        match self {
            Self::Stream => stream::request(turn, number),
            Self::Vesc => vesc::request(turn, number),
            Self::Dynamixel => dynamixel::request(unit, turn),
            // The client of tokio-modbus makes these, and the grammar of a profile those.
            Self::Rtu | Self::Tcp | Self::Lines => Vec::new(),
        }
    }

    #[cfg(test)]
    pub(super) fn packet(self, id: u8, body: &[u8]) -> Vec<u8> {
        match self {
            Self::Vesc => vesc::packet(body),
            _ => dynamixel::packet(id, body),
        }
    }

    pub(super) fn cells(self, reply: &[u8], turn: Turn<'_>) -> Result<Vec<u16>, NoData> {
        match self {
            Self::Stream => stream::cells(reply),
            Self::Vesc => vesc::cells(reply, turn),
            Self::Dynamixel => dynamixel::cells(reply, turn),
            Self::Rtu | Self::Tcp | Self::Lines => Ok(Vec::new()),
        }
    }

    /// The telemetry block of our own map from its cells.
    pub(super) fn telemetry(self, cells: &[u16]) -> Option<Telemetry> {
        match self {
            Self::Stream => stream::telemetry(cells),
            _ => cells.try_into().ok().map(Telemetry::from_registers),
        }
    }

    /// The captured samples of our own map from an index on, from the cells of their window.
    pub(super) fn samples(self, index: u16, cells: &[u16]) -> Vec<CaptureSample> {
        match self {
            Self::Stream => stream::samples(cells),
            _ => window_samples(index, cells),
        }
    }

    pub(super) fn bytes(self, turn: Turn<'_>) -> (usize, usize) {
        match self {
            Self::Rtu | Self::Tcp => modbus::bytes(turn),
            Self::Stream => stream::bytes(turn),
            Self::Vesc => vesc::bytes(turn),
            Self::Dynamixel => dynamixel::bytes(turn),
            Self::Lines => (0, 0),
        }
    }
}

/// Function code that stands for a write of other languages in the proof of synchronisation: Modbus code 2 is not used here.
pub(super) const PROOF_WRITE: u8 = 2;

/// What one request does: a write, a read, or both at once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn<'a> {
    pub(super) put: Option<Put<'a>>,
    pub(super) read: Option<ReadRequest>,
    /// Cells in front of those that are wanted.
    pub(super) skipped: u16,
}

impl<'a> Turn<'a> {
    pub(super) const fn read(read: ReadRequest) -> Self {
        Self { put: None, read: Some(read), skipped: 0 }
    }

    pub(super) const fn write(put: Put<'a>) -> Self {
        Self { put: Some(put), read: None, skipped: 0 }
    }

    /// The same read with `number` cells more in front of it, as far as there are any: a reply of this length answers it and none of
    /// the requests before it.
    pub(super) fn lengthened(self, number: u16) -> Self {
        let Some(read) = self.read else { return self };
        let skipped = number.min(read.address);
        let (address, count) = (read.address - skipped, read.count + skipped);
        Self { read: Some(ReadRequest { address, count, ..read }), skipped, ..self }
    }

    /// Cells that are read, those in front included.
    pub(super) fn length(&self) -> u16 {
        self.read.map_or(0, |read| read.count)
    }

    /// As a request of Modbus, which is what the proof of synchronisation takes.
    pub(super) fn pdu(&self) -> [u8; 5] {
        match (self.put, self.read.map(ReadRequest::pdu)) {
            (None, read) => read.unwrap_or_default(),
            (Some(_), Some([_, a, b, c, d])) => [23, a, b, c, d],
            (Some(Put { function, address, .. }), None) => {
                let [high, low] = address.to_be_bytes();
                [function, high, low, 0, 0]
            }
        }
    }

    /// For the help of an exception.
    pub(super) fn requested(&self) -> Requested {
        let written = self.put.map_or(0, |put| u16::try_from(put.cells.len()).unwrap_or(u16::MAX));
        let count = self.read.map_or(written, |read| read.count);
        Requested { function: self.pdu()[0], count, is_of_profile: false }
    }

    pub(super) fn text(&self) -> String {
        let written = self.put.map(|put| format!("write {:04x?} at {}", put.cells, put.address));
        let parts: Vec<String> =
            written.into_iter().chain(self.read.map(ReadRequest::text)).collect();
        parts.join(" and ")
    }
}

/// What the reply has to fit.
#[derive(Clone, Debug, Default)]
pub(super) struct Expected {
    /// The outstanding request as it went out; empty: nothing is outstanding.
    pub(super) request: Vec<u8>,
    /// Bytes that the reply must echo as well: the number of its own command.
    pub(super) echo: Option<Echo>,
    /// The lines of text that it consists of.
    pub(super) lines: Awaited,
    /// Requests before it, and whether they were answered: what answers one of these is an old reply and not a stranger's.
    pub(super) earlier: VecDeque<(Vec<u8>, bool)>,
    /// This line is known to return requests.
    pub(super) echoes: bool,
    /// This line is known not to return them: a reply that is no copy of its request came without an echo.
    pub(super) is_echo_free: bool,
}

/// Two bytes that prove which request a reply belongs to, and where they stand in its PDU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Echo {
    pub(super) at: usize,
    pub(super) bytes: [u8; 2],
}

/// Requests that are remembered for naming late replies.
const EARLIER: usize = 32;

impl Expected {
    /// The outstanding request is over.
    pub(super) fn retire(&mut self, is_answered: bool) {
        self.echo = None;
        self.lines = Awaited::default();
        if self.request.is_empty() {
            return;
        }
        if self.earlier.len() == EARLIER {
            self.earlier.pop_front();
        }
        self.earlier.push_back((std::mem::take(&mut self.request), is_answered));
    }
}

/// Properties of a reply that identify its request, if it carries no number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Code {
    /// With the mark of a refusal, if it is one.
    pub(super) function: u8,
    pub(super) length: usize,
}

impl Code {
    /// Of a whole response frame.
    pub(super) fn of(kind: FrameKind, frame: &[u8]) -> Option<Self> {
        match kind {
            FrameKind::Rtu | FrameKind::Tcp => modbus::code_of(kind, frame),
            FrameKind::Stream => stream::code_of(frame),
            FrameKind::Vesc => vesc::code_of(frame),
            FrameKind::Dynamixel => dynamixel::code_of(frame),
            FrameKind::Lines => None,
        }
    }

    /// Of the data that this request asks for.
    pub(super) fn answering(request: &[u8]) -> Self {
        Self {
            function: request.first().copied().unwrap_or_default(),
            length: expected_response_len(request).unwrap_or_default(),
        }
    }
}

/// Contents of the bytes received so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Search {
    /// Begin and end of the reply.
    pub(super) reply: Option<(usize, usize)>,
    /// Whole frames that answer an earlier request, or this one with another number.
    pub(super) old: Vec<Code>,
    /// Complete frames that answer no request of ours; on a serial line also requests of other masters.
    pub(super) foreign: usize,
    /// Those of them that write to our unit: another master commands it.
    pub(super) foreign_writes: usize,
    /// The line returned the request itself before the reply.
    pub(super) echo: bool,
    /// How the frames differ from the reply; the most particular of them.
    pub(super) unexpected: Option<Unexpected>,
}

impl Search {
    fn differs(&mut self, how: Unexpected) {
        if self.unexpected.is_none_or(|known| known == Unexpected::Frame) {
            self.unexpected = Some(how);
        }
    }

    fn foreign(&mut self, how: Unexpected) {
        self.foreign += 1;
        self.differs(how);
    }
}

/// The peer does not use Modbus TCP: frames can no longer be separated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unframeable;

/// CRC of 16 bits, highest bit first, initial value 0, without a final inversion.
fn crc16(polynomial: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, byte| {
        let next = crc ^ (u16::from(*byte) << 8);
        (0..8).fold(next, |crc, _| (crc << 1) ^ if crc & 0x8000 == 0 { 0 } else { polynomial })
    })
}

/// Looks through everything received since the request went out.
pub(super) fn search(
    kind: FrameKind,
    expected: &Expected,
    received: &[u8],
) -> Result<Search, Unframeable> {
    match kind {
        FrameKind::Rtu => Ok(modbus::search_rtu(expected, received)),
        FrameKind::Tcp => modbus::search_tcp(expected, received),
        FrameKind::Stream => Ok(stream::search(expected, received)),
        FrameKind::Vesc => Ok(vesc::search(expected, received)),
        FrameKind::Dynamixel => Ok(dynamixel::search(expected, received)),
        FrameKind::Lines => Ok(lines::search(expected, received)),
    }
}

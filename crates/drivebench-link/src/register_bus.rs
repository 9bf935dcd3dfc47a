//! Register bus: reads and writes of registers, the interface that a profiled drive needs of its link.

use super::link::{LinkName, LinkStatistics, Result, RoundTrips};
use super::transaction::{LineCounts, StopRequest};

/// Most registers of one request (MODBUS Application Protocol V1.1b3, 6.3 and 6.12).
pub const MOST_READ: u16 = 125;
pub const MOST_WRITTEN: usize = 123;

/// Lengths of RTU frames without the registers that they carry, bytes.
pub(super) struct FrameBytes {
    pub(super) read: usize,
    pub(super) read_reply: usize,
    /// Write of several registers.
    pub(super) write: usize,
    /// Acknowledgement of a write; also the write of one register.
    pub(super) written: usize,
    /// Function code 23.
    pub(super) read_write: usize,
}

pub(super) const RTU: FrameBytes =
    FrameBytes { read: 8, read_reply: 5, write: 9, written: 8, read_write: 13 };

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegisterTable {
    Holding,
    Input,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadRequest {
    pub table: RegisterTable,
    /// Protocol address, from 0.
    pub address: u16,
    /// 1 to [`MOST_READ`].
    pub count: u16,
}

impl ReadRequest {
    pub const fn holding(address: u16, count: u16) -> Self {
        Self { table: RegisterTable::Holding, address, count }
    }

    /// The address behind its last register.
    pub(super) const fn end(self) -> u32 {
        self.address as u32 + self.count as u32
    }

    pub(super) const fn reply_bytes(self) -> usize {
        RTU.read_reply + 2 * self.count as usize
    }

    pub(super) const fn pdu(self) -> [u8; 5] {
        let [a, b] = self.address.to_be_bytes();
        let [c, d] = self.count.to_be_bytes();
        let function = match self.table {
            RegisterTable::Holding => 3,
            RegisterTable::Input => 4,
        };
        [function, a, b, c, d]
    }

    /// `read 2 registers at 7`.
    pub(super) fn text(self) -> String {
        format!("read {} at {}", registers(self.count.into()), self.address)
    }
}

pub fn registers(count: usize) -> String {
    format!("{count} register{}", if count == 1 { "" } else { "s" })
}

/// The host times between which something was done at the far end, s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Span {
    /// First byte of the accepted request out.
    pub asked_s: f64,
    /// First byte of its reply in.
    pub answered_s: f64,
}

impl Span {
    pub const fn new(asked_s: f64, answered_s: f64) -> Self {
        Self { asked_s, answered_s }
    }

    pub const fn middle_s(self) -> f64 {
        f64::midpoint(self.asked_s, self.answered_s)
    }

    pub const fn half_width_s(self) -> f64 {
        0.5 * (self.answered_s - self.asked_s)
    }
}

/// Registers as they were read, and when the drive took their values.
#[derive(Clone, Debug, PartialEq)]
pub struct RegistersRead {
    pub words: Vec<u16>,
    pub span: Span,
}

/// Reads and writes registers, each call bounded by the bus's own deadline for it, and keeps the host's time.
pub trait RegisterBus: Send {
    fn name(&self) -> LinkName;

    /// Host time, s since an origin of the bus's own.
    fn now_s(&self) -> f64;

    /// Lets host time pass; a time that has passed changes nothing.
    fn pause_until_s(&mut self, time_s: f64);

    /// Reads registers. A read has no side effects, so it may be repeated within its deadline.
    fn read(&mut self, read: ReadRequest) -> Result<RegistersRead>;

    /// Writes with function code 6 (one register) or 16; never repeated by itself. When it was carried out.
    fn write(&mut self, function: u8, address: u16, values: &[u16]) -> Result<Span>;

    /// As `write`, on a line in doubt too: what brings a drive to rest does not wait for silence or a probe. The doubt stays.
    ///
    /// On such a line it waits for one turnaround and no longer, so that the next write can follow where no reply came.
    fn write_at_once(&mut self, function: u8, address: u16, values: &[u16]) -> Result<Span> {
        self.write(function, address, values)
    }

    /// Writes holding registers and then reads others, in one transaction (function code 23) where the bus has one; never
    /// repeated by itself. The times are those between which both were done.
    fn read_write(
        &mut self,
        (to, values): (u16, &[u16]),
        (from, count): (u16, u16),
    ) -> Result<RegistersRead> {
        let written = self.write(16, to, values)?;
        let mut read = self.read(ReadRequest::holding(from, count))?;
        read.span.asked_s = written.asked_s;
        Ok(read)
    }

    /// An object of function code 43; `None` where the drive does not have it.
    fn object(&mut self, object: u8) -> Result<Option<String>>;

    /// Whether the far end is known to be software.
    fn is_emulated(&self) -> bool {
        false
    }

    /// As [`DriveLink::bound`](super::DriveLink::bound); [`RegisterBus::write_at_once`] is not bound.
    fn bound(&mut self, _left_s: f64) {}

    /// As [`DriveLink::stop_request`](super::DriveLink::stop_request).
    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        None
    }

    /// Lets go of what carries the registers.
    fn close(&mut self) {}

    fn statistics(&self) -> LinkStatistics;

    fn round_trips(&self) -> Option<&RoundTrips> {
        None
    }

    /// What the line carried; `None` without one.
    fn line(&self) -> Option<LineCounts> {
        None
    }

    /// Wire time of one request and its reply of so many bytes, s; `None` without a line.
    fn wire_s(&self, request_bytes: usize, reply_bytes: usize) -> Option<f64>;
}

//! Bus of cells: the interface that a profiled drive needs of its link. A cell is a register, or one byte where a drive is addressed
//! by bytes.

use super::framing::{LINE_CELLS, fields_width};
use super::link::{LinkName, LinkStatistics, Result, RoundTrips};
use super::register_map::Location;
use super::transaction::{LineCounts, StopRequest};

/// Most registers of one request (MODBUS Application Protocol V1.1b3, 6.3 and 6.12).
pub const MOST_READ: u16 = 125;
pub const MOST_WRITTEN: usize = 123;

/// Where cells lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CellTable {
    Holding,
    Input,
    /// A control table of bytes.
    Bytes,
    /// Bytes of the values that the bits of this mask select.
    Fields(u32),
    /// Bytes of the reply to this command.
    Reply(u8),
    /// Numbers in the answers to these lines of the profile, two cells each: a bit for each line.
    Lines(u64),
    /// Nowhere: the value is computed from others.
    Computed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadRequest {
    pub table: CellTable,
    /// Protocol address, from 0.
    pub address: u16,
    /// Registers: 1 to [`MOST_READ`].
    pub count: u16,
}

impl ReadRequest {
    pub const fn holding(address: u16, count: u16) -> Self {
        Self { table: CellTable::Holding, address, count }
    }

    pub(super) const fn end(self) -> u32 {
        self.address as u32 + self.count as u32
    }

    /// Where the cells of a location lie among those that were read.
    pub(super) fn offset_of(self, location: &Location) -> usize {
        match (self.table, location.table) {
            // Those of the bits below it come first.
            (CellTable::Fields(mask), CellTable::Fields(bit)) => {
                fields_width(mask & (bit.wrapping_sub(1))).into()
            }
            (CellTable::Lines(mask), CellTable::Lines(line)) => {
                let before = (mask & line.wrapping_sub(1)).count_ones() as usize;
                before * usize::from(LINE_CELLS) + usize::from(location.address - self.address)
            }
            _ => location.address.saturating_sub(self.address).into(),
        }
    }

    /// As a request of Modbus; those for other cells look like one to the proof of synchronisation.
    pub(super) const fn pdu(self) -> [u8; 5] {
        let [a, b] = self.address.to_be_bytes();
        let [c, d] = self.count.to_be_bytes();
        let function = match self.table {
            CellTable::Input => 4,
            _ => 3,
        };
        [function, a, b, c, d]
    }

    /// `read 2 registers at 7`.
    pub(super) fn text(self) -> String {
        let Self { table, address, count } = self;
        match table {
            CellTable::Holding | CellTable::Input => {
                format!("read {} at {address}", registers(count.into()))
            }
            CellTable::Bytes => format!("read {count} bytes at {address}"),
            CellTable::Fields(mask) => format!("read the values of mask {mask:#010x}"),
            CellTable::Reply(command) => format!("command {command}"),
            CellTable::Lines(mask) => format!("read {} lines of the profile", mask.count_ones()),
            CellTable::Computed => "nothing".to_owned(),
        }
    }
}

pub fn registers(count: usize) -> String {
    format!("{count} register{}", if count == 1 { "" } else { "s" })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Put<'a> {
    /// Modbus: function code 6 (one register) or 16. VESC: the command.
    pub function: u8,
    pub address: u16,
    pub cells: &'a [u16],
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

/// Cells as they were read, and when the drive took their values.
#[derive(Clone, Debug, PartialEq)]
pub struct CellsRead {
    pub cells: Vec<u16>,
    pub span: Span,
    /// When a write that went out with the read was carried out.
    pub written: Span,
}

/// Reads and writes cells, each call bounded by the bus's own deadline for it, and keeps the host's time.
pub trait CellBus: Send {
    fn name(&self) -> LinkName;

    /// Host time, s since an origin of the bus's own.
    fn now_s(&self) -> f64;

    /// Lets host time pass; a time that has passed changes nothing.
    fn pause_until_s(&mut self, time_s: f64);

    /// Reads cells. A read has no side effects, so it may be repeated within its deadline.
    fn read(&mut self, read: ReadRequest) -> Result<CellsRead>;

    /// Writes cells; never repeated by itself. When it was carried out.
    fn write(&mut self, put: Put<'_>) -> Result<Span>;

    /// As `write`, on a line in doubt too: what brings a drive to rest does not wait for silence or a probe. The doubt stays.
    ///
    /// On such a line it waits for one turnaround and no longer, so that the next write can follow where no reply came.
    fn write_at_once(&mut self, put: Put<'_>) -> Result<Span> {
        self.write(put)
    }

    /// Writes cells and then reads others, in one transaction where the bus has one; never repeated by itself. The times are those
    /// between which both were done.
    fn read_write(&mut self, put: Put<'_>, read: ReadRequest) -> Result<CellsRead> {
        let written = self.write(put)?;
        let mut read = self.read(read)?;
        read.span.asked_s = written.asked_s;
        Ok(read)
    }

    /// An object of function code 43; `None` where the drive does not have it.
    fn object(&mut self, object: u8) -> Result<Option<String>>;

    fn is_emulated(&self) -> bool {
        false
    }

    /// As [`DriveLink::bound`](super::DriveLink::bound); [`CellBus::write_at_once`] is not bound.
    fn bound(&mut self, _left_s: f64) {}

    /// As [`DriveLink::stop_request`](super::DriveLink::stop_request).
    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        None
    }

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

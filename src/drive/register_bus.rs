//! Registers at the far end of something: all that a profiled drive needs of a link.

use super::RegisterTable;
use super::link::{LinkError, LinkName, LinkStatistics};
use super::tally::RoundTrips;
use super::transaction::{CutIn, LineCounts};

/// Registers as they were read, and the host times between which the drive took their values.
#[derive(Clone, Debug, PartialEq)]
pub struct RegistersRead {
    pub words: Vec<u16>,
    /// First byte of the accepted request out, s.
    pub asked_s: f64,
    /// First byte of its reply in, s.
    pub answered_s: f64,
}

/// The host times between which the far end carried out a write that it acknowledged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// First byte of the request out, s.
    pub asked_s: f64,
    /// First byte of its acknowledgement in, s.
    pub answered_s: f64,
}

/// Reads and writes registers, each call bounded by the bus's own deadline for it, and keeps the host's time.
pub trait RegisterBus: Send {
    fn name(&self) -> LinkName;

    /// Host time, s since an origin of the bus's own.
    fn now_s(&self) -> f64;

    /// Lets host time pass; a time that has passed changes nothing.
    fn pause_until_s(&mut self, time_s: f64);

    /// Reads `count` registers; a question without effect, so it may be asked again within its deadline.
    fn read(
        &mut self,
        table: RegisterTable,
        address: u16,
        count: u16,
    ) -> Result<RegistersRead, LinkError>;

    /// Writes with function code 6 (one register) or 16; never repeated by itself.
    fn write(&mut self, function: u8, address: u16, values: &[u16]) -> Result<Carried, LinkError>;

    /// As `write`, on a line in doubt too: what brings a drive to rest does not wait for silence or a probe. The doubt stays.
    ///
    /// On such a line it waits for one turnaround and no longer, so that the next write can follow where no reply came.
    fn write_at_once(
        &mut self,
        function: u8,
        address: u16,
        values: &[u16],
    ) -> Result<Carried, LinkError> {
        self.write(function, address, values)
    }

    /// Writes holding registers and then reads others, in one transaction (function code 23) where the bus has one; never
    /// repeated by itself. The times are those between which both were done.
    fn read_write(
        &mut self,
        (to, values): (u16, &[u16]),
        (from, count): (u16, u16),
    ) -> Result<RegistersRead, LinkError> {
        let written = self.write(16, to, values)?;
        let read = self.read(RegisterTable::Holding, from, count)?;
        Ok(RegistersRead {
            asked_s: written.asked_s,
            ..read
        })
    }

    /// An object of function code 43; `None` where the drive does not have it.
    fn object(&mut self, object: u8) -> Result<Option<String>, LinkError>;

    /// Whether the far end is known to be software.
    fn is_emulated(&self) -> bool {
        false
    }

    /// As [`DriveLink::bound`](super::DriveLink::bound); [`RegisterBus::write_at_once`] is not bound.
    fn bound(&mut self, _left_s: f64) {}

    /// As [`DriveLink::cut_in`](super::DriveLink::cut_in).
    fn cut_in(&mut self) -> Option<&mut CutIn> {
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

//! Communication with drives: a profile, and a link that exchanges a command for a sample.
//!
//! ```text
//! settings.rs <- register_map/ (facts of a profile) <- profile.rs (TOML) + PATH | tcp:HOST:PORT --open.rs--> Box<dyn DriveLink>
//!
//! Command -> [ DriveLink: own.rs | profiled.rs | in memory ] -> Sample
//!                  |                          burst.rs: samples recorded in the drive
//!              line_bus.rs, modbus.rs     turns in the language of the drive
//!                  |
//!          reply_filter.rs                bytes, silence, hang-up
//!                  |
//!              exchange.rs (gap, proof, deadline), transaction.rs + framing/ (which bytes answer this request), proof.rs (whether the line is in step)
//!                  +-- unexpected.rs (what came instead, and the way on)
//!                  +-- link_core.rs (statistics, time axis, stop), timing.rs (deadlines, gaps), waiting.rs (real or virtual)
//!                  +-- virtual_line.rs (a line in memory: the same bytes without the waiting)
//!                  +-- tap.rs (capture file), serial_ports.rs (what is plugged in)
//!                  +-- modbus/raw.rs (registers of any unit) <- probe/ (read-only: identity, and check of the profile)
//!                  +-- timeline.rs (drive time in seconds since connect)
//!                  +-- command_times.rs (longest times of enable, stop and reset)
//!                  +-- exceptions.rs (exceptions of Modbus: sender, and the way on)
//!                  +-- reopen.rs (reconnection: times, port name, check of the identity)
//! ```
//!
//! A drive with a register map of its own: `register_map/` (facts) -> `profiled.rs` -> [`CellBus`].
//! A reply that cannot be proved to answer the one outstanding request is never a sample.

#[cfg(test)]
mod bounded_tests;
mod budget;
pub mod burst;
mod cell_bus;
mod command_times;
mod exceptions;
mod exchange;
mod framing;
#[cfg(test)]
mod language_trials;
mod line_bus;
mod link;
mod link_core;
mod link_error;
mod modbus;
pub mod offer;
mod open;
mod own;
mod polling_backoff;
mod port;
mod probe;
mod profile;
mod profiled;
mod proof;
pub mod register_map;
mod reopen;
mod reply_filter;
#[cfg(test)]
mod scripted;
pub mod serial_ports;
mod settings;
mod tap;
pub mod timeline;
mod timing;
mod transaction;
mod unexpected;
pub mod virtual_line;
mod waiting;

pub use budget::{AdapterRate, LineBudget, LoopRates, LostReply, MeasuredLine};
pub use burst::{Burst, Capture};
pub use cell_bus::{
    CellBus, CellTable, CellsRead, MOST_READ, MOST_WRITTEN, Put, ReadRequest, Span, registers,
};
pub use command_times::CommandTimes;
pub use exceptions::{Requested, exception_name};
pub use link::{
    DriveLink, Identity, LinkError, LinkName, LinkStatistics, RoundTrips, StatedMotor, drive_name,
};
pub use link_core::stop_confirmed;
pub use link_error::Result;
pub use modbus::{
    Batch, RawClient, RawCounters, RawSettings, Read, WriteFunction, WriteOutcome, Written,
    read_batch,
};
pub use open::{OwnStream, Target, TargetError, open, open_cells, open_stream, open_tapped};
pub use probe::{
    ProbeDepth, ProbeFinding, ProbeReport, ProbeVerdict, ProbedCheck, ProbedSignal, ProbedState,
    probe, probe_cells, probe_stream,
};
pub use profile::{Capabilities, DriveProfile, ProfileError, SignalOrigins, SignalSides, Watchdog};
pub use profiled::ProfiledLink;
pub use reopen::{Anchor, Backoff, Reopening, another_drive};
pub use settings::{DriveLimits, Framing, KickedBy, LinkSettings, Protocol, RangeError, Trust};
pub use tap::TapFile;
pub use timeline::signed_difference;
pub use timing::standard_gap_s;
pub use transaction::{LineCounts, StopRequest};
pub use unexpected::Unexpected;
pub use virtual_line::VirtualClock;

//! What a drive is to the bench: a profile, and a link that exchanges a command for a sample.
//!
//! ```text
//! profile.rs (TOML) + PATH | tcp:HOST:PORT --open.rs--> Box<dyn DriveLink>
//!
//! Command -> [ DriveLink: modbus.rs | stream.rs | in memory ] -> Sample
//!                  |            |
//!              guard.rs      port.rs        bytes, silence, hang-up
//!              reply.rs                     which bytes answer this request
//!                  +-- timing.rs (deadlines, gaps), tally.rs (counts, round trips)
//!                  +-- timeline.rs, clock_map.rs (drive time in seconds since connect)
//! ```
//!
//! A drive with a register map of its own: `register_map/` (facts) -> `profiled.rs` -> [`RegisterBus`].
//! A reply that cannot be proved to answer the one outstanding request is never a sample.

mod clock_map;
#[cfg(test)]
mod fake;
mod guard;
mod link;
mod modbus;
pub mod offer;
mod open;
mod port;
mod profile;
mod profiled;
mod register_bus;
pub mod register_map;
mod reply;
mod stream;
mod tally;
pub mod timeline;
mod timing;

pub use clock_map::{ClockMap, DriveClock};
pub use guard::LineCounts;
pub use link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
pub use modbus::{ModbusBus, ModbusLink, RegisterTable};
pub use open::{Target, TargetError, open, open_modbus, open_stream};
pub use profile::{
    Capabilities, DriveLimits, DriveProfile, Framing, KickedBy, LinkSettings, ProfileError,
    Protocol, SignalOrigins, Trust, Watchdog,
};
pub use profiled::ProfiledLink;
pub use register_bus::RegisterBus;
pub use stream::{Capture, CapturedSample, StreamLink};
pub use tally::RoundTrips;

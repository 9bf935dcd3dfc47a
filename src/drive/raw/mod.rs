//! Raw registers of any Modbus unit: the everyday tool beside the drive links, in as few system calls as can be.
//!
//! ```text
//! batch.rs  reads, again and again -> values that are vouched for
//!    |
//! client.rs  drain -> steps of transaction/proof.rs -> gap -> write -> ppoll, read until the one reply is there
//!    |
//! wire.rs   serial port or TCP, non-blocking
//! who.rs    what a unit says about itself
//! ```

mod batch;
mod client;
#[cfg(test)]
mod tests;
mod who;
mod wire;

use std::time::Duration;

pub use batch::{Batch, Read, read_batch};
pub use client::{RawClient, RawCounters, WriteFunction};

use super::link::{Identity, LinkError};
use super::open::Target;
use super::register_bus::{MOST_READ, ReadRequest};
use super::reply::FrameKind;
use super::settings::Framing;
use super::tap::TapFile;
use super::timeline::identity;
use super::timing::standard_gap_s;
use firmware_protocol::registers::{IDENTITY_ADDRESS, IDENTITY_WORDS};
use wire::Wire;

/// How a unit is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawSettings {
    /// Baud rate of a serial port for which the target names none.
    pub baud: u32,
    pub framing: Framing,
    /// Unit for which the target names none.
    pub unit: u8,
    /// Time for one exchange, from the request to the whole reply.
    pub timeout: Duration,
    /// Silence before a request; `None`: as the standard says for the baud rate.
    pub gap: Option<Duration>,
}

impl RawClient {
    /// Opens the port or connects; nothing is sent yet.
    ///
    /// # Errors
    /// [`LinkError::Open`], with what to do about it.
    pub fn open(
        target: &Target,
        settings: &RawSettings,
        tap: Option<&TapFile>,
    ) -> Result<Self, LinkError> {
        let name = target.to_string();
        // The kernel may put off the end of a sleep by 50 us to save wake-ups; where it refuses, gaps are a little longer.
        #[cfg(target_os = "linux")]
        let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
        let mut line = String::new();
        let (wire, kind, unit, gap) = match target {
            Target::Serial { path, baud, unit } => {
                let baud = baud.unwrap_or(settings.baud);
                let wire = Wire::serial(path, baud, settings.framing)?;
                line = format!(" at {baud} {}", settings.framing.name());
                let standard = standard_gap_s(baud, settings.framing);
                let gap = settings
                    .gap
                    .unwrap_or_else(|| Duration::try_from_secs_f64(standard).unwrap_or_default());
                (wire, FrameKind::Rtu, unit, gap)
            }
            Target::Tcp { host, port, unit } => {
                let wire = Wire::tcp(&name, host, *port)?;
                // A network has no silences; one that is asked for is kept.
                (wire, FrameKind::Tcp, unit, settings.gap.unwrap_or_default())
            }
        };
        let tap = tap.map(|file| match wire.ends {
            Some((ours, peer)) => file.tcp(ours, peer),
            None => file.rtu(),
        });
        let unit = unit.unwrap_or(settings.unit);
        let mut client = Self::new(name, wire, kind, unit, settings.timeout, gap, tap);
        client.line = line;
        Ok(client)
    }

    /// Who the unit is, where it has our register map; `None`: it is something else, which must count as hardware.
    pub fn identify(&mut self) -> Result<Option<Identity>, LinkError> {
        let words = u16::try_from(IDENTITY_WORDS).unwrap_or(MOST_READ);
        let block = match self.read(ReadRequest::holding(IDENTITY_ADDRESS, words)) {
            Ok(block) => block,
            Err(LinkError::Exception { .. }) => return Ok(None),
            Err(error) => return Err(error),
        };
        if !self.vouch()? {
            return Ok(None);
        }
        let block = block.as_slice().try_into().ok();
        let block = block.and_then(|b| firmware_protocol::Identity::from_registers(b).ok());
        Ok(block.map(|block| identity(&block)))
    }
}

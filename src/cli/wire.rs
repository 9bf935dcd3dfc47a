//! What `registers` and `doctor` have in common: which line, how it is asked, and the capture of what it carries.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::failure::{Failure, USAGE};
pub(super) use crate::app::Tap;
use crate::drive::{Framing, RawClient, RawSettings, Target, TargetError};

/// Options of the commands that talk to any Modbus unit.
#[derive(Args, Clone, Debug)]
pub(super) struct WireArguments {
    /// Serial port (Modbus RTU), or tcp:HOST:PORT
    #[arg(long, value_name = "PORT", conflicts_with = "host")]
    port: Option<String>,
    /// Address of a Modbus TCP server
    #[arg(long, value_name = "HOST:PORT")]
    host: Option<String>,
    /// Baud rate of a serial port
    #[arg(long, value_name = "BAUD", default_value_t = 115_200, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) baud: u32,
    /// Characters of a serial port: 8N1, 8E1, 8O1 or 8N2
    #[arg(long, value_name = "FRAMING", default_value = "8N1", value_parser = framing)]
    pub(super) framing: Framing,
    /// Address of the unit on the line
    #[arg(long, value_name = "UNIT", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=247))]
    pub(super) unit: u8,
    /// Time for one reply
    #[arg(long, value_name = "MS", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    pub(super) timeout_ms: u64,
    /// Silence before a request over a serial line; without it what the standard says for the baud rate
    #[arg(long, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    pub(super) gap_us: Option<u64>,
    /// Write what goes over the wire into a new capture file (pcap, for Wireshark)
    #[arg(long, value_name = "FILE")]
    pub(super) tap: Option<PathBuf>,
}

pub(super) fn framing(text: &str) -> Result<Framing, String> {
    match text.to_ascii_uppercase().as_str() {
        "8N1" => Ok(Framing::EightNoneOne),
        "8E1" => Ok(Framing::EightEvenOne),
        "8O1" => Ok(Framing::EightOddOne),
        "8N2" => Ok(Framing::EightNoneTwo),
        _ => Err("expected 8N1, 8E1, 8O1 or 8N2".to_owned()),
    }
}

impl WireArguments {
    pub(super) fn target(&self) -> Result<Target, Failure> {
        let text = match (&self.port, &self.host) {
            (Some(port), _) => port.clone(),
            (None, Some(host)) => format!("tcp:{}", host.strip_prefix("tcp:").unwrap_or(host)),
            (None, None) => {
                return Err(Failure::with_help(
                    USAGE,
                    "no port is given",
                    "give --port PATH or --host HOST:PORT; `drivebench ports` lists what is plugged in",
                ));
            }
        };
        text.parse().map_err(|error: TargetError| {
            Failure::with_help(USAGE, error.to_string(), error.help())
        })
    }

    pub(super) fn settings(&self) -> RawSettings {
        RawSettings {
            baud: self.baud,
            framing: self.framing,
            unit: self.unit,
            timeout: Duration::from_millis(self.timeout_ms),
            gap: self.gap_us.map(Duration::from_micros),
        }
    }

    pub(super) fn open(&self, tap: &Tap) -> Result<RawClient, Failure> {
        Ok(RawClient::open(
            &self.target()?,
            &self.settings(),
            tap.file(),
        )?)
    }
}

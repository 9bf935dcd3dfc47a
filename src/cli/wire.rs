//! What `registers` and `doctor` have in common: which line, how it is asked, and the capture of what it carries.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::failure::{Failure, USAGE};
use super::output;
pub(super) use crate::app::Tap;
use crate::drive::{Framing, RawClient, RawSettings, Target, TargetError, standard_gap_s};

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
    gap_us: Option<u64>,
    /// The same in ms; 0 for a peer that needs no silence to tell frames apart
    #[arg(long, value_name = "MS", conflicts_with = "gap_us", value_parser = gap_ms)]
    gap: Option<f64>,
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

/// Longest silence before a request that may be asked for, ms.
const LONGEST_GAP_MS: f64 = 1000.0;

fn gap_ms(text: &str) -> Result<f64, String> {
    let ms = text.parse().ok();
    ms.filter(|ms| (0.0..=LONGEST_GAP_MS).contains(ms))
        .ok_or_else(|| format!("{text:?} is not a number of ms from 0 to {LONGEST_GAP_MS}"))
}

impl WireArguments {
    /// Silence before a request that was asked for.
    pub(super) fn gap(&self) -> Option<Duration> {
        let given = self.gap.map(|ms| Duration::from_secs_f64(ms * 1e-3));
        given.or(self.gap_us.map(Duration::from_micros))
    }

    /// A silence below that of the standard is the user's choice, and said.
    fn short_gap(&self, target: &Target) -> Option<String> {
        let (Some(gap), Target::Serial { baud, .. }) = (self.gap(), target) else {
            return None;
        };
        let baud = baud.unwrap_or(self.baud);
        let standard_s = standard_gap_s(baud, self.framing);
        (gap.as_secs_f64() < standard_s).then(|| {
            format!(
                "warning: {} ms of silence before a request is below the standard's {:.2} ms at {baud} {}: a unit that tells frames by silence may take two for one",
                1e3 * gap.as_secs_f64(),
                1e3 * standard_s,
                self.framing.name()
            )
        })
    }

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
            gap: self.gap(),
        }
    }

    pub(super) fn open(&self, tap: &Tap) -> Result<RawClient, Failure> {
        let target = self.target()?;
        let client = RawClient::open(&target, &self.settings(), tap.file())?;
        if let Some(warning) = self.short_gap(&target) {
            output::message(&warning);
        }
        Ok(client)
    }
}

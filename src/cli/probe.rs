//! `probe`: is this the drive of that profile, and are its registers where the profile says? Only read.
//!
//! ```text
//! --drive    -> reach.rs -> drive::probe -> ProbeReport -> text or JSON, exit status by its verdict
//! no --drive -> survey.rs: every built-in profile in turn
//! ```

mod survey;
mod text;

use std::path::PathBuf;
use std::time::Duration;

use super::failure::{Failure, LINK, REFUSED};
use super::reach::{self, Asking};
use super::wire::{Tap, framing};
use super::{opening, output};
use crate::drive::{Framing, ProbeReport, ProbeVerdict};

/// Time for one reply where a drive is known, and where every profile is tried, ms.
const TIMEOUT_MS: u64 = 1000;
const SURVEY_TIMEOUT_MS: u64 = 300;

/// Look at a drive, read-only: identity, every mapped signal, and whether they are those of a drive at rest
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench probe --port /dev/ttyUSB0 --drive siemens-v20
  drivebench probe --port /dev/ttyUSB0 --drive ./acme-40.toml --json      is my profile right?
  drivebench probe --port /dev/ttyUSB0                                    which built-in profile could it be?
  drivebench probe --port emulator --drive epulse50-dc

The shaft has to stand still. Where a reading is not one of a drive at rest, other ways of reading it are shown: the address
one lower or higher (base 0 or 1), the other word order, byte order or sign.
Nothing is written: function codes 03, 04, 08 and 43, and over the stream only questions.
Exit status: 0 plausible; 1 something is not; 3 no answer, or another drive. Without --drive: 0 a profile fits, or which one
does cannot be told; 1 none fits; 3 no answer. The stream is not tried then, and the port emulator needs --drive.")]
pub(super) struct Arguments {
    /// Serial port, tcp:HOST:PORT, or emulator (the software drive in the guise of the profile)
    #[arg(long, value_name = "PORT")]
    port: String,
    /// Drive profile: a built-in name or a file; without it every built-in one is tried
    #[arg(long, value_name = "DRIVE")]
    drive: Option<String>,
    /// Baud rate; without it that of the profile
    #[arg(long, value_name = "BAUD", value_parser = clap::value_parser!(u32).range(1..))]
    baud: Option<u32>,
    /// Characters of a serial port: 8N1, 8E1, 8O1 or 8N2; without it those of the profile
    #[arg(long, value_name = "FRAMING", value_parser = framing)]
    framing: Option<Framing>,
    /// Address of the unit on the line; without it that of the profile
    #[arg(long, value_name = "UNIT", value_parser = clap::value_parser!(u8).range(1..=247))]
    unit: Option<u8>,
    /// Time for one reply; without it 1000, and 300 where every profile is tried
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: Option<u64>,
    /// Silence before a request over a serial line; without it that of the profile, or of the standard
    #[arg(long, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    gap_us: Option<u64>,
    /// Write what goes over the wire into a new capture file (pcap, for Wireshark)
    #[arg(long, value_name = "FILE")]
    tap: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Arguments {
    fn asking(&self, timeout_ms: u64) -> Asking {
        Asking {
            baud: self.baud,
            framing: self.framing,
            unit: self.unit,
            timeout: Duration::from_millis(self.timeout_ms.unwrap_or(timeout_ms)),
            gap_us: self.gap_us,
        }
    }
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let tap = Tap::create(arguments.tap.as_deref())?;
    let Some(drive) = &arguments.drive else {
        let asking = arguments.asking(SURVEY_TIMEOUT_MS);
        let survey = survey::survey(&arguments.port, &asking, &tap)?;
        output::result(&survey, arguments.json, text::survey)?;
        return survey.verdict();
    };
    let (profile, _) = opening::profile(drive)?;
    let far_end = reach::far_end(&arguments.port, &profile)?;
    let report = reach::look(&far_end, &profile, &arguments.asking(TIMEOUT_MS), &tap)?;
    output::result(&report, arguments.json, text::report)?;
    verdict(&report)
}

/// The failure that the verdict is.
fn verdict(report: &ProbeReport) -> Result<(), Failure> {
    let advises = report.signals.iter().any(|s| !s.candidates.is_empty());
    let (status, help) = match report.verdict {
        ProbeVerdict::Plausible => return Ok(()),
        ProbeVerdict::Implausible if report.is_unknown_everywhere => (
            REFUSED,
            "see the remark on stdout: address_base, address or table of the profile; docs/adding-a-drive.md tells how the profile is mended",
        ),
        ProbeVerdict::Implausible if !advises => (
            REFUSED,
            "stop the drive, let the shaft stand still, and compare with the drive's own display; docs/adding-a-drive.md tells how the profile is mended",
        ),
        ProbeVerdict::Implausible => (
            REFUSED,
            "let the shaft stand still, compare with the drive's own display, and see the other ways of reading on stdout; docs/adding-a-drive.md tells how the profile is mended",
        ),
        ProbeVerdict::WrongDrive => (
            LINK,
            "is it the drive of this profile? `drivebench probe --port PORT` without --drive tries every built-in one",
        ),
    };
    Err(Failure::with_help(status, &report.sentence, help))
}

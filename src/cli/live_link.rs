//! From the bench file to a link: the protocol, the far end of the wire, and the emulator behind it where it is ours.

use std::path::Path;
use std::time::Instant;

use super::failure::{Failure, LINK, USAGE};
use super::wire::Tap;
use crate::bench::{BenchFile, BenchFileError, CheckError, Port, Protocol};
use crate::drive::{
    DriveLink, DriveProfile, LinkError, Target as LinkTarget, TargetError, open_tapped,
};
use crate::emulator::{EmulatorConfig, Endpoint, Latency, LinkKind, ServerHandle};

/// What an exchange of the bench's protocol takes over its line, for a drive in memory.
pub(super) fn latency(config: &EmulatorConfig, bench: &BenchFile) -> Latency {
    let mut line = config.line.clone();
    line.baud = match bench.link.protocol {
        Protocol::ModbusTcp => 0,
        Protocol::ModbusRtu | Protocol::Stream => bench.link.baud,
    };
    Latency::of_line(&line, bench.link.protocol == Protocol::ModbusRtu)
}

/// Serves the emulator from a thread of this process, over the protocol that the bench file names.
pub(super) fn serve(config: &EmulatorConfig, bench: &BenchFile) -> Result<ServerHandle, Failure> {
    let (kind, endpoint) = match bench.link.protocol {
        Protocol::ModbusRtu => (LinkKind::ModbusRtu, Endpoint::temporary_pty()),
        Protocol::Stream => (LinkKind::Stream, Endpoint::temporary_pty()),
        Protocol::ModbusTcp => (
            LinkKind::ModbusTcp,
            Endpoint::Tcp(std::net::SocketAddr::from(([127, 0, 0, 1], 0))),
        ),
    };
    let mut config = config.clone();
    config.line.baud = bench.link.baud;
    let handle = crate::emulator::spawn(config, bench.emulator.seed, kind, endpoint)
        .map_err(|error| Failure::with_help(LINK, error.to_string(), error.help()))?;
    Ok(handle)
}

/// The drive's profile, wired up as the bench file says: the profile only knows what is usual.
pub(super) fn wired_profile(bench: &BenchFile) -> Result<DriveProfile, Failure> {
    let mut profile = DriveProfile::named(&bench.drive.profile)
        .map_err(|error| Failure::with_help(USAGE, error.to_string(), error.help()))?;
    profile.link.protocol = match bench.link.protocol {
        Protocol::ModbusRtu => crate::drive::Protocol::ModbusRtu,
        Protocol::ModbusTcp => crate::drive::Protocol::ModbusTcp,
        Protocol::Stream => crate::drive::Protocol::Stream,
    };
    profile.link.baud = bench.link.baud;
    profile.link.unit = bench.link.unit;
    profile.link.deadline_ms = bench.link.deadline_ms.or(profile.link.deadline_ms);
    Ok(profile)
}

/// The capture of a run. Where no wire is involved there is nothing to tap.
pub(super) fn tap(path: Option<&Path>, port: &Port) -> Result<Tap, Failure> {
    if path.is_some() && *port == Port::Sim {
        return Err(Failure::with_help(
            USAGE,
            "--tap has nothing to record: sim: is a drive in memory",
            "give --port emulator, or a serial port, or tcp:HOST:PORT",
        ));
    }
    Tap::create(path)
}

/// The link of the bench file's protocol to this address.
pub(super) fn open(
    address: &str,
    bench: &BenchFile,
    profile: &DriveProfile,
    epoch: Instant,
    tap: &Tap,
) -> Result<Box<dyn DriveLink>, Failure> {
    let target = target(address, bench)?;
    Ok(open_tapped(&target, profile, epoch, tap.file())?)
}

/// The far end of the wire with the bench file's baud rate and unit.
fn target(address: &str, bench: &BenchFile) -> Result<LinkTarget, Failure> {
    let target: LinkTarget = address
        .parse()
        .map_err(|error: TargetError| Failure::with_help(USAGE, error.to_string(), error.help()))?;
    Ok(match target {
        LinkTarget::Serial { path, .. } => LinkTarget::Serial {
            path,
            baud: Some(bench.link.baud),
            unit: Some(bench.link.unit),
        },
        LinkTarget::Tcp { host, port, .. } => LinkTarget::Tcp {
            host,
            port,
            unit: Some(bench.link.unit),
        },
    })
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        let help = error.help();
        Self::with_help(LINK, error.to_string(), help)
    }
}

impl From<CheckError> for Failure {
    fn from(error: CheckError) -> Self {
        let help = error.help();
        Self::with_help(LINK, error.to_string(), help)
    }
}

impl From<BenchFileError> for Failure {
    fn from(error: BenchFileError) -> Self {
        let help = error.help();
        Self::with_help(USAGE, error.to_string(), help)
    }
}

//! From the bench file to a link: the protocol, the far end of the wire, and the emulator behind it where it is ours.

use super::failure::{Failure, LINK, USAGE};
use crate::bench::{BenchFile, Protocol};
use crate::drive::{DriveProfile, LinkError, Target as LinkTarget, TargetError};
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

/// The far end of the wire with the bench file's baud rate and unit.
pub(super) fn target(address: &str, bench: &BenchFile) -> Result<LinkTarget, Failure> {
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

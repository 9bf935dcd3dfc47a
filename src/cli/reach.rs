//! A drive that is only looked at: over a port, or the software drive in the guise of its profile. Nothing is written.

use std::time::Duration;

use super::failure::{Failure, LINK, USAGE};
use super::output;
use super::wire::Tap;
use crate::bench::{MonotonicClock, Port};
use crate::drive::{
    DriveProfile, ProbeDepth, ProbeReport, Protocol, RawClient, RawSettings, Target, TargetError,
    open_stream, probe, probe_stream,
};
use crate::emulator::{EmulatorConfig, Endpoint, Guise, LinkKind, ServerHandle, spawn_as};

/// Seed of the software drive that is only looked at.
const SEED: u64 = 1;

/// How a unit on the line is asked; what is `None` comes from the profile.
#[derive(Clone, Debug, Default)]
pub(super) struct Asking {
    pub(super) baud: Option<u32>,
    pub(super) framing: Option<crate::drive::Framing>,
    pub(super) unit: Option<u8>,
    pub(super) timeout: Duration,
    pub(super) gap_us: Option<u64>,
}

impl Asking {
    /// With everything that the profile says of its line.
    pub(super) fn settings(&self, profile: &DriveProfile) -> RawSettings {
        let link = &profile.link;
        let profiled_gap = link.gap_us.map(|us| Duration::from_secs_f64(us * 1e-6));
        RawSettings {
            baud: self.baud.unwrap_or(link.baud),
            framing: self.framing.unwrap_or(link.framing),
            unit: self.unit.unwrap_or(link.unit),
            timeout: self.timeout,
            gap: self.gap_us.map(Duration::from_micros).or(profiled_gap),
        }
    }
}

/// The far end of a port, and the software drive behind it where it is ours.
pub(super) struct FarEnd {
    pub(super) target: Target,
    /// Dropping it ends the emulator.
    _server: Option<ServerHandle>,
}

/// A port that leads to a wire; `emulator` starts the software drive as `profile` describes it.
pub(super) fn far_end(port: &str, profile: &DriveProfile) -> Result<FarEnd, Failure> {
    const ALLOWED: &str =
        "a serial port, tcp:HOST:PORT or emulator; `drivebench ports` lists what is plugged in";
    let parsed = Port::parse(port).ok_or_else(|| {
        Failure::with_help(USAGE, format!("--port {port:?} is not a port"), ALLOWED)
    })?;
    let (address, server) = match parsed {
        Port::Sim => {
            return Err(Failure::with_help(
                USAGE,
                "--port sim: is a drive in memory, and there is no line to look at",
                ALLOWED,
            ));
        }
        Port::Emulator => {
            let handle = emulator(profile)?;
            output::message(&format!("software drive {}", handle.ready_line()));
            let address = match profile.link.protocol {
                Protocol::ModbusTcp => format!("tcp:{}", handle.address()),
                Protocol::ModbusRtu | Protocol::Stream => handle.address().to_owned(),
            };
            (address, Some(handle))
        }
        Port::Tcp(_) | Port::Serial(_) => (port.to_owned(), None),
    };
    let target = address
        .parse()
        .map_err(|error: TargetError| Failure::with_help(USAGE, error.to_string(), error.help()))?;
    Ok(FarEnd {
        target,
        _server: server,
    })
}

fn emulator(profile: &DriveProfile) -> Result<ServerHandle, Failure> {
    let (kind, endpoint) = match profile.link.protocol {
        Protocol::ModbusRtu => (LinkKind::ModbusRtu, Endpoint::temporary_pty()),
        Protocol::Stream => (LinkKind::Stream, Endpoint::temporary_pty()),
        Protocol::ModbusTcp => (
            LinkKind::ModbusTcp,
            Endpoint::Tcp(std::net::SocketAddr::from(([127, 0, 0, 1], 0))),
        ),
    };
    let mut config = EmulatorConfig::embedded_default();
    config.line.baud = profile.link.baud;
    spawn_as(Guise::of(profile), config, SEED, kind, endpoint)
        .map_err(|error| Failure::with_help(LINK, error.to_string(), error.help()))
}

/// Looks at the drive with its profile.
pub(super) fn look(
    far_end: &FarEnd,
    profile: &DriveProfile,
    asking: &Asking,
    tap: &Tap,
) -> Result<ProbeReport, Failure> {
    let settings = asking.settings(profile);
    if profile.link.protocol == Protocol::Stream {
        let mut profile = profile.clone();
        profile.link.baud = settings.baud;
        profile.link.framing = settings.framing;
        let epoch = MonotonicClock::start().origin();
        let mut link = open_stream(&far_end.target, &profile, epoch, tap.file())?;
        return Ok(probe_stream(&mut link, &profile)?);
    }
    let mut client = RawClient::open(&far_end.target, &settings, tap.file())?;
    Ok(probe(&mut client, profile, ProbeDepth::Whole)?)
}

//! From the bench file to a link: the protocol, the far end of the wire, and the emulator behind it where it is ours.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use super::failure::{Failure, LINK, USAGE};
use super::files::read_text;
use super::output;
use super::tap::Tap;
use crate::bench::{
    BenchFile, BenchFileError, CheckError, DriveFacts, Port, Protocol, check_signals,
};
use crate::drive::{
    DriveLink, DriveProfile, LinkError, ProfiledLink, Target as LinkTarget, TargetError, offer,
    open_tapped,
};
use crate::emulator::{
    EmulatorConfig, Endpoint, ForeignBus, ForeignDrive, Guise, Latency, LinkKind, MemoryLink,
    ServerHandle, SoftDrive, VirtualClock,
};

/// A drive profile by its built-in name, else from a file; with its text.
pub(crate) fn profile(name: &str) -> Result<(DriveProfile, String), Failure> {
    let path = Path::new(name);
    refuse_missing(path)?;
    let read = if DriveProfile::names().any(|known| known == name) || !path.exists() {
        DriveProfile::named(name).and_then(|read| Ok((read, DriveProfile::text(name)?.to_owned())))
    } else {
        let text = read_text(path)?;
        DriveProfile::parse(name, &text).map(|read| (read, text))
    };
    read.map_err(|error| Failure::with_help(USAGE, error.to_string(), error.help()))
}

/// What looks like a path is a file, and no name that might be built in.
fn refuse_missing(path: &Path) -> Result<(), Failure> {
    let text = path.to_string_lossy();
    let is_toml = path.extension().is_some_and(|end| end == "toml");
    if (is_toml || text.contains(['/', '\\'])) && !path.exists() {
        return Err(Failure::with_help(
            USAGE,
            format!("{text}: no such file"),
            "check the path; built-in ones are named without a folder and without .toml",
        ));
    }
    Ok(())
}

/// The profile of a bench, which takes the profile's baud rate where it gives none of its own.
fn drive_profile(bench: &mut BenchFile) -> Result<(DriveProfile, String), Failure> {
    let (profile, text) = profile(&bench.drive.profile)?;
    bench.link.baud.get_or_insert(profile.link.baud);
    if profile.registers.is_some() && bench.link.protocol == Protocol::Stream {
        return Err(Failure::with_help(
            USAGE,
            format!(
                "{} does not speak the stream of our own drive",
                profile.name
            ),
            "set link.protocol to modbus-rtu or modbus-tcp",
        ));
    }
    Ok((profile, text))
}

/// Refuses what the drive's signals cannot carry; says which profile is used and what to know about it.
pub(crate) fn suited(
    profile: &DriveProfile,
    purpose: offer::Purpose,
    headless: bool,
) -> Result<(), Failure> {
    let signals = check_signals(profile, purpose);
    if let Some(help) = signals.help {
        let only_speed = purpose == offer::Purpose::Voltages
            && offer::refusal(profile, offer::Purpose::SpeedLoop).is_none();
        let help = if only_speed {
            "the drive takes a speed or a current: use `drivebench speed`, with a [speed] section in the bench file"
        } else {
            help
        };
        return Err(Failure::with_help(USAGE, signals.text, help));
    }
    if headless {
        announce(profile);
    }
    Ok(())
}

/// How far the profile may be believed, and what to know before the drive is used.
pub(crate) fn announce(profile: &DriveProfile) {
    output::message(&profile.provenance());
    for (channel, text) in offer::carried(profile) {
        output::message(&format!("  {:<14} {text}", channel.key()));
    }
    for remark in offer::remarks(profile) {
        output::message(&format!("  {remark}"));
    }
}

/// An embedded emulator by name, else a file.
pub(crate) fn emulator_config(name: &str) -> Result<EmulatorConfig, Failure> {
    let path = Path::new(name);
    refuse_missing(path)?;
    let config = if EmulatorConfig::embedded_names().any(|known| known == name) || !path.exists() {
        EmulatorConfig::embedded(name)
    } else {
        EmulatorConfig::parse(name, &read_text(path)?)
    };
    config.map_err(|error| Failure::with_help(USAGE, error.to_string(), error.help()))
}

/// The software drive in memory, in the guise of another where the profile is one.
pub(crate) fn in_memory(
    config: &EmulatorConfig,
    bench: &BenchFile,
    guise: Option<&Guise>,
    time: VirtualClock,
) -> Box<dyn DriveLink> {
    let seed = bench.emulator.seed;
    if let Some(guise) = guise {
        let drive = ForeignDrive::new(guise, config, seed);
        let bus = ForeignBus::new(drive, guise, time);
        Box::new(ProfiledLink::new(Arc::clone(&guise.map), bus))
    } else {
        let drive = SoftDrive::new(config, seed);
        Box::new(MemoryLink::new(drive, time, latency(config, bench)))
    }
}

/// What an exchange of the bench's protocol takes over its line, for a drive in memory.
fn latency(config: &EmulatorConfig, bench: &BenchFile) -> Latency {
    let mut line = config.line.clone();
    line.baud = match bench.link.protocol {
        Protocol::ModbusTcp => 0,
        Protocol::ModbusRtu | Protocol::Stream => bench.baud(),
    };
    Latency::of_line(&line, bench.link.protocol == Protocol::ModbusRtu)
}

/// Serves the emulator from a thread of this process, over the protocol that the bench file names.
pub(crate) fn serve(
    config: &EmulatorConfig,
    bench: &BenchFile,
    guise: Option<Guise>,
) -> Result<ServerHandle, Failure> {
    let (kind, endpoint) = match bench.link.protocol {
        Protocol::ModbusRtu => (LinkKind::ModbusRtu, Endpoint::temporary_pty()),
        Protocol::Stream => (LinkKind::Stream, Endpoint::temporary_pty()),
        Protocol::ModbusTcp => (
            LinkKind::ModbusTcp,
            Endpoint::Tcp(std::net::SocketAddr::from(([127, 0, 0, 1], 0))),
        ),
    };
    let mut config = config.clone();
    config.line.baud = bench.baud();
    let handle = crate::emulator::spawn_as(guise, config, bench.emulator.seed, kind, endpoint)
        .map_err(|error| Failure::with_help(LINK, error.to_string(), error.help()))?;
    Ok(handle)
}

/// The drive's profile, wired up as the bench file says, with its text: the profile only knows what is usual.
pub(crate) fn wired_profile(bench: &mut BenchFile) -> Result<(DriveProfile, String), Failure> {
    let (mut profile, text) = drive_profile(bench)?;
    profile.link.protocol = bench.link.protocol;
    bench.drive_facts = DriveFacts::of(&profile);
    if let Some((key, value, most)) = bench.beyond_drive() {
        return Err(Failure::with_help(
            USAGE,
            format!(
                "{key} = {value}: the drive profile {} allows at most {most}",
                profile.name
            ),
            "lower it in the bench file, or correct [limits] of the drive's profile",
        ));
    }
    profile.link.baud = bench.baud();
    profile.link.unit = bench.link.unit;
    profile.link.deadline_ms = bench.link.deadline_ms.or(profile.link.deadline_ms);
    profile.link.emulated = bench.port() == Port::Emulator;
    Ok((profile, text))
}

/// The capture of a run. Where no wire is involved there is nothing to tap.
pub(crate) fn tap(path: Option<&Path>, port: &Port) -> Result<Tap, Failure> {
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
pub(crate) fn open(
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
pub(crate) fn target(address: &str, bench: &BenchFile) -> Result<LinkTarget, Failure> {
    let target: LinkTarget = address
        .parse()
        .map_err(|error: TargetError| Failure::with_help(USAGE, error.to_string(), error.help()))?;
    Ok(match target {
        LinkTarget::Serial { path, .. } => LinkTarget::Serial {
            path,
            baud: Some(bench.baud()),
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

//! From the bench file to a link: the protocol, the address, and the emulator where it is ours; the capture of the traffic; how
//! the same link is opened again.
//!
//! This file owns the wall clock (the stamps of run folders and captures).

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use crate::runtime::failure::Failure;
use crate::runtime::files::read_text;
use crate::runtime::output::{self, Terminal};
use drivebench_bench::{BenchFile, DriveFacts, Port, Protocol, check_signals};
use drivebench_emulator::{
    EmulatorConfig, Endpoint, ForeignBus, ForeignDrive, Guise, Latency, MemoryLink, ServerHandle,
    SoftDrive, VirtualClock, open_line, spawn_as,
};
use drivebench_link::serial_ports::holder_names;
use drivebench_link::{
    self as drive, Anchor, DriveLink, DriveProfile, LinkError, ProfiledLink, TapFile, Target,
    offer, open_tapped,
};

/// A bench file; a profile in its folder is found whatever the present folder is.
pub(crate) fn bench_file(path: &Path) -> Result<BenchFile, Failure> {
    let mut bench = BenchFile::parse(&path.display().to_string(), &read_text(path)?)?;
    let profile = &mut bench.drive.profile;
    let in_folder = path.parent().map(|folder| folder.join(&*profile));
    if let Some(file) = in_folder.filter(|file| file.is_file() && !Path::new(&*profile).exists()) {
        *profile = file.display().to_string();
    }
    Ok(bench)
}

/// A drive profile by its built-in name, else from a file; with its text.
pub(crate) fn profile(name: &str) -> Result<(DriveProfile, String), Failure> {
    let path = Path::new(name);
    refuse_missing(path)?;
    if DriveProfile::names().any(|known| known == name) || !path.exists() {
        return Ok((DriveProfile::named(name)?, DriveProfile::text(name)?.to_owned()));
    }
    let text = read_text(path)?;
    Ok((DriveProfile::parse(name, &text)?, text))
}

/// Refuses a text that looks like a path, not like a built-in name, and is no file.
fn refuse_missing(path: &Path) -> Result<(), Failure> {
    let text = path.to_string_lossy();
    let is_toml = path.extension().is_some_and(|end| end == "toml");
    if (is_toml || text.contains(['/', '\\'])) && !path.exists() {
        return Err(Failure::usage(
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
    let language = profile.link.protocol;
    if !is_modbus_drive(&profile) && bench.link.protocol == Protocol::default() {
        bench.link.protocol = language;
    }
    check_protocol(&profile, bench.link.protocol)?;
    if let (Protocol::ModbusRtuOverTcp, Port::Serial(path)) = (bench.link.protocol, bench.port()) {
        return Err(Failure::usage(
            format!("link.protocol is modbus-rtu-over-tcp, and {path} is a serial port"),
            "set link.protocol to modbus-rtu, or give tcp:HOST:PORT",
        ));
    }
    let unit = bench.link.unit;
    if !matches!(unit, 1..=247) && bench.link.protocol != Protocol::ModbusTcp {
        return Err(Failure::usage(
            format!("link.unit {unit} is not allowed"),
            "1 to 247; over modbus-tcp 0 to 255",
        ));
    }
    Ok((profile, text))
}

/// Our own drive, or one of registers.
fn is_modbus_drive(profile: &DriveProfile) -> bool {
    profile.registers.is_none() || profile.link.protocol.is_modbus()
}

/// Refuses a protocol that the drive does not have: registers go over every kind of Modbus, our own drive has the stream as well, and
/// a drive of another language has that alone.
pub(crate) fn check_protocol(profile: &DriveProfile, protocol: Protocol) -> Result<(), Failure> {
    let has = |protocol: &Protocol| match *protocol {
        Protocol::Stream => profile.registers.is_none(),
        protocol if is_modbus_drive(profile) => protocol.is_modbus(),
        protocol => protocol == profile.link.protocol,
    };
    if has(&protocol) {
        return Ok(());
    }
    let allowed: Vec<&str> =
        Protocol::ALL.iter().filter(|known| has(known)).map(|p| p.name()).collect();
    Err(Failure::usage(
        format!("{} does not have the protocol {protocol}", profile.name),
        format!("allowed: {}", allowed.join(", ")),
    ))
}

/// Refuses a purpose for which the drive has not the signals.
pub(crate) fn suited(profile: &DriveProfile, purpose: offer::Purpose) -> Result<(), Failure> {
    let signals = check_signals(profile, purpose);
    if let Some(help) = signals.help {
        let only_speed = purpose == offer::Purpose::Voltages
            && offer::refusal(profile, offer::Purpose::SpeedLoop).is_none();
        let help = if only_speed {
            "the drive takes a speed or a current: use `drivebench speed`, with a [speed] section in the bench file, or [currents] where it takes a current"
        } else {
            help
        };
        return Err(Failure::usage(signals.text, help));
    }
    Ok(())
}

/// Prints where the profile comes from, which signals the drive provides, and remarks on its use.
pub(crate) fn announce(profile: &DriveProfile, terminal: &Terminal) {
    terminal.message(&profile.provenance());
    for (channel, text) in offer::carried(profile) {
        terminal.message(&format!("  {:<14} {text}", channel.key()));
    }
    for remark in offer::remarks(profile) {
        terminal.message(&format!("  {remark}"));
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
    Ok(config?)
}

/// The software drive in memory, in the guise of another where the profile is one.
pub(crate) fn in_memory(
    config: &EmulatorConfig,
    bench: &BenchFile,
    guise: Option<&Guise>,
    time: VirtualClock,
) -> Result<Box<dyn DriveLink>, Failure> {
    if config.needs_line() {
        return Err(Failure::usage(
            "--port sim: has no line, and the emulator's [[fault]] happens on one",
            "give --port sim:rtu, or --port emulator",
        ));
    }
    config.suits(guise.is_some(), bench.link.protocol)?;
    let seed = bench.emulator.seed;
    if let Some(guise) = guise {
        let bus = ForeignBus::new(ForeignDrive::new(guise, config, seed), guise, time);
        return Ok(Box::new(ProfiledLink::new(Arc::clone(&guise.map), bus)));
    }
    Ok(Box::new(MemoryLink::new(SoftDrive::new(config, seed), time, latency(config, bench))))
}

pub(crate) fn on_a_line(
    config: &EmulatorConfig,
    bench: &BenchFile,
    guise: Option<&Guise>,
    profile: &DriveProfile,
    time: VirtualClock,
) -> Result<Box<dyn DriveLink>, Failure> {
    let protocol = bench.link.protocol;
    if matches!(protocol, Protocol::ModbusTcp | Protocol::ModbusRtuOverTcp | Protocol::Stream) {
        return Err(Failure::usage(
            format!("--port sim:rtu is a line of Modbus RTU, and link.protocol is {protocol}"),
            "set link.protocol to modbus-rtu, or give --port sim:",
        ));
    }
    Ok(open_line(guise, config, bench.emulator.seed, profile, time)?)
}

/// What an exchange of the bench's protocol takes over its line, for a drive in memory.
fn latency(config: &EmulatorConfig, bench: &BenchFile) -> Latency {
    let mut line = config.line.clone();
    line.baud = match bench.link.protocol {
        network if network.is_network() => 0,
        _ => bench.baud(),
    };
    Latency::of_line(&line, bench.link.protocol == Protocol::ModbusRtu)
}

/// Serves the emulator from a thread of this process.
pub(crate) fn serve(
    protocol: drive::Protocol,
    config: EmulatorConfig,
    seed: u64,
    guise: Option<Guise>,
) -> Result<ServerHandle, Failure> {
    config.suits(guise.is_some(), protocol)?;
    let endpoint = if protocol.is_network() {
        Endpoint::Tcp(SocketAddr::from(([127, 0, 0, 1], 0)))
    } else {
        Endpoint::temporary_pty()
    };
    spawn_as(guise, config, seed, protocol, endpoint)
        .map_err(|error| Failure::link(error.to_string(), error.help()))
}

pub(crate) fn address(protocol: drive::Protocol, handle: &ServerHandle) -> String {
    if protocol.is_network() {
        format!("tcp:{}", handle.address())
    } else {
        handle.address().to_owned()
    }
}

/// The drive's profile with the settings of the bench file, and its text.
pub(crate) fn wired_profile(bench: &mut BenchFile) -> Result<(DriveProfile, String), Failure> {
    let (mut profile, text) = drive_profile(bench)?;
    profile.link.protocol = bench.link.protocol;
    bench.drive_facts = DriveFacts::of(&profile);
    if let Some((key, value, most)) = bench.beyond_drive() {
        return Err(Failure::usage(
            format!("{key} = {value}: the drive profile {} allows at most {most}", profile.name),
            "lower it in the bench file, or correct [limits] of the drive's profile",
        ));
    }
    profile.link.baud = bench.baud();
    profile.link.unit = bench.link.unit;
    profile.link.deadline_ms = bench.link.deadline_ms.or(profile.link.deadline_ms);
    profile.link.emulated = bench.port().is_emulated();
    Ok((profile, text))
}

/// The capture of a run; refused where there is no line.
pub(crate) fn tap(path: Option<&Path>, port: &Port, terminal: &Terminal) -> Result<Tap, Failure> {
    if path.is_some() && port.is_virtual() {
        return Err(Failure::usage(
            "--tap has nothing to record: there is no line outside this program",
            "give --port emulator, or a serial port, or tcp:HOST:PORT",
        ));
    }
    Tap::create(path, terminal)
}

/// The address of the drive with the bench file's baud rate and unit.
pub(crate) fn target(address: &str, bench: &BenchFile) -> Result<Target, Failure> {
    let (baud, unit) = (Some(bench.baud()), Some(bench.link.unit));
    Ok(match address.parse()? {
        Target::Serial { path, .. } => Target::Serial { path, baud, unit },
        Target::Tcp { host, port, .. } => Target::Tcp { host, port, unit },
    })
}

/// The capture of a line, where one is requested.
pub(crate) struct Tap {
    file: Option<TapFile>,
    terminal: Terminal,
}

impl Tap {
    /// Nothing is running yet, so that a file that cannot be made is refused.
    pub(crate) fn create(path: Option<&Path>, terminal: &Terminal) -> Result<Self, Failure> {
        let file = path.map(|path| {
            output::refuse_existing([path], "--tap")?;
            TapFile::create(path, now().into()).map_err(|e| output::cannot_write(path, &e))
        });
        Ok(Self { file: file.transpose()?, terminal: terminal.clone() })
    }

    pub(crate) fn file(&self) -> Option<&TapFile> {
        self.file.as_ref()
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        if let Some(Err(reason)) = self.file.take().map(TapFile::finish) {
            self.terminal.message(&format!("warning: {reason}"));
        }
    }
}

pub(crate) struct Reopener {
    pub(crate) link: String,
    pub(crate) limit_s: Option<f64>,
    anchor: Anchor,
    epoch: Instant,
    /// Of a serial port.
    path: Option<PathBuf>,
}

impl Reopener {
    /// Made when the link has just been opened.
    pub(crate) fn of(target: &Target, epoch: Instant, limit_s: Option<f64>) -> Self {
        let anchor = Anchor::of(Path::new("/"), target);
        let path = match target {
            Target::Serial { path, .. } => Some(PathBuf::from(path)),
            Target::Tcp { .. } => None,
        };
        Self { link: anchor.target().to_string(), limit_s, anchor, epoch, path }
    }

    /// Refuses another adapter under the same name.
    pub(crate) fn open(
        &self,
        profile: &DriveProfile,
        tap: Option<&TapFile>,
    ) -> Result<Box<dyn DriveLink>, LinkError> {
        let target = self.anchor.target();
        if let Some(reason) = self.anchor.stranger(Path::new("/")) {
            return Err(LinkError::Identity(target.to_string(), reason));
        }
        open_tapped(target, profile, self.epoch, tap)
    }

    /// Names of other programs that have the serial port open: the replies that they read are missing here.
    pub(crate) fn other_reader(&self) -> Option<String> {
        let names = holder_names(self.path.as_deref()?)?;
        Some(format!(
            "{names} has the port open as well: the replies that it reads are missing here"
        ))
    }
}

#[expect(clippy::disallowed_methods, reason = "the stamp of a run folder is wall-clock time")]
pub(crate) fn now() -> jiff::Timestamp {
    jiff::Timestamp::now()
}

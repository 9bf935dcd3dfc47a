//! `probe`: is this the drive of that profile, and are its registers where the profile has them? Without a profile: which of
//! the built-in ones fits? Nothing is written to the drive. With what `init` reads of a drive, and the scan of `doctor`.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use serde::Serialize;

use crate::commands::arguments::{check_unit, framing};
use crate::report::wording::{json, probe as words};
use crate::runtime::{Failure, LINK, REFUSED, Tap, Terminal, address, lines, opening, serve};
use drivebench_bench::{MonotonicClock, Port, Readback};
use drivebench_emulator::{EmulatorConfig, Guise, ServerHandle};
use drivebench_link as drive;
use drivebench_link::register_map::Quantity;
use drivebench_link::{
    DriveProfile, Framing, LinkError, ProbeDepth, ProbeReport, ProbeVerdict, ProbedSignal,
    RawClient, RawSettings, ReadRequest, StatedMotor, Target, Unexpected, open_cells, open_stream,
    probe, probe_cells, probe_stream,
};
use drivebench_model::text::number::{reading, with_unit};

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
Exit status: 0 plausible; 1 something is not; 3 no answer, or another drive. Without --drive: 0 a profile fits, or more
than one may; 1 none fits; 3 no answer. The stream is not tried then, and the port emulator needs --drive.")]
pub(super) struct Arguments {
    /// Serial port, tcp:HOST:PORT, or emulator (the software drive in the guise of the profile)
    #[arg(long, value_name = "PORT")]
    port: String,
    /// Drive profile: a built-in name or a file; without it every built-in one is tried
    #[arg(long, value_name = "DRIVE")]
    drive: Option<String>,
    #[command(flatten)]
    line: LineOptions,
    /// Write what goes over the wire into a new capture file (pcap, for Wireshark)
    #[arg(long, value_name = "FILE")]
    tap: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Settings of a line; without one that of the profile.
#[derive(clap::Args, Default)]
struct LineOptions {
    /// Baud rate; without it that of the profile
    #[arg(long, value_name = "BAUD", value_parser = clap::value_parser!(u32).range(1..))]
    baud: Option<u32>,
    /// Characters of a serial port: 8N1, 8E1, 8O1 or 8N2; without it those of the profile
    #[arg(long, value_name = "FRAMING", value_parser = framing)]
    framing: Option<Framing>,
    /// Frames of Modbus RTU over TCP, as transparent serial converters carry them
    #[arg(long)]
    rtu_over_tcp: bool,
    /// Address of the unit on the line, 1 to 247, over Modbus TCP 0 to 255; without it that of the profile
    #[arg(long, value_name = "UNIT")]
    unit: Option<u8>,
    /// Time for one reply; without it 1000, and 300 where every profile is tried
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: Option<u64>,
    /// Silence before a request over a serial line; without it that of the profile, or of the standard
    #[arg(long, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    gap_us: Option<u64>,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    if let Ok(target) = arguments.port.parse() {
        let LineOptions { unit, rtu_over_tcp, .. } = arguments.line;
        check_unit(&target, unit, rtu_over_tcp && arguments.port != "emulator")?;
    }
    let tap = Tap::create(arguments.tap.as_deref(), terminal)?;
    let Some(drive) = &arguments.drive else {
        let found = survey(&arguments.port, &arguments.line, &tap, terminal)?;
        terminal.result(&found, arguments.json, survey_text)?;
        return found.verdict();
    };
    let (profile, _) = opening::profile(drive)?;
    let end = far_end(&arguments.port, &profile, terminal)?;
    let report = look(&end, &profile, &arguments.line, &tap)?;
    terminal.result(&json::probe(&report), arguments.json, |_| report_text(&report))?;
    verdict(&report)
}

fn verdict(report: &ProbeReport) -> Result<(), Failure> {
    let advises = report.signals.iter().any(|s| !s.candidates.is_empty());
    let (status, help) = match report.verdict {
        ProbeVerdict::Plausible => return Ok(()),
        ProbeVerdict::Implausible if report.is_unknown_everywhere => (
            REFUSED,
            "see the remark on stdout: address_base, address or table of the profile; docs/drives.md shows how to correct the profile",
        ),
        ProbeVerdict::Implausible if !advises => (
            REFUSED,
            "stop the drive, let the shaft stand still, and compare with the drive's own display; docs/drives.md shows how to correct the profile",
        ),
        ProbeVerdict::Implausible => (
            REFUSED,
            "let the shaft stand still, compare with the drive's own display, and see the other ways of reading on stdout; docs/drives.md shows how to correct the profile",
        ),
        ProbeVerdict::Unjudged => (
            REFUSED,
            "give the profile a signal that can be judged at rest (current, speed, voltage, a temperature) or an [[identity]]; docs/drives.md shows how",
        ),
        ProbeVerdict::WrongDrive => (
            LINK,
            "is it the drive of this profile? `drivebench probe --port PORT` without --drive tries every built-in one",
        ),
    };
    Err(Failure::with_help(status, words::probe(report), help))
}

fn report_text(report: &ProbeReport) -> String {
    let mut text = format!("{}\n", report.provenance);
    let mut line = |name: &str, what: String| {
        let _ = writeln!(text, "  {name:<10} {what}");
    };
    if let Some(identity) = &report.identity {
        line("identity", identity.plate());
        let limit = |value: Option<f64>, unit| {
            value.map_or_else(|| "not reported".to_owned(), |value| format!("{value} {unit}"))
        };
        let current = limit(identity.current_limit_a, "A");
        let voltage = limit(identity.voltage_limit_v, "V");
        line("limits", format!("current {current}, voltage {voltage}"));
    }
    if !report.names.is_empty() {
        let names = report.names.join(", ");
        line("names", format!("{names} (function code 43)"));
    }
    if let Some(answers) = report.answers_function_8 {
        let what = if answers { "sends a number back" } else { "not answered" };
        line("function 08", what.to_owned());
    }
    for check in &report.checks {
        let passed = if check.passed { "ok" } else { "FAILED" };
        line("check", format!("{passed}: {} (found {})", check.what, check.found));
    }
    if !report.states.is_empty() {
        let states = report.states.iter().map(|state| {
            let holds = match state.holds {
                None => "not read",
                Some(true) => "yes",
                Some(false) => "no",
            };
            format!("{} {holds}", state.name)
        });
        line("state", states.collect::<Vec<_>>().join(", "));
    }
    if let Some(watchdog_s) = report.watchdog_s {
        let off = if watchdog_s > 0.0 { "" } else { ": it is off" };
        line("watchdog", format!("{} s{off}", reading(watchdog_s)));
    }
    let _ = writeln!(text);
    for signal in &report.signals {
        text.push_str(&signal_text(signal));
    }
    let _ = writeln!(text);
    for other in &report.hypotheses {
        let _ = writeln!(
            text,
            "with {} {} of {} readings would be plausible, as the profile is {}: is the profile right?",
            other.change, other.plausible, other.judged, other.as_written
        );
    }
    lines(&mut text, "remark: ", &report.remarks);
    let _ = writeln!(text, "{}", words::probe(report));
    text
}

fn signal_text(signal: &ProbedSignal) -> String {
    let quantity = |value: f64| with_unit(&reading(value), signal.unit);
    let value = signal.value.map_or_else(|| "none".to_owned(), quantity);
    let raw = signal.raw.as_ref().map_or_else(
        || "-".to_owned(),
        |cells| {
            // A register has two bytes, another cell one.
            let digits = if matches!(signal.table, "byte" | "field" | "reply") { 2 } else { 4 };
            cells.iter().map(|cell| format!("{cell:0digits$x}")).collect::<Vec<_>>().join(" ")
        },
    );
    let judgement = match (signal.plausible, &signal.missing, signal.expected) {
        (Some(false), Some(missing), _) => format!("not plausible: {missing}"),
        (_, Some(missing), _) => format!("missing: {missing}"),
        (Some(true), None, _) if signal.confirms => "plausible".to_owned(),
        (Some(true), None, _) => "plausible at rest".to_owned(),
        (Some(false), None, Some([low, high])) => {
            let (low, high) = (reading(low), reading(high));
            format!("not plausible: {low} to {high} {} at rest", signal.unit)
        }
        _ => "not judged".to_owned(),
    };
    let register = match signal.table {
        // What travels in a message of its own has no address.
        "stream" => "stream".to_owned(),
        table => format!("{table} {}", signal.address),
    };
    let mut text =
        format!("{:<16} {value:>14}  {raw:<10} {register:<14} {judgement}\n", signal.name);
    // All candidates are in the JSON.
    for candidate in signal.candidates.iter().take(4) {
        let ending = if candidate.plausible { ", plausible: is the profile right?" } else { "" };
        let (change, name) = (&candidate.change, &signal.name);
        let value = quantity(candidate.value);
        let _ = writeln!(text, "    with {change} {name} would be {value}{ending}");
    }
    text
}

fn survey_text(survey: &Survey) -> String {
    let mut text = format!("{}\n", survey.link);
    if !survey.names.is_empty() {
        let names = survey.names.join(", ");
        let _ = writeln!(text, "names: {names} (function code 43)");
    }
    for tried in &survey.profiles {
        let (profile, fit, reason) = (&tried.profile, tried.fit.text(), &tried.reason);
        let _ = writeln!(text, "{profile:<18} {fit:<15} {reason}");
    }
    text
}

/// Between two openings of a port: what is under way at the old baud rate must be over, and our software drive needs a
/// moment for a fresh pseudo-terminal.
const SETTLING: Duration = Duration::from_millis(100);

impl LineOptions {
    /// For one profile, or for `all` that are tried.
    fn settings(&self, profile: &DriveProfile, all: bool) -> RawSettings {
        let link = &profile.link;
        let profiled_gap = link.gap_us.map(|us| Duration::from_secs_f64(us * 1e-6));
        RawSettings {
            baud: self.baud.unwrap_or(link.baud),
            framing: self.framing.unwrap_or(link.framing),
            unit: self.unit.unwrap_or(link.unit),
            timeout: Duration::from_millis(self.timeout_ms.unwrap_or(if all { 300 } else { 1000 })),
            gap: self.gap_us.map(Duration::from_micros).or(profiled_gap),
            rtu_over_tcp: self.rtu_over_tcp || link.protocol == drive::Protocol::ModbusRtuOverTcp,
        }
    }
}

/// The far end of a port, and the software drive behind it where it is ours.
struct FarEnd {
    target: Target,
    /// Dropping it ends the emulator.
    _server: Option<ServerHandle>,
}

/// A port that leads to a wire; `emulator` starts the software drive as `profile` describes it.
fn far_end(port: &str, profile: &DriveProfile, terminal: &Terminal) -> Result<FarEnd, Failure> {
    const ALLOWED: &str =
        "a serial port, tcp:HOST:PORT or emulator; `drivebench ports` lists what is plugged in";
    let unknown = || Failure::usage(format!("--port {port:?} is not a port"), ALLOWED);
    let (address, server) = match Port::parse(port).ok_or_else(unknown)? {
        Port::Sim | Port::SimRtu => {
            let headline =
                format!("--port {port} is a drive in memory, and there is no line to look at");
            return Err(Failure::usage(headline, ALLOWED));
        }
        Port::Emulator => {
            let mut config = EmulatorConfig::embedded_default();
            config.line.baud = profile.link.baud;
            let protocol = profile.link.protocol;
            let handle = serve(protocol, config, 1, Guise::of(profile))?;
            terminal.message(&format!("software drive {}", handle.ready_line()));
            (address(protocol, &handle), Some(handle))
        }
        Port::Tcp(_) | Port::Serial(_) => (port.to_owned(), None),
    };
    Ok(FarEnd { target: address.parse()?, _server: server })
}

fn look(
    far_end: &FarEnd,
    profile: &DriveProfile,
    line: &LineOptions,
    tap: &Tap,
) -> Result<ProbeReport, Failure> {
    let settings = line.settings(profile, false);
    let own = profile;
    let mut profile = own.clone();
    (profile.link.baud, profile.link.framing) = (settings.baud, settings.framing);
    let epoch = MonotonicClock::start().origin();
    if profile.link.protocol == drive::Protocol::Stream {
        let mut link = open_stream(&far_end.target, &profile, epoch, tap.file())?;
        return Ok(probe_stream(&mut link, &profile)?);
    }
    if let (false, Some(map)) = (profile.link.protocol.is_modbus(), &profile.registers) {
        let mut bus = open_cells(&far_end.target, &profile, map, epoch, tap.file())?;
        return Ok(probe_cells(&mut bus, &profile)?);
    }
    let mut client = RawClient::open(&far_end.target, &settings, tap.file())?;
    Ok(probe(&mut client, own, ProbeDepth::Whole)?)
}

/// Limits and watchdog as the drive reports them; nothing is written to it.
pub(crate) fn read_limits(
    port: &str,
    drive: &str,
    profile: &DriveProfile,
    terminal: &Terminal,
) -> Result<Readback, Failure> {
    if Port::parse(port).is_some_and(|port| port.is_virtual()) {
        return Ok(limits_in_memory(profile));
    }
    let (line, no_tap) = (LineOptions::default(), Tap::create(None, terminal)?);
    let probed =
        far_end(port, profile, terminal).and_then(|end| look(&end, profile, &line, &no_tap));
    let report = probed.map_err(|failure| {
        let help = "check cable, power and address (`drivebench doctor --port PORT`), or give --offline: the file then states that the drive's limits were not read back";
        Failure::with_help(failure.status, failure.headline(), help)
    })?;
    if matches!(report.verdict, ProbeVerdict::Plausible | ProbeVerdict::Unjudged) {
        return Ok(limits_of(&report));
    }
    Err(Failure::link(
        format!("the readings of the drive are not plausible: {}", words::probe(&report)),
        format!(
            "`drivebench probe --port {port} --drive {drive}` shows every reading; --offline makes the file without the drive"
        ),
    ))
}

fn limits_of(report: &ProbeReport) -> Readback {
    let identity = report.identity.as_ref();
    let who = match (identity, report.names.is_empty()) {
        (_, false) => report.names.join(", "),
        (Some(identity), true) => format!("serial {}", identity.serial_number),
        (None, true) => "it has no identification".to_owned(),
    };
    Readback {
        is_offline: false,
        who: format!("{who}; {}", words::probe(report)),
        current_limit_a: identity
            .and_then(|found| found.current_limit_a)
            .or(report.value_of(Quantity::CurrentLimit)),
        voltage_limit_v: identity
            .and_then(|found| found.voltage_limit_v)
            .or(report.value_of(Quantity::VoltageLimit)),
        bus_v: report.value_of(Quantity::BusVoltage),
        watchdog_s: report.watchdog_s,
        motor: StatedMotor::of(|quantity| report.value_of(quantity), |_| None),
    }
}

fn limits_in_memory(profile: &DriveProfile) -> Readback {
    let config = EmulatorConfig::embedded_default();
    let is_ours = profile.registers.is_none();
    let watchdog_s = 1e-3 * f64::from(config.watchdog_ms);
    Readback {
        is_offline: false,
        who: "the software drive in memory".to_owned(),
        current_limit_a: is_ours.then_some(config.limits.current_limit_a),
        voltage_limit_v: is_ours.then_some(config.limits.bus_v),
        bus_v: Some(config.limits.bus_v),
        watchdog_s: is_ours.then_some(watchdog_s),
        motor: None,
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Scan {
    pub(crate) tried: usize,
    /// Baud rate and framing of the first answer.
    pub(crate) found: Option<(u32, Framing)>,
    pub(crate) units: Vec<u8>,
    /// Whole frames came there, and none of a unit that was tried: the unit of the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) other_unit: Option<u8>,
    /// Settings at which the line returned the requests and nothing else.
    #[serde(skip_serializing_if = "is_zero")]
    pub(crate) only_echoes: usize,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
const fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Tries lines until a unit answers, first with `settings`, which become those of the answer. Only function code 03 is sent:
/// every Modbus unit answers it, if only with an exception.
pub(crate) fn scan(
    target: &Target,
    settings: &mut RawSettings,
    (first, last): (u8, u8),
    tap: &Tap,
    terminal: &Terminal,
) -> Result<Scan, Failure> {
    // In the order of how common they are on drives.
    const BAUDS: [u32; 7] = [9600, 19_200, 115_200, 38_400, 57_600, 230_400, 4800];
    const FRAMINGS: [Framing; 4] =
        [Framing::EightNoneOne, Framing::EightEvenOne, Framing::EightOddOne, Framing::EightNoneTwo];
    let is_serial = matches!(target, Target::Serial { .. });
    let mut scan = Scan::default();
    let given = (settings.baud, settings.framing);
    let mut lines = vec![given];
    if is_serial {
        let all = FRAMINGS.iter().flat_map(|f| BAUDS.map(|baud| (baud, *f)));
        lines.extend(all.filter(|line| *line != given));
    }
    for (baud, framing) in lines {
        scan.tried += 1;
        terminal.message(&if is_serial {
            format!("trying {baud} {}", framing.name())
        } else {
            format!("trying units {first} to {last}")
        });
        // The slowest drives answer in 60 ms; wire and adapter add to that.
        let bits = f64::from(framing.bits_per_char()) * 32.0;
        let patience = Duration::from_secs_f64(0.12 + bits / f64::from(baud));
        let here =
            RawSettings { baud, framing, timeout: settings.timeout.min(patience), ..*settings };
        let mut client = RawClient::open(target, &here, tap.file())?;
        let mut only_echoes = false;
        for unit in first..=last {
            client.set_unit(unit);
            match client.read(ReadRequest::holding(0, 1)) {
                Ok(_) | Err(LinkError::Exception { .. }) => scan.units.push(unit),
                Err(error @ LinkError::Gone { .. }) => return Err(error.into()),
                Err(LinkError::Unexpected { what: Unexpected::Unit(other), .. }) => {
                    scan.other_unit = Some(other);
                }
                Err(LinkError::Unexpected { what: Unexpected::Echo, .. }) => only_echoes = true,
                Err(_) => {}
            }
        }
        drop(client);
        std::thread::sleep(SETTLING);
        scan.only_echoes += usize::from(only_echoes);
        if let Some(unit) = scan.units.first() {
            (settings.baud, settings.framing, settings.unit) = (baud, framing, *unit);
            scan.found = Some((baud, framing));
            scan.other_unit = None;
            break;
        }
        // A frame with a right check sum shows that the settings are right.
        if scan.other_unit.is_some() {
            (settings.baud, settings.framing) = (baud, framing);
            scan.found = Some((baud, framing));
            break;
        }
    }
    Ok(scan)
}

/// Whether a profile may be the drive's; the likelier ones first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Fit {
    /// Its identity checks hold.
    Matches,
    /// Nothing contradicts it, and the profile has no check that would prove the drive.
    CannotBeTold,
    No,
    NoAnswer,
    NotTried,
}

impl Fit {
    const fn text(self) -> &'static str {
        match self {
            Self::Matches => "matches",
            Self::CannotBeTold => "undecided",
            Self::No => "no",
            Self::NoAnswer => "no answer",
            Self::NotTried => "not tried",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Tried {
    profile: String,
    fit: Fit,
    reason: String,
}

/// Which built-in profile could the drive on this line be?
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Survey {
    link: String,
    /// Vendor, product and revision as the unit gives them (function code 43).
    names: Vec<String>,
    profiles: Vec<Tried>,
}

impl Survey {
    /// Success where a profile remains.
    fn verdict(&self) -> Result<(), Failure> {
        let link = &self.link;
        match self.profiles.iter().map(|tried| tried.fit).min() {
            Some(Fit::Matches | Fit::CannotBeTold) => Ok(()),
            Some(Fit::No) => Err(Failure::with_help(
                REFUSED,
                format!("{link}: something answers, and no built-in profile fits it"),
                "write a profile from its manual: docs/drives.md; then probe with --drive FILE",
            )),
            _ => Err(Failure::link(
                format!("{link}: nothing answers with the settings of any built-in profile"),
                "check wiring and power; `drivebench doctor --port PORT --scan` tries baud rates, parities and units",
            )),
        }
    }

    fn push(&mut self, profile: &DriveProfile, fit: Fit, reason: String) {
        self.profiles.push(Tried { profile: profile.name.clone(), fit, reason });
    }
}

/// Tries each profile at its own baud rate.
fn survey(
    port: &str,
    options: &LineOptions,
    tap: &Tap,
    terminal: &Terminal,
) -> Result<Survey, Failure> {
    let profiles: Vec<DriveProfile> =
        DriveProfile::names().filter_map(|name| DriveProfile::named(name).ok()).collect();
    let Some(first) = profiles.first().filter(|_| port != "emulator") else {
        return Err(Failure::usage(
            "--port emulator answers as the profile that is requested",
            "name it with --drive; without --drive give a serial port or tcp:HOST:PORT",
        ));
    };
    let far_end = far_end(port, first, terminal)?;
    let mut survey =
        Survey { link: far_end.target.to_string(), names: Vec::new(), profiles: Vec::new() };
    // Profiles of one line are tried over one opening of the port.
    let mut lines: Vec<(RawSettings, Vec<&DriveProfile>)> = Vec::new();
    for profile in &profiles {
        if !profile.link.protocol.is_modbus() {
            let reason = "its frames are no Modbus: try it with --drive";
            survey.push(profile, Fit::NotTried, reason.to_owned());
            continue;
        }
        let settings = options.settings(profile, true);
        match lines.iter_mut().find(|(line, _)| *line == settings) {
            Some((_, of_line)) => of_line.push(profile),
            None => lines.push((settings, vec![profile])),
        }
    }
    for (settings, of_line) in lines {
        try_line(&far_end, &settings, &of_line, tap, &mut survey, terminal)?;
        std::thread::sleep(SETTLING);
    }
    survey.profiles.sort_by_key(|tried| tried.fit);
    Ok(survey)
}

fn try_line(
    far_end: &FarEnd,
    settings: &RawSettings,
    profiles: &[&DriveProfile],
    tap: &Tap,
    survey: &mut Survey,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let (baud, framing, unit) = (settings.baud, settings.framing.name(), settings.unit);
    let line = match far_end.target {
        Target::Serial { .. } => format!("{baud} {framing} unit {unit}"),
        Target::Tcp { .. } => format!("unit {unit}"),
    };
    terminal.message(&format!("trying {line}"));
    let mut client = RawClient::open(&far_end.target, settings, tap.file())?;
    let mut is_dead = false;
    for profile in profiles {
        let report = (!is_dead).then(|| probe(&mut client, profile, ProbeDepth::Readings));
        let (fit, reason) = match report {
            Some(Ok(report)) => fit(&report),
            Some(Err(error @ LinkError::Gone { .. })) => return Err(error.into()),
            Some(Err(error @ LinkError::Exception { .. })) => (Fit::NoAnswer, error.to_string()),
            silent => {
                is_dead |= silent.is_some() && !client.has_answered();
                (Fit::NoAnswer, format!("at {line}"))
            }
        };
        survey.push(profile, fit, reason);
    }
    if survey.names.is_empty() {
        survey.names = client.names()?;
    }
    Ok(())
}

fn fit(report: &ProbeReport) -> (Fit, String) {
    let mut signals = report.signals.iter();
    let unread = signals.find(|signal| signal.raw.is_none() && signal.missing.is_some());
    if let Some(signal) = unread.filter(|_| report.verdict != ProbeVerdict::WrongDrive) {
        let why = signal.missing.as_deref().unwrap_or_default();
        let (table, address, name) = (signal.table, signal.address, &signal.name);
        return (Fit::No, format!("{table} register {address} ({name}): {why}"));
    }
    match report.verdict {
        ProbeVerdict::WrongDrive | ProbeVerdict::Implausible => {
            (Fit::No, words::after_name(report))
        }
        ProbeVerdict::Plausible | ProbeVerdict::Unjudged if !report.checks.is_empty() => {
            let checks: Vec<&str> = report.checks.iter().map(|c| c.what.as_str()).collect();
            (Fit::Matches, checks.join("; "))
        }
        ProbeVerdict::Unjudged => (Fit::CannotBeTold, words::probe(report)),
        ProbeVerdict::Plausible => {
            let confirmed = report.signals.iter().filter(|s| s.confirms).count();
            let reason = format!(
                "every register answers and may be that of a drive at rest ({confirmed} with a value that an empty one would not have); the profile has no identity check"
            );
            (Fit::CannotBeTold, reason)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_link::register_map::Candidate;

    #[test]
    fn an_implausible_signal_is_followed_by_other_readings() {
        let signal = ProbedSignal {
            name: "speed".to_owned(),
            unit: "rpm",
            table: "input",
            address: 8291,
            raw: Some(vec![0, 1]),
            value: Some(65_536.0),
            plausible: Some(false),
            expected: Some([-30.0, 30.0]),
            candidates: vec![Candidate {
                change: "word_order = \"low_first\"".to_owned(),
                value: 0.0,
                plausible: true,
            }],
            ..ProbedSignal::default()
        };
        let text = signal_text(&signal);
        for part in [
            "0000 0001",
            "not plausible: -30 to 30 rpm at rest",
            "with word_order = \"low_first\" speed would be 0 rpm, plausible: is the profile right?",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }
}

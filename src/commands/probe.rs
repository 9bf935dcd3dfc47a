//! `probe`: is this the drive of that profile, and are its registers where the profile says? Only read.
//!
//! ```text
//! --drive    -> app::survey::look -> drive::probe -> ProbeReport -> text or JSON, exit status by its verdict
//! no --drive -> app::survey::survey: every built-in profile in turn
//! ```
//!
//! Drives and units that are only looked at: which settings answer, which profile fits, what a drive says of itself. Nothing
//! is written to them.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use serde::Serialize;

use crate::commands::arguments::framing;
use crate::runtime::failure::{Failure, LINK, REFUSED};
use crate::runtime::opening::{Tap, address, serve};
use crate::runtime::output::lines;
use crate::runtime::{opening, output};
use drivebench_bench::{MonotonicClock, Port, Readback};
use drivebench_emulator::{EmulatorConfig, Guise, ServerHandle};
use drivebench_link as drive;
use drivebench_link::register_map::Quantity;
use drivebench_link::{
    DriveProfile, Framing, LinkError, ProbeDepth, ProbeReport, ProbeVerdict, ProbedSignal,
    RawClient, RawSettings, ReadRequest, Target, open_stream, probe, probe_stream,
};
use drivebench_model::text::number::{reading, with_unit};

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
        let found = survey(&arguments.port, &asking, &tap)?;
        output::result(&found, arguments.json, survey_text)?;
        return found.verdict();
    };
    let (profile, _) = opening::profile(drive)?;
    let end = far_end(&arguments.port, &profile)?;
    let report = look(&end, &profile, &arguments.asking(TIMEOUT_MS), &tap)?;
    output::result(&report, arguments.json, report_text)?;
    verdict(&report)
}

/// The failure that the verdict is.
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
    Err(Failure::with_help(status, &report.sentence, help))
}

/// Candidates on the screen; all are in the JSON.
const SHOWN: usize = 4;

/// What a probe found, for a person.
fn report_text(report: &ProbeReport) -> String {
    let mut text = format!("{}\n", report.provenance);
    let mut line = |name: &str, what: String| {
        let _ = writeln!(text, "  {name:<10} {what}");
    };
    if let Some(identity) = &report.identity {
        line("identity", identity.plate());
        let told = |value: Option<f64>, unit| {
            value.map_or_else(|| "not told".to_owned(), |value| format!("{value} {unit}"))
        };
        let current = told(identity.current_limit_a, "A");
        let voltage = told(identity.voltage_limit_v, "V");
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
        let (what, found) = (&check.what, &check.found);
        line("check", format!("{passed}: {what} (found {found})"));
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
        let (change, plausible, judged) = (&other.change, other.plausible, other.judged);
        let now = other.as_written;
        let _ = writeln!(
            text,
            "with {change} {plausible} of {judged} readings would be plausible, as the profile is {now}: is the profile right?"
        );
    }
    lines(&mut text, "remark: ", &report.remarks);
    let _ = writeln!(text, "{}", report.sentence);
    text
}

fn signal_text(signal: &ProbedSignal) -> String {
    let value = signal.value.map(|value| quantity(value, signal.unit));
    let value = value.unwrap_or_else(|| "none".to_owned());
    let raw = signal.raw.as_ref().map(|words| {
        let words = words.iter().map(|word| format!("{word:04x}"));
        words.collect::<Vec<_>>().join(" ")
    });
    let raw = raw.unwrap_or_else(|| "-".to_owned());
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
    for candidate in signal.candidates.iter().take(SHOWN) {
        let ending = if candidate.plausible { ", plausible: is the profile right?" } else { "" };
        let (change, name) = (&candidate.change, &signal.name);
        let value = quantity(candidate.value, signal.unit);
        let _ = writeln!(text, "    with {change} {name} would be {value}{ending}");
    }
    text
}

/// A value with its unit, short.
fn quantity(value: f64, unit: &str) -> String {
    with_unit(&reading(value), unit)
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

/// Time for one reply of a drive that is asked for its limits.
const REPLY_TIMEOUT: Duration = Duration::from_secs(1);
/// Seed of the software drive that is only looked at.
const SEED: u64 = 1;
/// Between two openings of a port: what is under way at the old baud rate must be over, and our software drive needs a
/// moment for a fresh pseudo-terminal.
const SETTLING: Duration = Duration::from_millis(100);
/// The slowest drives answer in 60 ms; wire and adapter come on top.
const PATIENCE: Duration = Duration::from_millis(120);
/// In the order of how common they are on drives.
const BAUDS: [u32; 7] = [9600, 19_200, 115_200, 38_400, 57_600, 230_400, 4800];
const FRAMINGS: [Framing; 4] =
    [Framing::EightNoneOne, Framing::EightEvenOne, Framing::EightOddOne, Framing::EightNoneTwo];

/// How a unit on the line is asked; what is `None` comes from the profile.
#[derive(Clone, Debug, Default)]
pub(crate) struct Asking {
    pub(crate) baud: Option<u32>,
    pub(crate) framing: Option<Framing>,
    pub(crate) unit: Option<u8>,
    pub(crate) timeout: Duration,
    pub(crate) gap_us: Option<u64>,
}

impl Asking {
    /// With everything that the profile says of its line.
    fn settings(&self, profile: &DriveProfile) -> RawSettings {
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
pub(crate) struct FarEnd {
    target: Target,
    /// Dropping it ends the emulator.
    _server: Option<ServerHandle>,
}

/// A port that leads to a wire; `emulator` starts the software drive as `profile` describes it.
pub(crate) fn far_end(port: &str, profile: &DriveProfile) -> Result<FarEnd, Failure> {
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
            let handle = serve(protocol, config, SEED, Guise::of(profile))?;
            output::message(&format!("software drive {}", handle.ready_line()));
            (address(protocol, &handle), Some(handle))
        }
        Port::Tcp(_) | Port::Serial(_) => (port.to_owned(), None),
    };
    Ok(FarEnd { target: address.parse()?, _server: server })
}

/// Looks at the drive with its profile.
pub(crate) fn look(
    far_end: &FarEnd,
    profile: &DriveProfile,
    asking: &Asking,
    tap: &Tap,
) -> Result<ProbeReport, Failure> {
    let settings = asking.settings(profile);
    if profile.link.protocol == drive::Protocol::Stream {
        let mut profile = profile.clone();
        (profile.link.baud, profile.link.framing) = (settings.baud, settings.framing);
        let epoch = MonotonicClock::start().origin();
        let mut link = open_stream(&far_end.target, &profile, epoch, tap.file())?;
        return Ok(probe_stream(&mut link, &profile)?);
    }
    let mut client = RawClient::open(&far_end.target, &settings, tap.file())?;
    Ok(probe(&mut client, profile, ProbeDepth::Whole)?)
}

/// What the drive says of itself; nothing is written to it.
pub(crate) fn told(
    port: &str,
    drive: &str,
    offline: bool,
    profile: &DriveProfile,
) -> Result<Readback, Failure> {
    if offline {
        return Ok(Readback { is_offline: true, ..Readback::default() });
    }
    if Port::parse(port).is_some_and(|port| port.is_virtual()) {
        return Ok(told_in_memory(profile));
    }
    let asking = Asking { timeout: REPLY_TIMEOUT, ..Asking::default() };
    let none = Tap::create(None)?;
    let reached = far_end(port, profile).and_then(|end| look(&end, profile, &asking, &none));
    let report = reached.map_err(|failure| {
        let help = "check cable, power and address (`drivebench doctor --port PORT`), or give --offline: the file then says that the drive's limits were not read back";
        Failure::with_help(failure.status, failure.headline(), help)
    })?;
    if matches!(report.verdict, ProbeVerdict::Plausible | ProbeVerdict::Unjudged) {
        return Ok(of_report(&report));
    }
    Err(Failure::link(
        format!("what the drive says is not believed: {}", report.sentence),
        format!(
            "`drivebench probe --port {port} --drive {drive}` shows every reading; --offline makes the file without asking the drive"
        ),
    ))
}

fn of_report(report: &ProbeReport) -> Readback {
    let identity = report.identity.as_ref();
    let who = match (identity, report.names.is_empty()) {
        (_, false) => report.names.join(", "),
        (Some(identity), true) => format!("serial {}", identity.serial_number),
        (None, true) => "it does not say who it is".to_owned(),
    };
    let current_a = identity.and_then(|found| found.current_limit_a);
    let voltage_v = identity.and_then(|found| found.voltage_limit_v);
    Readback {
        is_offline: false,
        who: format!("{who}; {}", report.sentence),
        current_limit_a: current_a.or(report.value_of(Quantity::CurrentLimit)),
        voltage_limit_v: voltage_v.or(report.value_of(Quantity::VoltageLimit)),
        bus_v: report.value_of(Quantity::BusVoltage),
        watchdog_s: report.watchdog_s,
    }
}

/// The software drive in memory is what its file says.
fn told_in_memory(profile: &DriveProfile) -> Readback {
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
    }
}

/// What a scan has found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Scan {
    /// Settings that were tried.
    pub(crate) tried: usize,
    /// Baud rate and framing of the first answer.
    pub(crate) found: Option<(u32, Framing)>,
    pub(crate) units: Vec<u8>,
}

/// Asks until something answers, first with `settings`, which get those that did. Only function code 03 is asked: every
/// Modbus unit answers it, if only with an exception.
pub(crate) fn scan(
    target: &Target,
    settings: &mut RawSettings,
    (first, last): (u8, u8),
    tap: &Tap,
) -> Result<Scan, Failure> {
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
        output::message(&if is_serial {
            format!("asking at {baud} {}", framing.name())
        } else {
            format!("asking units {first} to {last}")
        });
        let bits = f64::from(framing.bits_per_char()) * 32.0;
        let wire_time = Duration::from_secs_f64(bits / f64::from(baud));
        let here = RawSettings {
            baud,
            framing,
            timeout: settings.timeout.min(PATIENCE + wire_time),
            ..*settings
        };
        let mut client = RawClient::open(target, &here, tap.file())?;
        for unit in first..=last {
            client.set_unit(unit);
            match client.read(ReadRequest::holding(0, 1)) {
                Ok(_) | Err(LinkError::Exception { .. }) => scan.units.push(unit),
                Err(error @ LinkError::Gone { .. }) => return Err(error.into()),
                Err(_) => {}
            }
        }
        drop(client);
        std::thread::sleep(SETTLING);
        if let Some(unit) = scan.units.first() {
            (settings.baud, settings.framing, settings.unit) = (baud, framing, *unit);
            scan.found = Some((baud, framing));
            break;
        }
    }
    Ok(scan)
}

/// Whether a profile may be the drive's; the likelier ones first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Fit {
    /// Its identity checks hold.
    Matches,
    /// Nothing speaks against it, and the profile has nothing by which the drive could be known.
    CannotBeTold,
    No,
    NoAnswer,
    NotTried,
}

impl Fit {
    pub(crate) const fn text(self) -> &'static str {
        match self {
            Self::Matches => "matches",
            Self::CannotBeTold => "cannot be told",
            Self::No => "no",
            Self::NoAnswer => "no answer",
            Self::NotTried => "not tried",
        }
    }
}

/// One profile and what speaks for or against it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Tried {
    pub(crate) profile: String,
    pub(crate) fit: Fit,
    pub(crate) reason: String,
}

/// Which built-in profile could the drive on this line be?
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Survey {
    pub(crate) link: String,
    /// Vendor, product and revision as the unit gives them (function code 43).
    pub(crate) names: Vec<String>,
    pub(crate) profiles: Vec<Tried>,
}

impl Survey {
    /// Success where a profile remains.
    pub(crate) fn verdict(&self) -> Result<(), Failure> {
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
        let profile = profile.name.clone();
        self.profiles.push(Tried { profile, fit, reason });
    }
}

/// Tries each profile at its own baud rate.
pub(crate) fn survey(port: &str, asking: &Asking, tap: &Tap) -> Result<Survey, Failure> {
    let named = DriveProfile::names().filter_map(|name| DriveProfile::named(name).ok());
    let profiles: Vec<DriveProfile> = named.collect();
    let Some(first) = profiles.first().filter(|_| port != "emulator") else {
        return Err(Failure::usage(
            "--port emulator answers as the profile that is asked for",
            "name it with --drive; without --drive give a serial port or tcp:HOST:PORT",
        ));
    };
    let far_end = far_end(port, first)?;
    let mut survey =
        Survey { link: far_end.target.to_string(), names: Vec::new(), profiles: Vec::new() };
    // Profiles of one line are tried over one opening of the port.
    let mut lines: Vec<(RawSettings, Vec<&DriveProfile>)> = Vec::new();
    for profile in &profiles {
        if profile.link.protocol == drive::Protocol::Stream {
            let reason = "its frames are no Modbus: ask for it with --drive";
            survey.push(profile, Fit::NotTried, reason.to_owned());
            continue;
        }
        let settings = asking.settings(profile);
        match lines.iter_mut().find(|(line, _)| *line == settings) {
            Some((_, of_line)) => of_line.push(profile),
            None => lines.push((settings, vec![profile])),
        }
    }
    for (settings, of_line) in lines {
        try_line(&far_end, &settings, &of_line, tap, &mut survey)?;
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
) -> Result<(), Failure> {
    let (baud, framing, unit) = (settings.baud, settings.framing.name(), settings.unit);
    let line = match far_end.target {
        Target::Serial { .. } => format!("{baud} {framing} unit {unit}"),
        Target::Tcp { .. } => format!("unit {unit}"),
    };
    output::message(&format!("asking at {line}"));
    let mut client = RawClient::open(&far_end.target, settings, tap.file())?;
    let mut is_dead = false;
    for profile in profiles {
        let report = (!is_dead).then(|| probe(&mut client, profile, ProbeDepth::Readings));
        let (fit, reason) = match report {
            Some(Ok(report)) => fit(&report),
            Some(Err(error @ LinkError::Gone { .. })) => return Err(error.into()),
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

/// What a report says of its profile.
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
            // The profile's name stands in front of the line already.
            let reason = match report.sentence.split_once(": ") {
                Some((name, reason)) if name == report.profile => reason,
                _ => report.sentence.as_str(),
            };
            (Fit::No, reason.to_owned())
        }
        ProbeVerdict::Plausible | ProbeVerdict::Unjudged if !report.checks.is_empty() => {
            let checks: Vec<&str> = report.checks.iter().map(|c| c.what.as_str()).collect();
            (Fit::Matches, checks.join("; "))
        }
        ProbeVerdict::Unjudged => (Fit::CannotBeTold, report.sentence.clone()),
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
    fn an_implausible_signal_is_followed_by_the_other_ways_of_reading_it() {
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

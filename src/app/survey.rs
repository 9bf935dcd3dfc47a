//! Drives and units that are only looked at: which settings answer, which profile fits, what a drive says of itself. Nothing
//! is written to them.

use std::time::Duration;

use serde::Serialize;

use super::failure::{Failure, REFUSED};
use super::opening::{Tap, address, serve};
use super::output;
use drivebench_bench::{MonotonicClock, Port, Told};
use drivebench_emulator::{EmulatorConfig, Guise, ServerHandle};
use drivebench_link::register_map::Quantity;
use drivebench_link::{
    self as drive, DriveProfile, Framing, LinkError, ProbeDepth, ProbeReport, ProbeVerdict,
    RawClient, RawSettings, ReadRequest, Target, open_stream, probe, probe_stream,
};

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
const FRAMINGS: [Framing; 4] = [
    Framing::EightNoneOne,
    Framing::EightEvenOne,
    Framing::EightOddOne,
    Framing::EightNoneTwo,
];

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
    Ok(FarEnd {
        target: address.parse()?,
        _server: server,
    })
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
) -> Result<Told, Failure> {
    if offline {
        return Ok(Told {
            is_offline: true,
            ..Told::default()
        });
    }
    if Port::parse(port).is_some_and(|port| port.is_virtual()) {
        return Ok(told_in_memory(profile));
    }
    let asking = Asking {
        timeout: REPLY_TIMEOUT,
        ..Asking::default()
    };
    let none = Tap::create(None)?;
    let reached = far_end(port, profile).and_then(|end| look(&end, profile, &asking, &none));
    let report = reached.map_err(|failure| {
        let help = "check cable, power and address (`drivebench doctor --port PORT`), or give --offline: the file then says that the drive's limits were not read back";
        Failure::with_help(failure.status, failure.headline(), help)
    })?;
    if matches!(
        report.verdict,
        ProbeVerdict::Plausible | ProbeVerdict::Unjudged
    ) {
        return Ok(of_report(&report));
    }
    Err(Failure::link(
        format!("what the drive says is not believed: {}", report.sentence),
        format!(
            "`drivebench probe --port {port} --drive {drive}` shows every reading; --offline makes the file without asking the drive"
        ),
    ))
}

fn of_report(report: &ProbeReport) -> Told {
    let identity = report.identity.as_ref();
    let who = match (identity, report.names.is_empty()) {
        (_, false) => report.names.join(", "),
        (Some(identity), true) => format!("serial {}", identity.serial_number),
        (None, true) => "it does not say who it is".to_owned(),
    };
    let current_a = identity.and_then(|found| found.current_limit_a);
    let voltage_v = identity.and_then(|found| found.voltage_limit_v);
    Told {
        is_offline: false,
        who: format!("{who}; {}", report.sentence),
        current_limit_a: current_a.or(report.value_of(Quantity::CurrentLimit)),
        voltage_limit_v: voltage_v.or(report.value_of(Quantity::VoltageLimit)),
        bus_v: report.value_of(Quantity::BusVoltage),
        watchdog_s: report.watchdog_s,
    }
}

/// The software drive in memory is what its file says.
fn told_in_memory(profile: &DriveProfile) -> Told {
    let config = EmulatorConfig::embedded_default();
    let is_ours = profile.registers.is_none();
    let watchdog_s = 1e-3 * f64::from(config.watchdog_ms);
    Told {
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
        self.profiles.push(Tried {
            profile,
            fit,
            reason,
        });
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
    let mut survey = Survey {
        link: far_end.target.to_string(),
        names: Vec::new(),
        profiles: Vec::new(),
    };
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
        return (
            Fit::No,
            format!("{table} register {address} ({name}): {why}"),
        );
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

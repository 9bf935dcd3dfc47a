//! `init`: a bench file from a drive profile, a port and a nameplate, every limit with its reason.
//!
//! ```text
//! profile, nameplate -> reach.rs: ask the drive, read-only (unless --offline) -> bench::init_file -> new file | stdout
//! ```

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;

use super::data::read_text;
use super::failure::{Failure, LINK, USAGE};
use super::reach::{self, Asking};
use super::wire::Tap;
use super::{opening, output};
use crate::bench::{
    InitError, InitFile, InitRequest, MotorSection, Port, Reasoned, Told, init_file,
};
use crate::config_text::{self, ConfigError};
use crate::drive::register_map::Quantity;
use crate::drive::serial_ports::describe;
use crate::drive::{DriveProfile, ProbeReport, ProbeVerdict};
use crate::emulator::EmulatorConfig;

/// Time for one reply.
const TIMEOUT: Duration = Duration::from_secs(1);
/// What a bench file is called in the next steps while it has no name.
const NAMELESS: &str = "bench.toml";

/// Write a bench file for a drive and a motor, every limit with its reason
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench init --drive own --port /dev/ttyUSB0 --motor bench-configs/motors/zk-22fc.toml --out bench.toml
  drivebench init --drive epulse50-dc --port /dev/ttyUSB0 --unit 3 --motor my-motor.toml > bench.toml
  drivebench init --drive own --port sim: --motor bench-configs/motors/zk-22fc.toml       to try it without a drive
  drivebench init --drive ./acme-40.toml --port /dev/ttyUSB0 --offline --motor my-motor.toml

A nameplate is the [motor] table of a bench file, with or without the header. Name and rated values are needed; what makes
the model of the motor may be left out where the drive takes a voltage: `drivebench run` then finds it from small steps first.
The drive is asked for its own limits, and nothing is written to it; --offline goes without. No file is ever overwritten.")]
pub(super) struct Arguments {
    /// Drive profile: a built-in name, or a file
    #[arg(long, value_name = "DRIVE")]
    drive: String,
    /// Serial port, tcp:HOST:PORT, emulator, or sim: (in memory); written into the file, and asked for the drive's limits
    #[arg(long, value_name = "PORT")]
    port: String,
    /// Nameplate of the motor
    #[arg(long, value_name = "NAMEPLATE")]
    motor: PathBuf,
    /// New bench file; without it, or with -, on stdout
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Baud rate; without it that of the profile
    #[arg(long, value_name = "BAUD", value_parser = clap::value_parser!(u32).range(1..))]
    baud: Option<u32>,
    /// Address of the unit on the line; without it that of the profile
    #[arg(long, value_name = "UNIT", value_parser = clap::value_parser!(u8).range(1..=247))]
    unit: Option<u8>,
    /// Do not ask the drive; the file then says that its limits were not read back
    #[arg(long)]
    offline: bool,
    /// Print JSON: the file as text, and each value with its reason
    #[arg(long)]
    json: bool,
}

/// The result as JSON.
#[derive(Serialize)]
struct InitResult<'a> {
    /// Null: not written.
    file: Option<String>,
    bench: &'a str,
    /// The drive was asked.
    read_back: bool,
    values: &'a [Reasoned],
    remarks: &'a [String],
    /// The commands that use the file.
    next: Vec<String>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments
        .out
        .as_deref()
        .filter(|path| *path != Path::new("-"));
    if let Some(path) = out {
        output::refuse_existing(path, "--out")?;
    }
    if Port::parse(&arguments.port).is_none() {
        return Err(Failure::with_help(
            USAGE,
            format!("--port {:?} is not a port", arguments.port),
            "a serial port, tcp:HOST:PORT, sim: or emulator; `drivebench ports` lists what is plugged in",
        ));
    }
    let (mut profile, _) = opening::profile(&arguments.drive)?;
    profile.link.baud = arguments.baud.unwrap_or(profile.link.baud);
    profile.link.unit = arguments.unit.unwrap_or(profile.link.unit);
    let motor_file = arguments.motor.display().to_string();
    let motor = nameplate(&motor_file, &read_text(&arguments.motor)?)?;
    let told = told(arguments, &profile)?;
    let port = stable_name(&arguments.port);
    let request = InitRequest {
        profile: &profile,
        drive: &arguments.drive,
        port: port.as_deref().unwrap_or(&arguments.port),
        port_reason: if port.is_some() {
            "the stable name of the port that was given: another adapter gets another one"
        } else {
            ""
        },
        motor: &motor,
        motor_file: &motor_file,
        told,
    };
    let made = init_file(&request)?;
    if let Some(path) = out {
        output::file(path, &made.text)?;
    }
    let name = out.map(|path| path.display().to_string());
    let next = made.next(name.as_deref().unwrap_or(NAMELESS));
    if arguments.json {
        let result = InitResult {
            file: name.clone(),
            bench: &made.text,
            read_back: !request.told.is_offline,
            values: &made.reasons,
            remarks: &made.remarks,
            next,
        };
        return output::result(&result, true, |_| String::new());
    }
    if out.is_none() {
        output::line(made.text.trim_end())?;
    }
    close(&made, name.as_deref(), &next);
    Ok(())
}

/// A nameplate: the keys alone, or under the header that they have in a bench file.
fn nameplate(file: &str, text: &str) -> Result<MotorSection, ConfigError> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Headed {
        motor: MotorSection,
    }
    let mut lines = text
        .lines()
        .map(|line| line.split('#').next().unwrap_or(""));
    if lines.any(|line| line.trim() == "[motor]") {
        config_text::parse(file, text).map(|headed: Headed| headed.motor)
    } else {
        config_text::parse(file, text)
    }
}

/// What to know and what to do next, on stderr.
fn close(made: &InitFile, name: Option<&str>, next: &[String]) {
    for remark in &made.remarks {
        output::message(&format!("remark: {remark}"));
    }
    let limits = made
        .reasons
        .iter()
        .filter(|reason| reason.key.starts_with("limits."));
    let count = limits.filter(|reason| reason.value.is_some()).count();
    match name {
        Some(name) => output::message(&format!("{name}: {count} limits, each with its reason")),
        None => output::message(&format!(
            "{count} limits, each with its reason; redirect this into {NAMELESS}, or give --out"
        )),
    }
    output::message("next:");
    for line in next {
        output::message(&format!("  {line}"));
    }
}

/// What the drive says of itself; nothing is written to it.
fn told(arguments: &Arguments, profile: &DriveProfile) -> Result<Told, Failure> {
    if arguments.offline {
        return Ok(Told {
            is_offline: true,
            ..Told::default()
        });
    }
    if arguments.port == "sim:" {
        return Ok(in_memory(profile));
    }
    let asking = Asking {
        timeout: TIMEOUT,
        ..Asking::default()
    };
    let none = Tap::create(None)?;
    let reached = reach::far_end(&arguments.port, profile)
        .and_then(|far_end| reach::look(&far_end, profile, &asking, &none));
    let report = reached.map_err(|failure| {
        let help = "check cable, power and address (`drivebench doctor --port PORT`), or give --offline: the file then says that the drive's limits were not read back";
        Failure::with_help(failure.status, failure.headline(), help)
    })?;
    if report.verdict == ProbeVerdict::Plausible {
        return Ok(of_report(&report));
    }
    Err(Failure::with_help(
        LINK,
        format!("what the drive says is not believed: {}", report.sentence),
        format!(
            "`drivebench probe --port {} --drive {}` shows every reading; --offline makes the file without asking the drive",
            arguments.port, arguments.drive
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
    Told {
        is_offline: false,
        who: format!("{who}; {}", report.sentence),
        current_limit_a: identity
            .and_then(|found| found.current_limit_a)
            .or(report.value_of(Quantity::CurrentLimit)),
        voltage_limit_v: identity
            .and_then(|found| found.voltage_limit_v)
            .or(report.value_of(Quantity::VoltageLimit)),
        bus_v: report.value_of(Quantity::BusVoltage),
        watchdog_s: report.watchdog_s,
    }
}

/// The software drive in memory is what its file says.
fn in_memory(profile: &DriveProfile) -> Told {
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

/// The name under `/dev/serial/by-id` of a port that has one and was given by another.
fn stable_name(port: &str) -> Option<String> {
    let Some(Port::Serial(path)) = Port::parse(port) else {
        return None;
    };
    let info = describe(Path::new("/"), Path::new(&path));
    let by_id = info.by_id.first()?;
    (by_id != Path::new(&path)).then(|| by_id.display().to_string())
}

impl From<InitError> for Failure {
    fn from(error: InitError) -> Self {
        Self::with_help(USAGE, error.reason, error.help)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nameplate_may_carry_the_header_of_its_section() {
        let plain = include_str!("../../bench-configs/motors/zk-22fc.toml");
        let bare = nameplate("m.toml", plain).unwrap();
        let headed = nameplate("m.toml", &format!("[motor]\n{plain}")).unwrap();
        assert_eq!(headed, bare);
        let error =
            nameplate("m.toml", "[motor]\nname = \"x\"\nrated_speed_rpm = 3000").unwrap_err();
        assert!(error.help.contains("0.10472"), "{}", error.help);
        assert_eq!(error.line, 3);
    }
}

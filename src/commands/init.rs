//! `init`: a bench file from a drive profile, a port and a nameplate, or a suite from runs; every limit with its reason.
//!
//! ```text
//! --suite RUN... -> test::golden -> new suite, and the bench file of the runs
//! profile, nameplate -> probe: limits of the drive, read-only (unless --offline) -> bench::init_file -> new file | stdout
//! ```

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::commands::probe::read_limits;
use crate::commands::test::golden;
use crate::runtime::{Failure, Terminal, opening, output, read_text};
use drivebench_bench::{InitFile, InitRequest, MotorSection, Port, Readback, Reasoned, init_file};
use drivebench_link::serial_ports::describe;
use drivebench_model::config_text::{self, ConfigError};

/// Name of a bench file without a name in the next steps.
const NAMELESS: &str = "bench.toml";

/// Write a bench file for a drive and a motor, or a suite of bench tests from runs; every limit with its reason
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench init --drive own --port /dev/ttyUSB0 --motor bench-configs/motors/zk-22fc.toml --out bench.toml
  drivebench init --drive epulse50-dc --port /dev/ttyUSB0 --unit 3 --motor my-motor.toml > bench.toml
  drivebench init --drive own --port sim: --motor bench-configs/motors/zk-22fc.toml       to try it without a drive
  drivebench init --drive ./acme-40.toml --port /dev/ttyUSB0 --offline --motor my-motor.toml
  drivebench init --suite runs/*-fit --out golden.toml                limits of later tests from these runs

A nameplate is the [motor] table of a bench file, with or without the header. Name and rated values are needed; what makes
the model of the motor may be left out where the drive takes a voltage, or a current while it measures the voltage: `drivebench
run` then finds it from small steps first.
The drive's own limits are read, and nothing is written to it; --offline skips this. No file is ever overwritten.

--suite takes run folders of `commission`, `run` and `speed` that passed, of one machine on one bench. Each limit has its
reason: the interval of a parameter, the spread of the runs, or the worst of them and a margin.")]
pub(super) struct Arguments {
    /// Drive profile: a built-in name, or a file
    #[arg(long, value_name = "DRIVE", required_unless_present = "suite")]
    drive: Option<String>,
    /// Serial port, tcp:HOST:PORT, emulator, or sim: (in memory); written into the file, and used to read the drive's limits
    #[arg(long, value_name = "PORT", required_unless_present = "suite")]
    port: Option<String>,
    /// Nameplate of the motor
    #[arg(long, value_name = "NAMEPLATE", required_unless_present = "suite")]
    motor: Option<PathBuf>,
    /// Run folders: write a suite that tests the machine against the results of these runs; needs --out
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "out", conflicts_with_all = ["drive", "port", "motor", "baud", "unit", "offline"])]
    suite: Vec<PathBuf>,
    /// New bench file, or suite; without it, or with -, a bench file goes to stdout
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Baud rate; without it that of the profile
    #[arg(long, value_name = "BAUD", value_parser = clap::value_parser!(u32).range(1..))]
    baud: Option<u32>,
    /// Address of the unit on the line; without it that of the profile
    #[arg(long, value_name = "UNIT", value_parser = clap::value_parser!(u8).range(1..=247))]
    unit: Option<u8>,
    /// Do not read the drive; the file then states that its limits were not read back
    #[arg(long)]
    offline: bool,
    /// Print JSON: the file as text, and each value with its reason
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    match (&arguments.drive, &arguments.port, &arguments.motor) {
        (Some(drive), Some(port), Some(motor)) => bench(arguments, drive, port, motor, terminal),
        _ => suite(arguments, terminal),
    }
}

fn suite(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let out = arguments.out.as_deref().unwrap_or(Path::new("suite.toml"));
    let written = golden::write(&arguments.suite, out, terminal)?;
    let files: Vec<_> = written.files.iter().map(|path| path.display().to_string()).collect();
    let limits = &written.golden.limits;
    let next = format!("drivebench test {}", output::quoted_word(&out.display().to_string()));
    let suite = &written.golden.text;
    let result = json!({ "files": files, "suite": suite, "limits": limits, "next": next });
    terminal.result(&result, arguments.json, |_| {
        let lines: Vec<_> = limits
            .iter()
            .map(|limit| {
                format!(
                    "  {:<10} {} = {}\n      {}",
                    limit.case, limit.key, limit.limit, limit.reason
                )
            })
            .collect();
        let (files, count) = (files.join(", "), limits.len());
        format!("{files}: {count} limits\n{}\nnext:\n  {next}", lines.join("\n"))
    })
}

fn bench(
    arguments: &Arguments,
    drive: &str,
    port: &str,
    motor: &Path,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let out = arguments.out.as_deref().filter(|path| *path != Path::new("-"));
    output::refuse_existing(out, "--out")?;
    if Port::parse(port).is_none() {
        return Err(Failure::usage(
            format!("--port {port:?} is not a port"),
            "a serial port, tcp:HOST:PORT, sim:, sim:rtu or emulator; `drivebench ports` lists what is plugged in",
        ));
    }
    let (mut profile, _) = opening::profile(drive)?;
    profile.set_baud(arguments.baud.unwrap_or(profile.link.baud));
    profile.link.unit = arguments.unit.unwrap_or(profile.link.unit);
    let motor_file = motor.display().to_string();
    let motor = nameplate(&motor_file, &read_text(motor)?)?;
    let limits = if arguments.offline {
        Readback { is_offline: true, ..Readback::default() }
    } else {
        read_limits(port, drive, &profile, terminal)?
    };
    let stable = stable_name(port);
    let request = InitRequest {
        profile: &profile,
        drive,
        port: stable.as_deref().unwrap_or(port),
        port_reason: if stable.is_some() {
            "the stable name of the given port: another adapter has another one"
        } else {
            ""
        },
        motor: &motor,
        motor_file: &motor_file,
        readback: limits,
    };
    let made = init_file(&request)?;
    if let Some(path) = out {
        terminal.file(path, &made.text)?;
    }
    let name = out.map(|path| path.display().to_string());
    let next = made.next(name.as_deref().unwrap_or(NAMELESS));
    if arguments.json {
        let result = json!({
            "file": name,
            "bench": made.text,
            "read_back": !request.readback.is_offline,
            "values": made.reasons,
            "remarks": made.remarks,
            "next": next,
        });
        return terminal.json(&result);
    }
    if out.is_none() {
        terminal.line(made.text.trim_end())?;
    }
    remarks(&made, name.as_deref(), &next, terminal);
    Ok(())
}

/// A nameplate: the keys alone, or under the header that they have in a bench file.
fn nameplate(file: &str, text: &str) -> Result<MotorSection, ConfigError> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Headed {
        motor: MotorSection,
    }
    let mut lines = text.lines().map(|line| line.split('#').next().unwrap_or(""));
    if lines.any(|line| line.trim() == "[motor]") {
        config_text::parse(file, text).map(|headed: Headed| headed.motor)
    } else {
        config_text::parse(file, text)
    }
}

fn remarks(made: &InitFile, name: Option<&str>, next: &[String], terminal: &Terminal) {
    for remark in &made.remarks {
        terminal.message(&format!("remark: {remark}"));
    }
    let is_limit = |reason: &&Reasoned| reason.key.starts_with("limits.") && reason.value.is_some();
    let count = made.reasons.iter().filter(is_limit).count();
    let limits = format!("{count} limits, each with its reason");
    terminal.message(&match name {
        Some(name) => format!("{name}: {limits}"),
        None => format!("{limits}; redirect this into {NAMELESS}, or give --out"),
    });
    terminal.message("next:");
    for line in next {
        terminal.message(&format!("  {line}"));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nameplate_may_have_the_header_of_its_section() {
        let plain = include_str!("../../bench-configs/motors/zk-22fc.toml");
        let bare = nameplate("m.toml", plain).unwrap();
        assert_eq!(nameplate("m.toml", &format!("[motor]\n{plain}")).unwrap(), bare);
        let error =
            nameplate("m.toml", "[motor]\nname = \"x\"\nrated_speed_rpm = 3000").unwrap_err();
        assert!(error.help.contains("0.10472"), "{}", error.help);
        assert_eq!(error.line, 3);
    }
}

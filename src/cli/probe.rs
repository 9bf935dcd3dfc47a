//! `probe`: is this the drive of that profile, and are its registers where the profile says? Only read.
//!
//! ```text
//! --drive    -> app::survey::look -> drive::probe -> ProbeReport -> text or JSON, exit status by its verdict
//! no --drive -> app::survey::survey: every built-in profile in turn
//! ```

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use super::arguments::framing;
use super::failure::{Failure, LINK, REFUSED};
use super::opening;
use super::output::{self, lines};
use crate::app::Tap;
use crate::app::survey::{Asking, Survey, far_end, look, survey};
use drivebench_link::{Framing, ProbeReport, ProbeVerdict, ProbedSignal};
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
        let what = if answers {
            "sends a number back"
        } else {
            "not answered"
        };
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
    let mut text = format!(
        "{:<16} {value:>14}  {raw:<10} {register:<14} {judgement}\n",
        signal.name
    );
    for candidate in signal.candidates.iter().take(SHOWN) {
        let ending = if candidate.plausible {
            ", plausible: is the profile right?"
        } else {
            ""
        };
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

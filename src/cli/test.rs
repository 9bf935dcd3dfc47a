//! `test`: a suite of bench tests, with a verdict for people and for machines.

use std::path::PathBuf;

use clap::CommandFactory as _;

use super::arguments::shard;
use super::failure::Failure;
use super::output;
use crate::app::suite::baseline::lines as drift_lines;
use crate::app::suite::{self, SuiteRequest};
use crate::workflow::suite::{Suite, SuiteOutcome, Verb, Verdict};

/// Run a suite of bench tests, on the software drive or a real one: cases of steps, limits, a verdict for each
#[derive(clap::Args)]
#[expect(
    clippy::struct_excessive_bools,
    clippy::doc_markdown,
    reason = "switches of a command line; the help in a terminal shows backticks as they are"
)]
#[command(after_help = "Examples:
  drivebench test bench-configs/suites/acceptance.toml                        the software drive, in virtual time
  drivebench test suite.toml --junit junit.xml --json > result.json           for a CI job
  drivebench test suite.toml --filter smoke --port /dev/ttyUSB0 --hardware    the same cases on the bench
  drivebench test suite.toml --baseline suites/MARCH/result.json              what has drifted since then
  drivebench test suite.toml --shard 2/4                                      the second quarter, on one of four machines

Each step is a command of this program, with the options that its --help has. The motor is stopped by the guard of that
command, also where a step fails or runs out of its time, and else by the drive's watchdog: no step has to do it.
Exit status: 0 all passed or skipped; 1 a limit was not kept; else that of the steps that ended their cases.")]
pub(super) struct Arguments {
    /// The suite
    suite: PathBuf,
    /// Instead of the ports that the suite names: a serial port, tcp:HOST:PORT, sim: or emulator
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// The drive is real, its shaft is free and may turn; without it a person at the terminal is asked
    #[arg(long)]
    hardware: bool,
    /// Where the folder of this suite is made, with the evidence of each case that did not pass
    #[arg(long, value_name = "DIR", default_value = "suites")]
    out: PathBuf,
    /// Cases with this word in their name, or as a tag; may be given more than once
    #[arg(long, value_name = "WORD")]
    filter: Vec<String>,
    /// Part I of N of the cases
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: Option<(u64, u64)>,
    /// Keep the folders of the cases that passed too
    #[arg(long)]
    keep: bool,
    /// Write JUnit XML
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Write the figures as OpenMetrics text
    #[arg(long, value_name = "FILE")]
    metrics: Option<PathBuf>,
    /// Compare what the steps that identify find with an earlier run of the same machine, or with result.json of an earlier
    /// suite, and name what has drifted; may be given again
    #[arg(long, value_name = "RUN")]
    baseline: Vec<PathBuf>,
    /// Compare also where the baseline is of another machine, or does not say of which
    #[arg(long, requires = "baseline")]
    any_machine: bool,
    /// List the cases and do nothing
    #[arg(long)]
    list: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: Arguments) -> Result<(), Failure> {
    let suite = suite::read(&arguments.suite, options_of)?;
    if arguments.list {
        return list(&suite, &arguments);
    }
    let request = SuiteRequest {
        file: arguments.suite,
        port: arguments.port,
        hardware: arguments.hardware,
        out: arguments.out,
        filter: arguments.filter,
        shard: arguments.shard,
        keep: arguments.keep,
        junit: arguments.junit,
        metrics: arguments.metrics,
        baseline: arguments.baseline,
        any_machine: arguments.any_machine,
    };
    let outcome = suite::carry_out(&suite, &request)?;
    output::result(&outcome, arguments.json, text)?;
    match outcome.exit_status() {
        0 => Ok(()),
        status => {
            let headline = format!(
                "{} of {} cases did not pass",
                outcome.failed + outcome.errors,
                outcome.cases.len()
            );
            let help = "each names its folder, with what every step said";
            Err(Failure::with_help(status, headline, help))
        }
    }
}

fn list(suite: &Suite, arguments: &Arguments) -> Result<(), Failure> {
    let cases = suite::selected(suite, &arguments.filter)?;
    let rows: Vec<serde_json::Value> = cases
        .iter()
        .map(|case| serde_json::json!({ "name": case.name, "tags": case.tags, "repeat": case.repeat, "steps": case.steps.len() }))
        .collect();
    output::result(&rows, arguments.json, |_| {
        let line = |case: &&crate::workflow::suite::Case| {
            let times = if case.repeat > 1 {
                format!(" x{}", case.repeat)
            } else {
                String::new()
            };
            format!("{}{times}  [{}]", case.name, case.tags.join(", "))
        };
        cases.iter().map(line).collect::<Vec<_>>().join("\n")
    })
}

/// Cases that did not pass of which the verdict says why.
const MOST_LINES: usize = 20;

/// The verdict in a few lines: the cases themselves stood on stderr as they ended.
fn text(outcome: &SuiteOutcome) -> String {
    let mut lines = vec![format!(
        "{}: {} passed, {} failed, {} errors, {} skipped in {:.1} s",
        outcome.suite,
        outcome.passed,
        outcome.failed,
        outcome.errors,
        outcome.skipped,
        outcome.took_s
    )];
    if !outcome.confusion.is_empty() {
        lines.push("hidden, and what was named for it in how many answers:".to_owned());
    }
    let width = outcome.confusion.rows.iter().map(String::len).max();
    for (hidden, named) in outcome.confusion.named() {
        let named = named.iter().map(|(name, count)| format!("{name} {count}"));
        let named = named.collect::<Vec<_>>().join(", ");
        lines.push(format!("  {hidden:<0$}  {named}", width.unwrap_or(0)));
    }
    let wrong = outcome.cases.iter().filter_map(|case| match &case.verdict {
        Verdict::Failed(reason) | Verdict::Error(reason) => {
            Some(format!("{}: {reason}", case.name))
        }
        Verdict::Passed | Verdict::Skipped(_) => None,
    });
    let wrong: Vec<String> = wrong.collect();
    lines.extend(
        wrong
            .iter()
            .take(MOST_LINES)
            .flat_map(|line| output::fitted(line)),
    );
    if wrong.len() > MOST_LINES {
        lines.push(format!("and {} more", wrong.len() - MOST_LINES));
    }
    lines.extend(
        drift_lines(outcome)
            .iter()
            .flat_map(|line| output::fitted(line)),
    );
    lines.join("\n")
}

/// Long names of the options of the command that a verb is.
fn options_of(verb: Verb) -> Vec<String> {
    let program = super::Arguments::command();
    let command = program.find_subcommand(verb.command());
    let options = command.into_iter().flat_map(clap::Command::get_arguments);
    options
        .filter_map(|option| option.get_long().map(str::to_owned))
        .collect()
}

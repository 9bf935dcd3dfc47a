//! `run`: excite, log, and identify on line, with the live screen or without.

use std::fmt::Write as _;

use super::arguments::{LiveArguments, UnknownMotor};
use super::diagnose::parameter_text;
use super::failure::Failure;
use super::output;
use crate::app::{Recorded, Rig, RunDone, conduct, escalation_failure, run, run_result};
use crate::bench::RunSummary;
use crate::workflow::EscalationResult;

/// Excite the motor, record the run and identify on line; live screen unless --headless
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench run                            the emulated motor, on the live screen
  drivebench run bench.toml --port /dev/ttyUSB0 --hardware --headless
  drivebench run --escalate --port sim: --emulator small-servo-behind-zk-22fc   find the motor first")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    unknown: UnknownMotor,
    /// Seed of the sequence's random parts, and of the emulator's noise on that day (no number of a run): as runs.fit, select
    /// or confirm of the bench file. Without it runs.fit
    #[arg(long, value_name = "N")]
    run_seed: Option<u64>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let json = arguments.live.json;
    let options = arguments.live.options(arguments.unknown.escalate)?;
    let run_seed = arguments.run_seed;
    let done = conduct(arguments.live.audience(None), move |controls| {
        run(options, run_seed, Box::new(Rig::open), controls)
    })?;
    let left = done.left;
    match &done.work {
        RunDone::Named(escalation) => {
            output::result(escalation.as_ref(), json, EscalationResult::text)?;
            left.conclude(escalation_failure(escalation))
        }
        RunDone::Run(whole) => {
            output::result(&run_result(whole), json, |result| {
                let mut text = text(&whole.recorded);
                if let Some(escalation) = &whole.escalation {
                    text.push_str(&escalation.text());
                } else if let Some(comparison) = &result.nameplate {
                    text.push_str(&comparison.text());
                }
                text
            })?;
            left.conclude(whole.recorded.failure())
        }
    }
}

fn text(recorded: &Recorded) -> String {
    let (summary, timing) = (&recorded.summary, &recorded.summary.timing);
    let (achieved_hz, asked_hz) = (timing.rate_achieved_hz, timing.rate_asked_hz);
    let rate = format!(" {achieved_hz:.1} of {asked_hz:.0} Hz,");
    let folder = recorded.folder.path().display();
    let mut text = format!("{folder}\n{}\n", account(summary, &rate));
    for estimate in &summary.estimates {
        let verdict = estimate.verdict.name();
        let _ = writeln!(text, "{verdict:<24} {}", parameter_text(estimate));
    }
    text
}

/// How a run went, in one line.
pub(super) fn account(summary: &RunSummary, rate: &str) -> String {
    let (outcome, rows) = (summary.outcome.name(), summary.rows);
    let (duration_s, missed) = (summary.duration_s, summary.timing.missed_cycles);
    let (lost, sent) = (summary.link.lost(), summary.link.sent);
    format!(
        "{outcome}: {rows} rows in {duration_s:.1} s,{rate} {missed} cycles missed, {lost} of {sent} exchanges lost"
    )
}

//! `run`: excite, log, and identify on line, with the live screen or without.

use std::fmt::Write as _;

use super::failure::Failure;
use super::live::{LiveArguments, UnknownMotor};
use super::output;
use crate::app::{
    Left, Recorded, Rig, RunDone, RunRequest, conduct, escalation_failure, run, run_result,
};
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
    let request = RunRequest {
        rig: arguments.live.options(arguments.unknown.escalate)?,
        run_seed: arguments.run_seed,
    };
    let done = conduct(arguments.live.audience(None), move |strings| {
        run(request, Box::new(Rig::open), strings)
    })?;
    finish(json, &done.work, done.left)
}

fn finish(json: bool, done: &RunDone, left: Left) -> Result<(), Failure> {
    match done {
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
    let summary = &recorded.summary;
    let mut text = format!("{}\n", recorded.folder.path().display());
    let _ = writeln!(
        text,
        "{}: {} rows in {:.1} s, {:.1} of {:.0} Hz, {} cycles missed, {} of {} exchanges lost",
        summary.outcome.name(),
        summary.rows,
        summary.duration_s,
        summary.timing.rate_achieved_hz,
        summary.timing.rate_asked_hz,
        summary.timing.missed_cycles,
        summary.link.lost(),
        summary.link.sent
    );
    for estimate in &summary.estimates {
        let _ = writeln!(
            text,
            "{:<24} {}",
            estimate.verdict.name(),
            super::diagnose::parameter_text(estimate)
        );
    }
    text
}

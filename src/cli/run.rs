//! `run`: excite, log, and identify on line, with the live screen or without.

use std::fmt::Write as _;

use serde::Serialize;

use super::escalate::{UnknownMotor, escalate, failure};
use super::failure::Failure;
use super::live::{LiveArguments, Rig, Strings};
use super::recorded::Recorded;
use super::{output, pages, screen};
use crate::bench::{Plan, RunSummary};
use crate::drive::offer::Purpose;
use crate::identification::nameplate::Comparison;
use crate::plant::{FittedValue, Model, ModelFile, Motor, MotorKey};
use crate::recording::RunFile;
use crate::sample::Verdict;
use crate::workflow::{EscalationResult, compared};

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

/// The result as JSON.
#[derive(Serialize)]
struct RunResult<'a> {
    folder: String,
    plan: &'a Plan,
    #[serde(flatten)]
    summary: &'a RunSummary,
    /// How an unknown motor was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    escalation: Option<&'a EscalationResult>,
    /// What was found against the plate, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    nameplate: Option<Comparison>,
    /// The estimates with their keys.
    parameters: serde_json::Map<String, serde_json::Value>,
}

/// How far it came.
enum Done {
    /// The motor could not be found.
    Named(Box<EscalationResult>),
    Run(Box<Whole>),
}

struct Whole {
    plan: Plan,
    recorded: Recorded,
    escalation: Option<EscalationResult>,
    /// What the bench file says about the motor.
    plate: Motor,
}

pub(super) fn execute(mut arguments: Arguments) -> Result<(), Failure> {
    arguments.live.escalate = arguments.unknown.escalate;
    let (strings, intents) = Strings::new()?;
    if arguments.live.is_headless() {
        return record(&arguments, &strings).and_then(|done| finish(arguments.live.json, &done));
    }
    let json = arguments.live.json;
    let (done, _) = screen::watch(strings, intents, None, move |strings| {
        record(&arguments, strings)
    })?;
    finish(json, &done)
}

fn record(arguments: &Arguments, strings: &Strings) -> Result<Done, Failure> {
    let mut rig = Rig::open(&arguments.live, arguments.run_seed, Purpose::Voltages)?;
    let headless = arguments.live.is_headless();
    let report = rig.check(strings)?;
    if headless {
        for item in &report.items {
            output::message(&format!("{:<18} {}", item.name, item.text));
        }
    }
    let mut escalation = None;
    if rig.escalates {
        let result = escalate(&mut rig, strings, |line| {
            if headless {
                output::message(line);
            }
        })?;
        if result.ending.is_some() {
            return Ok(Done::Named(Box::new(result)));
        }
        escalation = Some(result);
    }
    let seed = arguments.run_seed.unwrap_or(rig.bench.runs.fit);
    let plan = rig.plan(seed)?;
    let name = rig.bench.name.clone();
    let recorded = rig.record(&name, seed, strings)?;
    let nameplate = rig.nameplate()?.motor();
    let whole = Whole {
        plan,
        recorded,
        escalation,
        plate: rig.plate.clone(),
    };
    write_results(&whole, &nameplate)?;
    Ok(Done::Run(Box::new(whole)))
}

/// Model and result beside the samples: whatever was measured is kept, also after a trip.
fn write_results(whole: &Whole, nameplate: &Motor) -> Result<(), Failure> {
    let recorded = &whole.recorded;
    let folder = &recorded.folder;
    folder.write(
        RunFile::Model,
        &online_model(&recorded.summary, nameplate, folder.path()).to_toml(),
    )?;
    recorded.write_result(&result(whole))?;
    folder.write(
        RunFile::Report,
        &pages::run(recorded, Some(&whole.plan), nameplate, None)?,
    )?;
    Ok(())
}

/// The baseline with what the on-line estimators settled on; the nameplate's value where they did not.
fn online_model(summary: &RunSummary, nameplate: &Motor, folder: &std::path::Path) -> ModelFile {
    let mut file = ModelFile {
        model: Model::baseline(nameplate.clone()),
        ..ModelFile::default()
    };
    file.history.fitted_on = vec![folder.display().to_string()];
    for estimate in &summary.estimates {
        if let (Verdict::Settled, Some(key), Some(value)) = (
            estimate.verdict,
            MotorKey::from_key(&estimate.key),
            estimate.value,
        ) {
            file.model.motor.set(key, value);
            if let Some(std) = estimate.std {
                file.history.fitted.push(FittedValue {
                    key: estimate.key.clone(),
                    std,
                });
            }
        }
    }
    file
}

fn result(whole: &Whole) -> RunResult<'_> {
    let recorded = &whole.recorded;
    let estimates = recorded.summary.estimates.iter();
    RunResult {
        folder: recorded.folder.path().display().to_string(),
        plan: &whole.plan,
        summary: &recorded.summary,
        escalation: whole.escalation.as_ref(),
        // The escalation's fit is the sharper one; where there was none, what was found on line.
        nameplate: match &whole.escalation {
            Some(escalation) => escalation.nameplate.clone(),
            None => compared(&whole.plate, &recorded.summary.estimates),
        },
        parameters: estimates
            .map(|e| (e.key.clone(), serde_json::to_value(e).unwrap_or_default()))
            .collect(),
    }
}

fn finish(json: bool, done: &Done) -> Result<(), Failure> {
    match done {
        Done::Named(escalation) => {
            output::result(escalation.as_ref(), json, EscalationResult::text)?;
            failure(escalation).map_or(Ok(()), Err)
        }
        Done::Run(whole) => {
            output::result(&result(whole), json, |result| {
                let mut text = text(&whole.recorded);
                if let Some(escalation) = &whole.escalation {
                    text.push_str(&escalation.text());
                } else if let Some(comparison) = &result.nameplate {
                    text.push_str(&comparison.text());
                }
                text
            })?;
            whole.recorded.failure().map_or(Ok(()), Err)
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

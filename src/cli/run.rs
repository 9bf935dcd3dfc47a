//! `run`: excite, log, and identify on line, with the live screen or without.

use std::fmt::Write as _;

use serde::Serialize;

use super::failure::Failure;
use super::live::{LiveArguments, Recorded, Rig, Strings};
use super::{output, pages, screen};
use crate::bench::{Plan, RunSummary};
use crate::plant::{FittedValue, Model, ModelFile, Motor, MotorKey};
use crate::recording::RunFile;
use crate::sample::Verdict;

/// Excite the motor, record the run and identify on line; live screen unless --headless
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench run                            the emulated motor, on the live screen
  drivebench run bench.toml --port /dev/ttyUSB0 --hardware --headless")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    /// Which run of the bench file's [runs]: the seed of the sequence's random parts
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
    /// The estimates with their keys.
    parameters: serde_json::Map<String, serde_json::Value>,
}

pub(super) fn execute(arguments: Arguments) -> Result<(), Failure> {
    let (strings, intents) = Strings::new()?;
    if arguments.live.is_headless() {
        return record(&arguments, &strings).and_then(|done| finish(arguments.live.json, &done));
    }
    let json = arguments.live.json;
    let done = screen::watch(strings, intents, None, move |strings| {
        record(&arguments, strings)
    })?;
    finish(json, &done)
}

fn record(arguments: &Arguments, strings: &Strings) -> Result<(Plan, Recorded), Failure> {
    let mut rig = Rig::open(&arguments.live)?;
    let report = rig.check()?;
    if arguments.live.is_headless() {
        for item in &report.items {
            output::message(&format!("{:<18} {}", item.name, item.text));
        }
    }
    let seed = arguments.run_seed.unwrap_or(rig.bench.runs.fit);
    let plan = rig.plan(seed)?;
    let name = rig.bench.name.clone();
    let recorded = rig.record(&name, seed, strings)?;
    write_results(&recorded, &plan, &rig.bench.motor.motor())?;
    Ok((plan, recorded))
}

/// Model and result beside the samples: whatever was measured is kept, also after a trip.
fn write_results(recorded: &Recorded, plan: &Plan, nameplate: &Motor) -> Result<(), Failure> {
    let folder = &recorded.folder;
    folder.write(
        RunFile::Model,
        &online_model(&recorded.summary, nameplate, folder.path()).to_toml(),
    )?;
    recorded.write_result(&result(plan, recorded))?;
    folder.write(RunFile::Report, &pages::run(recorded, plan, nameplate)?)?;
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

fn result<'a>(plan: &'a Plan, recorded: &'a Recorded) -> RunResult<'a> {
    let estimates = recorded.summary.estimates.iter();
    RunResult {
        folder: recorded.folder.path().display().to_string(),
        plan,
        summary: &recorded.summary,
        parameters: estimates
            .map(|e| (e.key.clone(), serde_json::to_value(e).unwrap_or_default()))
            .collect(),
    }
}

fn finish(json: bool, (plan, recorded): &(Plan, Recorded)) -> Result<(), Failure> {
    output::result(&result(plan, recorded), json, |_| text(recorded))?;
    recorded.failure().map_or(Ok(()), Err)
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

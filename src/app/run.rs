//! The order of work of a run: check, find the motor where it is unknown, plan, record, keep what was found.

use std::path::Path;

use serde::Serialize;
use serde_json::{Map, Value};

use super::controls::Controls;
use super::failure::{Failure, LINK, NOT_IDENTIFIABLE};
use super::recorded::Recorded;
use super::rig::{OpenRig, Rig, RigOptions};
use super::{output, pages};
use crate::bench::{Plan, RunSummary};
use crate::drive::offer::Purpose;
use crate::identification::escalation::Ending;
use crate::identification::nameplate::Comparison;
use crate::plant::{FittedValue, Model, ModelFile, Motor, MotorKey};
use crate::recording::RunFile;
use crate::sample::Verdict;
use crate::workflow::{Escalate, EscalationResult, compared, scaled_sentence};

/// An end between two runs.
pub(super) const BETWEEN_RUNS: &str =
    "interrupted; nothing is energised, what was recorded is kept";

/// What is asked of a run.
pub struct RunRequest {
    pub rig: RigOptions,
    /// Seed of the sequence's random parts; `None`: `runs.fit` of the bench file.
    pub run_seed: Option<u64>,
}

/// The result as JSON.
#[derive(Serialize)]
pub(crate) struct RunResult<'a> {
    folder: String,
    plan: &'a Plan,
    #[serde(flatten)]
    summary: &'a RunSummary,
    /// How an unknown motor was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    escalation: Option<&'a EscalationResult>,
    /// What was found against the plate, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) nameplate: Option<Comparison>,
    /// The estimates with their keys.
    parameters: Map<String, Value>,
}

/// How far it came.
pub enum RunDone {
    /// The motor could not be found.
    Named(Box<EscalationResult>),
    Run(Box<Whole>),
}

pub struct Whole {
    plan: Plan,
    pub recorded: Recorded,
    pub(crate) escalation: Option<EscalationResult>,
    /// What the bench file says about the motor.
    plate: Motor,
}

/// Makes one run over the rig that `open` gives.
///
/// # Errors
/// What stood in the way of a run; how a run that began went is in its record.
pub fn run(request: RunRequest, open: OpenRig, controls: &Controls) -> Result<RunDone, Failure> {
    let run_seed = request.run_seed;
    let mut rig = open(request.rig, run_seed, Purpose::Voltages)?;
    let headless = rig.asked.headless;
    let report = rig.check(controls)?;
    if headless {
        for item in &report.items {
            output::message(&format!("{:<18} {}", item.name, item.text));
        }
    }
    let mut escalation = None;
    if rig.escalates {
        let result = escalate(&mut rig, controls, |line| {
            if headless {
                output::message(line);
            }
        })?;
        if result.ending.is_some() {
            return Ok(RunDone::Named(Box::new(result)));
        }
        escalation = Some(result);
    }
    let seed = run_seed.unwrap_or(rig.bench.runs.fit);
    let plan = rig.plan(seed)?;
    let name = rig.bench.name.clone();
    let recorded = rig.record(&name, seed, controls)?;
    let nameplate = rig.nameplate()?.motor();
    let mut whole = Whole {
        plan,
        recorded,
        escalation,
        plate: rig.plate.clone(),
    };
    write_results(&mut whole, &nameplate);
    Ok(RunDone::Run(Box::new(whole)))
}

/// Model and result beside the samples: whatever was measured is kept, also after a trip.
fn write_results(whole: &mut Whole, nameplate: &Motor) {
    let recorded = &mut whole.recorded;
    let model = online_model(&recorded.summary, nameplate, recorded.folder.path());
    recorded.write(RunFile::Model, &model.to_toml());
    let result = serde_json::to_value(run_result(whole)).unwrap_or_default();
    whole.recorded.write_result(&result);
    match pages::run(&whole.recorded, Some(&whole.plan), nameplate, None) {
        Ok(page) => drop(whole.recorded.write(RunFile::Report, &page)),
        Err(failure) => output::message(&format!("no report: {}", failure.headline())),
    }
}

/// The baseline with what the on-line estimators settled on; the nameplate's value where they did not.
fn online_model(summary: &RunSummary, nameplate: &Motor, folder: &Path) -> ModelFile {
    let mut file = ModelFile {
        model: Model::baseline(nameplate.clone()),
        ..ModelFile::default()
    };
    file.history.fitted_on = vec![folder.display().to_string()];
    for estimate in &summary.estimates {
        let settled = estimate
            .value
            .filter(|_| estimate.verdict == Verdict::Settled);
        if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), settled) {
            file.model.motor.set(key, value);
            let key = estimate.key.clone();
            let fitted = estimate.std.map(|std| FittedValue { key, std });
            file.history.fitted.extend(fitted);
        }
    }
    file
}

/// What a run has to say, for its folder and for whoever asked for it.
pub(crate) fn run_result(whole: &Whole) -> RunResult<'_> {
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

/// Runs the stages until the motor is found or the reason why not is named. With a motor the rig goes on with its values
/// as nameplate. `tell` gets a line for each stage.
pub(crate) fn escalate(
    rig: &mut Rig,
    controls: &Controls,
    mut tell: impl FnMut(&str),
) -> Result<EscalationResult, Failure> {
    let mut workflow = Escalate::new(&rig.bench);
    let mut number = 0;
    while let Some(stage) = workflow.stage().cloned() {
        if controls.is_stopped() {
            return Err(Failure::interrupted(BETWEEN_RUNS));
        }
        number += 1;
        tell(&format!(
            "{} {number}: up to {:.3} V ({})",
            stage.kind.name(),
            stage.peak_v,
            stage.reason
        ));
        let name = format!("{}-escalation-{number:02}", rig.bench.name);
        let mut recorded = rig.record_stage(&name, &stage, number > 1, controls)?;
        if let Some(failure) = recorded.run_failure() {
            return Err(failure);
        }
        let folder = recorded.folder.path().display().to_string();
        let record = workflow.ran(&recorded.load()?.run, Some(folder))?;
        recorded.write_result(&record);
        tell(&record.stage.line);
    }
    let mut result = workflow.result();
    if let Some(found) = result.found(&rig.bench) {
        tell(&result.sentence);
        let claimed = !rig.bench.motor.is_unknown();
        if let Some(refusal) = result.scale(&rig.bench, rig.drive_current_limit_a())? {
            let headline = format!("plan refused for the motor that was found: {refusal}");
            return Err(Failure::usage(headline, refusal.help()));
        }
        let nothing = || Failure::internal("a motor was found and nothing planned");
        let scaled = result.scaled.as_ref().ok_or_else(nothing)?;
        let nameplate = result.nameplate.as_ref();
        let fits = nameplate.is_none_or(|comparison| comparison.fits);
        if let Some(refusal) = scaled.refusal.as_ref().filter(|_| claimed && !fits) {
            // The plate is believed by whoever wrote the sequence: run as written it would be too much.
            if let Some(comparison) = nameplate {
                comparison.text().lines().for_each(&mut tell);
            }
            return Err(Failure::usage(
                format!(
                    "the nameplate does not fit, and with the motor that was found the sequence is refused: {refusal}"
                ),
                "correct [motor], or set motor.unknown = true to have the sequence made smaller",
            ));
        }
        tell(&scaled_sentence(scaled));
        rig.bench = scaled.bench.clone();
        rig.bench.motor = (&found).into();
    }
    Ok(result)
}

/// The failure for what stands in the way of a motor: it is the device.
pub fn escalation_failure(result: &EscalationResult) -> Option<Failure> {
    let ending = result.ending.as_ref()?;
    let status = match ending {
        Ending::NotIdentified { .. } => NOT_IDENTIFIABLE,
        _ => LINK,
    };
    Some(Failure::with_help(status, ending.sentence(), ending.help()))
}

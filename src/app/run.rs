//! The order of work of a run: check, find the motor where it is unknown, plan, record, keep what was found.

use serde::Serialize;

use super::escalation::escalate;
use super::failure::Failure;
use super::recorded::Recorded;
use super::rig::{OpenRig, RigOptions};
use super::strings::Strings;
use super::{output, pages};
use crate::bench::{Plan, RunSummary};
use crate::drive::offer::Purpose;
use crate::identification::nameplate::Comparison;
use crate::plant::{FittedValue, Model, ModelFile, Motor, MotorKey};
use crate::recording::RunFile;
use crate::sample::Verdict;
use crate::workflow::{EscalationResult, compared};

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
    parameters: serde_json::Map<String, serde_json::Value>,
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
pub fn run(request: RunRequest, open: OpenRig, strings: &Strings) -> Result<RunDone, Failure> {
    let run_seed = request.run_seed;
    let mut rig = open(request.rig, run_seed, Purpose::Voltages)?;
    let headless = rig.is_headless();
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
            return Ok(RunDone::Named(Box::new(result)));
        }
        escalation = Some(result);
    }
    let seed = run_seed.unwrap_or(rig.bench.runs.fit);
    let plan = rig.plan(seed)?;
    let name = rig.bench.name.clone();
    let recorded = rig.record(&name, seed, strings)?;
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

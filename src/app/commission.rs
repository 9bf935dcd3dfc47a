//! The order of work of a commissioning: the tasks of its state machine, carried out over a rig until it is finished.

use std::fmt::Write as _;

use super::controls::Controls;
use super::failure::Failure;
use super::files::model_file;
use super::recorded::Recorded;
use super::rig::{OpenRig, Rig, RigOptions};
use super::run::{BETWEEN_RUNS, escalate, escalation_failure};
use super::{output, pages, progress, signals};
use crate::bench::burst_part;
use crate::drive::offer::Purpose;
use crate::identification::nameplate::Comparison;
use crate::plant::{FileHistory, Model, Scenario};
use crate::recording::RunFile;
use crate::workflow::{
    Commission, CommissionResult, Discovery, EscalationResult, Progress, Role, RunRecord, Task,
};

/// The run that would tell what these do not, and how to make it.
fn next_run(result: &CommissionResult, records: &[Recorded]) -> Option<String> {
    let next = result.diagnosis.next_experiment.as_ref()?;
    let mut text = format!("next: {}\n", next.sentence);
    if let (Some(_), Some(record)) = (&next.bench, records.first()) {
        let path = record.folder.file(RunFile::NextBench);
        let _ = writeln!(text, "      drivebench run {}", path.display());
        let diagnose = next.diagnose_command(record.folder.path());
        let _ = writeln!(text, "      {diagnose}");
    }
    Some(text)
}

/// What the loop leaves behind.
pub struct CommissionDone {
    pub result: CommissionResult,
    pub text: String,
    pub discovery: Option<Discovery>,
    /// Why the record of a run could not be kept, where that is so.
    pub unkept: Option<Failure>,
}

/// Carries the loop's tasks out until it is finished.
///
/// # Errors
/// What stood in the way; a trip, a lost drive or an interruption of a run among it.
pub fn commission(
    options: RigOptions,
    open: OpenRig,
    controls: &Controls,
    mut publish: impl FnMut(&Progress),
) -> Result<CommissionDone, Failure> {
    let mut rig = open(options, None, Purpose::Voltages)?;
    let mut workflow = Commission::new(Model::baseline(rig.plate.clone()), rig.escalates);
    if let Some(emulator) = &rig.emulator {
        let hidden = emulator.hidden.iter();
        workflow.set_truth(hidden.map(|effect| effect.id().to_owned()).collect());
    }
    workflow.set_bench(rig.bench.clone());
    let mut records: Vec<Recorded> = Vec::new();
    publish(&workflow.progress());
    while workflow.task() != Task::Finished {
        if controls.is_stopped() {
            return Err(Failure::interrupted(BETWEEN_RUNS));
        }
        if let Err(failure) = step(
            &mut workflow,
            &mut rig,
            &mut records,
            controls,
            &mut publish,
        ) {
            workflow.failed(failure.headline());
            publish(&workflow.progress());
            return Err(failure);
        }
        publish(&workflow.progress());
    }
    let result = workflow
        .result()
        .cloned()
        .ok_or_else(|| Failure::internal("the loop ended without a result"))?;
    let mut text = pages::commission(workflow.scenarios(), &result, &rig, &records)?.text;
    let burst = result.burst.as_ref();
    let parts = [
        result.escalation.as_ref().map(EscalationResult::text),
        burst.map(|burst| format!("burst: {}\n", burst.text())),
        result.nameplate.as_ref().map(Comparison::text),
        next_run(&result, &records),
    ];
    for part in parts.into_iter().flatten() {
        text.push('\n');
        text.push_str(&part);
    }
    let mut progress = workflow.progress();
    progress.report = text.lines().map(str::to_owned).collect();
    publish(&progress);
    Ok(CommissionDone {
        result,
        text,
        discovery: workflow.discovery().cloned(),
        unkept: records.iter().find_map(Recorded::record_failure),
    })
}

fn step(
    workflow: &mut Commission,
    rig: &mut Rig,
    records: &mut Vec<Recorded>,
    controls: &Controls,
    publish: &mut impl FnMut(&Progress),
) -> Result<(), Failure> {
    let runs = rig.bench.runs;
    match workflow.task() {
        Task::Check => workflow.checked(&rig.check(controls)?),
        Task::Escalate => {
            let result = escalate(rig, controls, |line| {
                workflow.escalating(line);
                publish(&workflow.progress());
            })?;
            if let Some(failure) = escalation_failure(&result) {
                return Err(failure);
            }
            workflow.escalated(rig.nameplate()?.motor(), result);
        }
        Task::Plan => {
            for seed in [runs.select, runs.confirm, runs.repeat] {
                rig.plan(seed)?;
            }
            workflow.planned(&rig.plan(runs.fit)?);
        }
        Task::Record(role) => {
            let seed = match role {
                Role::Fit => runs.fit,
                Role::Select => runs.select,
                Role::Confirm => runs.confirm,
                Role::Repeat => runs.repeat,
            };
            let name = format!("{}-{}", rig.bench.name, role.name());
            if role == Role::Fit && runs.burst_at.is_none() && rig.records_bursts() {
                rig.bench.runs.burst_at = burst_part(&rig.bench, &rig.nameplate()?);
            }
            let mut recorded = rig.record(&name, seed, controls)?;
            rig.bench.runs.burst_at = runs.burst_at;
            if let Some(failure) = recorded.run_failure() {
                return Err(failure);
            }
            let loaded = recorded.load()?;
            recorded.forget();
            let record = RunRecord {
                role: role.name(),
                folder: Some(recorded.folder.path().display().to_string()),
                rows: recorded.summary.rows,
                rate_hz: recorded.summary.timing.rate_achieved_hz,
                missed_cycles: recorded.summary.timing.missed_cycles,
            };
            match recorded.burst().filter(|_| role == Role::Fit) {
                Some((path, Ok(burst))) => workflow.captured(burst, path.display().to_string()),
                // An extra: the loop goes on without it.
                Some((_, Err(failure))) => {
                    output::message(&format!("burst not used: {}", failure.headline()));
                }
                None => {}
            }
            let scenario = Scenario::from_run(&loaded.run)?;
            workflow.recorded(role, scenario, record, recorded.summary.estimates.clone());
            records.push(recorded);
        }
        Task::Analyse => {
            // Nothing is energised and everything recorded is on the disk. Beside a screen the signals are the screen's.
            let _endable = if rig.asked.headless {
                signals::endable()?
            } else {
                signals::leavable()
            };
            workflow.analyse(|now| publish(&now), &progress::diagnosis)?;
        }
        Task::Save => {
            let line = save(workflow, rig, records)?;
            workflow.saved(line);
        }
        Task::Finished => {}
    }
    Ok(())
}

/// Model, result and report into every run folder of the loop.
fn save(workflow: &Commission, rig: &Rig, records: &mut [Recorded]) -> Result<String, Failure> {
    let nothing = || Failure::internal("nothing to save");
    let result = workflow.result().ok_or_else(nothing)?;
    let (found, none) = (&result.diagnosis, FileHistory::default());
    let first = records.first().map(|record| record.folder.path());
    let run = first.map(|folder| folder.display().to_string());
    let file = model_file(
        &found.model,
        &none,
        run,
        &result.ladder,
        found.noise_floor_from,
    );
    let page = pages::commission(workflow.scenarios(), result, rig, records)?.html;
    let next = &result.diagnosis.next_experiment;
    let bench = next.as_ref().and_then(|next| next.bench.as_ref());
    if let (Some(text), Some(record)) = (bench, records.first_mut()) {
        record.write(RunFile::NextBench, text);
    }
    let mut reports = Vec::new();
    for record in records {
        record.write(RunFile::Model, &file.to_toml());
        record.write_result(result);
        reports.extend(record.write(RunFile::Report, &page));
    }
    let report = reports.first().map(|path| path.display().to_string());
    Ok(report.unwrap_or_else(|| "not written".to_owned()))
}

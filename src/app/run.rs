//! The order of work of a run: check, find the motor where it is unknown, plan, record, keep what was found; and of a
//! commissioning: the tasks of its state machine, carried out over a rig until it is finished.

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;
use serde_json::{Map, Value};

use super::controls::Controls;
use super::failure::{Failure, LINK, NOT_IDENTIFIABLE};
use super::files::Recorded;
use super::files::model_file;
use super::output::quoted;
use super::rig::{OpenRig, Rig, RigOptions};
use super::{output, pages, progress, signals};
use crate::report::{Document, tables};
use crate::workflow::{
    BurstResult, Called, Commission, CommissionResult, Discovery, Escalate, EscalationResult,
    Progress, Role, RunRecord, Task, compared, scaled_sentence,
};
use drivebench_bench::recording::RunFile;
use drivebench_bench::{CheckReport, Plan, RunSummary, Snapshot, burst_part};
use drivebench_diagnose::{Evidence, Score};
use drivebench_emulator::mystery::TrueEffect;
use drivebench_identify::escalation::Ending;
use drivebench_identify::nameplate::Comparison;
use drivebench_identify::noise::FloorSource;
use drivebench_identify::start;
use drivebench_link::offer::Purpose;
use drivebench_model::plant::{
    FileHistory, FittedValue, Model, ModelFile, Motor, MotorKey, Scenario,
};
use drivebench_model::sample::Verdict;

/// An end between two runs.
pub(super) const BETWEEN_RUNS: &str =
    "interrupted; nothing is energised, what was recorded is kept";

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
    pub(super) plate: Motor,
    /// What was found against it, where it says anything.
    nameplate: Option<Comparison>,
}

/// Makes one run over the rig that `open` gives. `run_seed`: that of the sequence's random parts; without it `runs.fit` of the
/// bench file.
///
/// # Errors
/// What stood in the way of a run; how a run that began went is in its record.
pub fn run(
    options: RigOptions,
    run_seed: Option<u64>,
    open: OpenRig,
    controls: &Controls,
) -> Result<RunDone, Failure> {
    let mut rig = open(options, run_seed, Purpose::Voltages)?;
    let headless = rig.asked.headless;
    let report = rig.check(controls)?;
    if headless {
        tell_checks(&report);
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
        nameplate: None,
    };
    whole.nameplate = match &whole.escalation {
        // The escalation's fit is the sharper one; where there was none, what was found on line.
        Some(escalation) => escalation.nameplate.clone(),
        None => compared(&whole.plate, &whole.recorded.summary.estimates),
    };
    judge_plate(&mut whole, &nameplate);
    write_results(&mut whole, &nameplate);
    Ok(RunDone::Run(Box::new(whole)))
}

/// A drive that has answered every check before the first move.
#[derive(Serialize)]
pub struct Connection {
    link: String,
    /// Where its profile comes from, and how far it may be believed.
    profile: String,
    #[serde(flatten)]
    checks: CheckReport,
    /// What the bench file asks for, Hz.
    rate_hz: f64,
    /// What the sequence would do to the motor of the bench file; `null` where that is not known.
    plan: Option<Plan>,
}

/// Carries out every check before the first move, predicts the sequence, and leaves the drive stopped: nothing has moved.
///
/// # Errors
/// The check that is not passed, or why the sequence would be refused.
pub fn connect(
    options: RigOptions,
    run_seed: Option<u64>,
    open: OpenRig,
    controls: &Controls,
) -> Result<Connection, Failure> {
    let mut rig = open(options, run_seed, Purpose::Voltages)?;
    let checks = rig.check_at_rest(controls)?;
    let seed = run_seed.unwrap_or(rig.bench.runs.fit);
    let is_known = rig.bench.nameplate().is_some();
    let plan = is_known.then(|| rig.plan(seed)).transpose()?;
    Ok(Connection {
        link: rig.way.link.name().to_string(),
        profile: rig.profile.provenance(),
        rate_hz: rig.bench.link.rate_hz,
        checks,
        plan,
    })
}

impl Connection {
    /// For a person: each check, and what a run would do.
    pub fn text(&self) -> String {
        let line = |name: &str, text: &str| format!("{name:<18} {text}");
        let mut lines = vec![line("link", &self.link), line("profile", &self.profile)];
        lines.extend(
            self.checks
                .items
                .iter()
                .map(|item| line(item.name, &item.text)),
        );
        let plan = self.plan.as_ref().map_or_else(
            || {
                "the motor is not known: `drivebench run` finds it from small steps first"
                    .to_owned()
            },
            |plan| {
                format!(
                    "`drivebench run` would take {:.1} s and is within every limit",
                    plan.duration_s
                )
            },
        );
        lines.push(line("sequence", &plan));
        lines.push("ready: the drive is stopped, and nothing has moved".to_owned());
        lines.join("\n")
    }
}

/// Takes back that the plate does not fit where the model that says so misses something on this run: what it misses is in
/// its values, and a brush drop looks like another motor. With what is missing named, the plate is judged anew. A model
/// that cannot be held against its run judges nothing either.
fn judge_plate(whole: &mut Whole, nameplate: &Motor) {
    let Some(comparison) = whole.nameplate.as_mut().filter(|found| !found.fits) else {
        return;
    };
    let left = || -> Result<Option<f64>, Failure> {
        let loaded = whole.recorded.load()?;
        let run = Scenario::from_run(&loaded.run)?;
        let start = Model::baseline(nameplate.clone());
        let start = start::complete(&start, &run)?;
        let (evidence, fit) = Evidence::new(run, None, None).with_baseline(&start)?;
        // A model that holds where the excitation is slow may not hold where it is fast.
        let parts = [&evidence.training, &evidence.holdout];
        let errors =
            parts.map(|part| Score::of(&fit.model, part, &evidence.noise).map(|score| score.nrms));
        let [fitted, held_out] = errors;
        let error = fitted?.max(held_out?);
        let is_explained = evidence.noise.is_at_the_floor(error);
        Ok((evidence.noise.source != FloorSource::None && !is_explained).then_some(error))
    };
    match left() {
        Ok(Some(times)) => comparison.doubt(format!(
            "not judged: the five-parameter model leaves {times:.1} times the noise, and what it misses may be in these values; \
             drivebench diagnose names it"
        )),
        Ok(None) => {}
        Err(error) => comparison.doubt(format!(
            "not judged: the five-parameter model cannot be held against this run ({})",
            error.headline()
        )),
    }
}

/// Model and result beside the samples: whatever was measured is kept, also after a trip.
fn write_results(whole: &mut Whole, nameplate: &Motor) {
    let recorded = &mut whole.recorded;
    let model = online_model(&recorded.summary, nameplate, recorded.folder.path());
    recorded.write(RunFile::Model, &model.to_toml());
    let result = serde_json::to_value(run_result(whole)).unwrap_or_default();
    whole.recorded.write_result(&result);
    pages::write_run(&mut whole.recorded, Some(&whole.plan), nameplate, None);
}

/// Each check and what came of it, for who reads along.
pub(super) fn tell_checks(report: &CheckReport) {
    for item in &report.items {
        output::message(&format!("{:<18} {}", item.name, item.text));
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
        nameplate: whole.nameplate.clone(),
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
                tell(&comparison.verdict());
                comparison.rows.iter().for_each(|row| tell(&row.sentence));
                comparison
                    .causes
                    .iter()
                    .for_each(|cause| tell(&format!("likely: {cause}")));
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

/// What goes on from a commissioning, and its page.
fn go_on(document: &mut Document, result: &CommissionResult, rig: &Rig, records: &[Recorded]) {
    let Some(first) = records.first() else { return };
    let words = rig.asked.words.as_str();
    let (folder, file) = (first.folder.path(), |file| quoted(&first.folder.file(file)));
    let next = result.diagnosis.next_experiment.as_ref();
    if next.is_some_and(|next| next.bench.is_some()) {
        document.go_on(format!("drivebench run {}", file(RunFile::NextBench)));
        // A run that was not made judges nothing.
        let judging = ["--holdout", "--confirm"].iter().zip(&records[1..]);
        let judging =
            judging.map(|(option, run)| format!(" {option} {}", quoted(run.folder.path())));
        let judging: String = judging.collect();
        document.go_on(format!(
            "drivebench diagnose {} --model baseline{judging} --with NEW_RUN",
            quoted(folder)
        ));
    }
    let model = file(RunFile::Model);
    document.go_on(format!("drivebench speed{words} --model {model}"));
    document.ends_with(first.folder.file(RunFile::Report).display().to_string());
}

/// What the loop leaves behind.
pub struct CommissionDone {
    pub result: CommissionResult,
    pub document: Document,
    /// As the screen has it at the end: the steps that can follow among it.
    pub progress: Progress,
    /// What the screen saw last of the bench.
    pub last: Arc<Snapshot>,
    pub discovery: Option<Discovery>,
    /// Why the record of a run could not be kept, where that is so.
    pub unkept: Option<Failure>,
}

/// Carries the loop's tasks out until it is finished; `called` is for the commands of its steps.
///
/// # Errors
/// What stood in the way; a trip, a lost drive or an interruption of a run among it.
pub fn commission(
    options: RigOptions,
    called: Called,
    open: OpenRig,
    controls: &Controls,
    mut publish: impl FnMut(&Progress),
) -> Result<CommissionDone, Failure> {
    let mut rig = open(options, None, Purpose::Voltages)?;
    // A machine that changes while it runs is more than what it hides: an answer to it is not scored.
    let emulator = rig.way.emulator.as_ref();
    let steady = emulator.filter(|emulator| emulator.changes.is_empty());
    let truth = steady.map(|emulator| emulator.hidden.iter().map(TrueEffect::from).collect());
    let (plate, bench) = (Model::baseline(rig.plate.clone()), rig.bench.clone());
    let mut workflow = Commission::new(plate, rig.escalates, bench, truth, called);
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
    let mut document = pages::commission(workflow.scenarios(), &result, &rig, &records)?;
    if let Some(found) = &result.escalation {
        found.put("found by", &mut document);
    }
    let burst = result.burst.as_ref().map(BurstResult::text);
    let samples = burst.as_ref().and_then(|text| text.lines().next());
    document.say("burst", samples, 0);
    tables::plate(&mut document, result.nameplate.as_ref());
    go_on(&mut document, &result, &rig, &records);
    let mut progress = workflow.progress();
    progress.report = Some(Arc::new(document.clone()));
    publish(&progress);
    Ok(CommissionDone {
        result,
        document,
        progress,
        last: controls.snapshots.latest(),
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
        Task::Check => {
            let report = rig.check(controls);
            if let (Some(identity), Err(_)) = (&rig.answered, &report) {
                workflow.answered(&identity.name());
            }
            workflow.checked(&report?);
        }
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
            workflow.saved(&line);
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
    let page = pages::commission(workflow.scenarios(), result, rig, records)?.html();
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

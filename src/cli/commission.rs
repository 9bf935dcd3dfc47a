//! `commission`: the whole loop, guided; the screen and the headless run drive the same state machine.

use std::fmt::Write as _;
use std::path::Path;

use super::discovery::{self, Shown};
use super::escalate::{UnknownMotor, escalate, failure};
use super::failure::{Failure, INTERNAL, INTERRUPTED};
use super::live::{LiveArguments, Rig, Strings};
use super::recorded::Recorded;
use super::{data, interrupt, model_output, output, pages, progress, screen};
use crate::bench::burst_part;
use crate::drive::offer::Purpose;
use crate::identification::nameplate::Comparison;
use crate::plant::{FileHistory, Model, ModelFile, Scenario};
use crate::recording::{FIRST_CAPTURE, RunFile};
use crate::tui::Exit;
use crate::workflow::{
    Commission, CommissionResult, Discovery, EscalationResult, Progress, ProgressCell, Role,
    RunRecord, StepState, Task,
};

/// The whole loop: check, plan, excite, identify, compare, name the missing effect, add it, report
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench commission --headless                       the emulated motor with a hidden effect
  drivebench commission --headless --emulator zk-22fc-plain   the same motor without one
  drivebench commission bench.toml --port /dev/ttyUSB0   a real drive, on the screen")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    unknown: UnknownMotor,
}

pub(super) fn execute(mut arguments: Arguments) -> Result<(), Failure> {
    arguments.live.escalate = arguments.unknown.escalate;
    let (strings, intents) = Strings::new()?;
    if arguments.live.is_headless() {
        let mut told = Told::default();
        let shown = progress::begin("commission");
        let done = commission(&arguments.live, &strings, |progress| told.tell(progress))?;
        drop(shown);
        return finish(arguments.live.json, &done.result, &done.text);
    }
    let (json, progress) = (arguments.live.json, ProgressCell::default());
    let shown = progress.clone();
    let (done, exit) = screen::watch(strings, intents, Some(shown), move |strings| {
        commission(&arguments.live, strings, |latest| {
            progress.publish(latest.clone());
        })
    })?;
    let by_hand = done.discovery.filter(|_| exit == Exit::Diagnosis);
    if let Some(discovery) = by_hand {
        let runs = &done.result.runs;
        let shown = Shown {
            title: "the runs of this commissioning".to_owned(),
            guess_first: false,
            fitted_on: runs
                .first()
                .and_then(|run| run.folder.clone())
                .unwrap_or_default(),
            history: FileHistory::default(),
            output: None,
        };
        let left = discovery::show(discovery, shown)?;
        // However it was left: the result of the loop is there all the same.
        finish(json, &done.result, &done.text)?;
        if left.is_interrupted() {
            return Err(Failure::new(
                INTERRUPTED,
                "interrupted in the diagnosis by hand",
            ));
        }
        return Ok(());
    }
    finish(json, &done.result, &done.text)
}

/// The run that would tell what these do not, and how to make it.
fn next_run(result: &CommissionResult, records: &[Recorded]) -> Option<String> {
    let next = result.diagnosis.next_experiment.as_ref()?;
    let mut text = format!("next: {}\n", next.sentence);
    if let (Some(_), Some(record)) = (&next.bench, records.first()) {
        let path = record.folder.file(RunFile::NextBench);
        let _ = writeln!(text, "      drivebench run {}", path.display());
        let _ = writeln!(
            text,
            "      {}",
            next.diagnose_command(record.folder.path())
        );
    }
    Some(text)
}

/// What the loop leaves behind.
struct Done {
    result: CommissionResult,
    text: String,
    discovery: Option<Discovery>,
}

fn finish(json: bool, result: &CommissionResult, text: &str) -> Result<(), Failure> {
    output::result(result, json, |_| text.to_owned())
}

/// Carries the loop's tasks out until it is finished.
fn commission(
    arguments: &LiveArguments,
    strings: &Strings,
    mut publish: impl FnMut(&Progress),
) -> Result<Done, Failure> {
    let mut rig = Rig::open(arguments, None, Purpose::Voltages)?;
    let mut workflow = Commission::new(Model::baseline(rig.plate.clone()), rig.escalates);
    if let Some(emulator) = &rig.emulator {
        workflow.set_truth(
            emulator
                .hidden
                .iter()
                .map(|effect| effect.id().to_owned())
                .collect(),
        );
    }
    workflow.set_bench(rig.bench.clone());
    let mut records = Vec::new();
    publish(&workflow.progress());
    while workflow.task() != Task::Finished {
        if strings.is_stopped() {
            return Err(Failure::new(
                INTERRUPTED,
                "interrupted; nothing is energised, what was recorded is kept",
            ));
        }
        if let Err(failure) = step(&mut workflow, &mut rig, &mut records, strings, &mut publish) {
            workflow.failed(failure.headline());
            publish(&workflow.progress());
            return Err(failure);
        }
        publish(&workflow.progress());
    }
    let result = workflow
        .result()
        .cloned()
        .ok_or_else(|| Failure::new(INTERNAL, "the loop ended without a result"))?;
    let mut text = pages::commission(workflow.scenarios(), &result, &rig)?.text;
    for part in [
        result.escalation.as_ref().map(EscalationResult::text),
        result
            .burst
            .as_ref()
            .map(|burst| format!("burst: {}\n", burst.text())),
        result.nameplate.as_ref().map(Comparison::text),
        next_run(&result, &records),
    ]
    .into_iter()
    .flatten()
    {
        text.push('\n');
        text.push_str(&part);
    }
    let mut progress = workflow.progress();
    progress.report = text.lines().map(str::to_owned).collect();
    publish(&progress);
    Ok(Done {
        result,
        text,
        discovery: workflow.discovery().cloned(),
    })
}

fn step(
    workflow: &mut Commission,
    rig: &mut Rig,
    records: &mut Vec<Recorded>,
    strings: &Strings,
    publish: &mut impl FnMut(&Progress),
) -> Result<(), Failure> {
    let runs = rig.bench.runs;
    match workflow.task() {
        Task::Check => workflow.checked(&rig.check(strings)?),
        Task::Escalate => {
            let result = escalate(rig, strings, |line| {
                workflow.escalating(line);
                publish(&workflow.progress());
            })?;
            if let Some(failure) = failure(&result) {
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
            let recorded = rig.record(&name, seed, strings)?;
            rig.bench.runs.burst_at = runs.burst_at;
            if let Some(failure) = recorded.failure() {
                return Err(failure);
            }
            // Read back from the disk: what is analysed is what anyone can replay.
            let loaded = data::load(recorded.folder.path(), None)?;
            let record = RunRecord {
                role: role.name(),
                folder: Some(recorded.folder.path().display().to_string()),
                rows: recorded.summary.rows,
                rate_hz: recorded.summary.timing.rate_achieved_hz,
                missed_cycles: recorded.summary.timing.missed_cycles,
            };
            if role == Role::Fit && recorded.summary.capture.is_some() {
                let path = recorded.folder.path().join(FIRST_CAPTURE);
                match burst(&path) {
                    Ok(burst) => workflow.captured(burst, path.display().to_string()),
                    // An extra: the loop goes on without it.
                    Err(failure) => {
                        output::message(&format!("burst not used: {}", failure.headline()));
                    }
                }
            }
            workflow.recorded(
                role,
                Scenario::from_run(&loaded.run)?,
                record,
                recorded.summary.estimates.clone(),
            );
            records.push(recorded);
        }
        Task::Analyse => {
            // Nothing is energised and everything recorded is on the disk; a screen hears the signals itself.
            let _endable = rig.is_headless().then(interrupt::endable).transpose()?;
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

/// The burst as it is kept on the disk.
fn burst(path: &Path) -> Result<Scenario, Failure> {
    Ok(Scenario::from_run(&data::load(path, None)?.run)?)
}

/// Model, result and report into every run folder of the loop.
fn save(workflow: &Commission, rig: &Rig, records: &[Recorded]) -> Result<String, Failure> {
    let result = workflow
        .result()
        .ok_or_else(|| Failure::new(INTERNAL, "nothing to save"))?;
    let fit = &result.diagnosis.model;
    let mut file = ModelFile {
        model: fit.model.clone(),
        ..ModelFile::default()
    };
    file.history.fitted_on = records
        .iter()
        .take(1)
        .map(|record| record.folder.path().display().to_string())
        .collect();
    file.history.fitted = model_output::fitted(&fit.parameters);
    file.history.ladder = result
        .ladder
        .iter()
        .map(|rung| model_output::rung(rung, result.diagnosis.noise_floor_from))
        .collect();
    let page = pages::commission(workflow.scenarios(), result, rig)?.html;
    let next = &result.diagnosis.next_experiment;
    let bench = next.as_ref().and_then(|next| next.bench.as_ref());
    if let (Some(text), Some(record)) = (bench, records.first()) {
        record.folder.write(RunFile::NextBench, text)?;
    }
    let mut reports = Vec::new();
    for record in records {
        let folder = &record.folder;
        folder.write(RunFile::Model, &file.to_toml())?;
        record.write_result(result)?;
        reports.push(folder.write(RunFile::Report, &page)?);
    }
    Ok(reports
        .first()
        .map_or_else(String::new, |path| path.display().to_string()))
}

/// Progress on stderr: each step once when it begins and once with its figure.
#[derive(Default)]
struct Told {
    lines: Vec<(StepState, String)>,
}

impl Told {
    fn tell(&mut self, progress: &Progress) {
        let total = progress.steps.len();
        self.lines
            .resize(total, (StepState::Waiting, String::new()));
        for (index, step) in progress.steps.iter().enumerate() {
            let now = (step.state, step.line.clone());
            if now == self.lines[index] {
                continue;
            }
            let number = index + 1;
            match step.state {
                StepState::Waiting => {}
                StepState::Active => {
                    output::message(&format!("[{number:>2}/{total}] {} ...", step.title));
                    progress::stage(&step.title, 0);
                }
                StepState::Done => output::message(&format!(
                    "[{number:>2}/{total}] {}: {}",
                    step.title, step.line
                )),
                StepState::Failed => {
                    output::message(&format!("[{number:>2}/{total}] {} failed", step.title));
                }
            }
            self.lines[index] = now;
        }
    }
}

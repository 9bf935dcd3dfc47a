//! `commission`: the whole loop, guided. The screen and the headless run drive the same state machine, whose tasks are carried out
//! over a rig until it is finished. On its screen can follow: the run that would tell more, the speed loop with what was found, the
//! diagnosis by hand; then the page of the loop again.
//!
//! ```text
//! commission -> page of the loop -+- x: checks, next-bench.toml, diagnosis of that run -+
//!                  ^              +- l: checks, speed loop with the model that was found +
//!                  |              +- d, v: diagnosis by hand -----------------------------+
//!                  '---------------------------------------------------------------------'
//! ```
//!
//! Each energises anew, from the checks on, and a motor of copper is started by hand again.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::commands::arguments::{LiveArguments, UnknownMotor};
use crate::commands::by_hand::{Shown, Standing};
use crate::commands::evidence::admit_later;
use crate::commands::run::{BETWEEN_RUNS, RunDone, escalate, escalation_failure, run};
use crate::commands::speed::{SpeedRequest, speed};
use crate::commands::{by_hand, pages};
use crate::report::{Document, tables};
use crate::runtime::controls::Controls;
use crate::runtime::ending::{Audience, Left, conduct};
use crate::runtime::failure::{Failure, USAGE};
use crate::runtime::files::{Recorded, model_file, read_text};
use crate::runtime::output::quoted;
use crate::runtime::rig::{OpenRig, Rig, RigOptions};
use crate::runtime::{output, progress, signals};
use crate::tui::{Exit, Opens};
use crate::workflow::{
    BurstResult, Called, Commission, CommissionResult, Discovery, Progress, ProgressCell, Role,
    RunRecord, Step, StepState, Task, next_bench,
};
use drivebench_bench::recording::RunFile;
use drivebench_bench::{BenchFile, Snapshot, burst_part};
use drivebench_diagnose::{Diagnosis, recommend};
use drivebench_emulator::mystery::TrueEffect;
use drivebench_link::offer::Purpose;
use drivebench_model::plant::{FileHistory, Model, Scenario};
use drivebench_model::text::number::significant;

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

pub(super) fn execute(arguments: Arguments) -> Result<(), Failure> {
    let live = arguments.live;
    let options = live.options(arguments.unknown.escalate)?;
    let source = live.source()?;
    let file = live.bench.as_ref().map(|_| source.0.as_str());
    let called = Called::new(&options.bench, file, live.words());
    let cell = ProgressCell::default();
    let shown = live.is_headless().then(|| progress::begin("commission"));
    let mut told = shown.is_some().then(StepLog::default);
    let audience = live.audience(Some(cell.clone()));
    let asked = options.clone();
    let done = conduct(audience, move |strings| {
        commission(asked, called, Box::new(Rig::open), strings, |latest| {
            cell.publish(latest.clone());
            if let Some(told) = &mut told {
                told.tell(latest);
            }
        })
    })?;
    drop(shown);
    let followed = follow(done.work, done.left, &options, &source);
    // However it was left: the result of the loop is there all the same.
    let mut done = followed.done;
    done.document.say("then", followed.said, 4);
    output::document(&done.result, live.json, live.full, &done.document)?;
    followed.outcome
}

/// Progress on stderr: each step once when it begins and once with its figure.
#[derive(Default)]
struct StepLog {
    lines: Vec<(StepState, String)>,
}

impl StepLog {
    fn tell(&mut self, progress: &Progress) {
        let total = progress.steps.len();
        self.lines.resize(total, (StepState::Waiting, String::new()));
        for (index, step) in progress.steps.iter().enumerate() {
            let now = (step.state, step.line.clone());
            if now == self.lines[index] {
                continue;
            }
            let head = format!("[{:>2}/{total}] {}", index + 1, step.step.title());
            match step.state {
                StepState::Waiting | StepState::Offered | StepState::Withheld => {}
                StepState::Active => {
                    output::message(&format!("{head} ..."));
                    progress::stage(step.step.title(), 0);
                }
                StepState::Done => output::message(&format!("{head}: {}", step.line)),
                StepState::Failed => output::message(&format!("{head} failed")),
            }
            self.lines[index] = now;
        }
    }
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
        if let Err(failure) = step(&mut workflow, &mut rig, &mut records, controls, &mut publish) {
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
            let _endable =
                if rig.asked.headless { signals::endable()? } else { signals::leavable() };
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
    let file = model_file(&found.model, &none, run, &result.ladder, found.noise_floor_from);
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

/// A commissioning whose screen was left for good, with what followed it.
pub(crate) struct Followed {
    pub(crate) done: CommissionDone,
    /// What came of each step that was asked for, in sentences.
    pub(crate) said: Vec<String>,
    pub(crate) outcome: Result<(), Failure>,
}

/// Goes on from the screen of a commissioning as its keys ask, until it is left. `source` is the name and the text of the
/// bench file.
pub(crate) fn follow(
    mut done: CommissionDone,
    mut left: Left,
    options: &RigOptions,
    source: &(String, String),
) -> Followed {
    let mut said = Vec::new();
    // Every signal from here on ends what follows, whichever part of it is under way.
    let hang_up = match signals::flag() {
        Ok(flag) => flag,
        Err(failure) => {
            let outcome = Err(failure);
            return Followed { done, said, outcome };
        }
    };
    let interrupted = || Failure::interrupted(BETWEEN_RUNS);
    let first_file = first_folder(&done).map(|folder| folder.join(RunFile::NextBench.name()));
    let mut next_file = first_file.ok();
    let outcome = loop {
        let Left::Screen(exit) = left else {
            break left.conclude(done.unkept.take());
        };
        let (step, came) = match exit {
            Exit::Diagnosis | Exit::Traces => (Step::Diagnose, diagnose(&done, exit)),
            Exit::Experiment => (Step::Experiment, experiment(&mut done, &mut next_file, options)),
            Exit::SpeedLoop => (Step::SpeedLoop, speed_loop(&done, options, source)),
            _ => break Left::Screen(exit).conclude(done.unkept.take()),
        };
        let is_hung_up = hang_up.load(Ordering::Acquire);
        match came {
            Ok(_) if is_hung_up => break Err(interrupted()),
            Ok(line) if line.is_empty() => {}
            Ok(line) => {
                said.push(format!("{}: {line}", step.title()));
                if step.is_on_request() {
                    done.progress.done_on_request(step, Ok(line));
                }
                if step == Step::Experiment {
                    done.progress.follows(step, next_file.as_deref());
                }
            }
            // What asks for too much, or leaves a run that cannot be judged, is said; everything else ends the program.
            Err(failure) if failure.status == USAGE && step.is_on_request() && !is_hung_up => {
                let parts = [failure.headline(), failure.help()].into_iter();
                let said: Vec<&str> = parts.filter(|part| !part.is_empty()).collect();
                done.progress.done_on_request(step, Err(said.join("; ")));
            }
            Err(failure) => break Err(failure),
        }
        left = match again(&done) {
            Ok(Left::Screen(Exit::Interrupted | Exit::Forced)) => break Err(interrupted()),
            Ok(_) if hang_up.load(Ordering::Acquire) => break Err(interrupted()),
            Ok(left) => left,
            Err(failure) => break Err(failure),
        };
    };
    Followed { done, said, outcome }
}

/// How the screen of a run that followed was left: on to what comes of the run, or away.
fn goes_on(left: Left, run: Option<Failure>) -> Result<(), Failure> {
    let is_interrupted = matches!(left, Left::Screen(Exit::Interrupted | Exit::Forced));
    left.conclude(run)?;
    if is_interrupted {
        return Err(Failure::interrupted(BETWEEN_RUNS));
    }
    Ok(())
}

/// The options of a rig that follows: what is done once, and a capture that has its file, are not done again.
fn once_more(options: &RigOptions) -> RigOptions {
    RigOptions { escalate: false, reset_fault: false, tap: None, ..options.clone() }
}

/// What came of a diagnosis by hand: the changes before the answer, and the answer.
fn answered(standing: &Standing) -> String {
    let changes = standing.heading();
    let answer = standing.diagnosis.as_ref();
    let answer = answer.map_or("left before there was an answer", |found| &found.sentence);
    let model = standing.model().map(|model| format!("model: {model}"));
    let said = changes.lines().chain([answer]).chain(model.as_deref());
    said.collect::<Vec<_>>().join("; ")
}

/// The page of the loop once more, over nothing that is energised.
fn again(done: &CommissionDone) -> Result<Left, Failure> {
    let cell = ProgressCell::default();
    cell.publish(done.progress.clone());
    let last = Arc::clone(&done.last);
    let ended = conduct(Audience::Screen(Some(cell)), move |controls| {
        controls.snapshots.publish((*last).clone());
        Ok(())
    })?;
    Ok(ended.left)
}

/// The folder of the run that was fitted, in which the loop left its model and the next bench file.
fn first_folder(done: &CommissionDone) -> Result<PathBuf, Failure> {
    let first = done.result.runs.first();
    let folder = first.and_then(|run| run.folder.as_ref());
    let none = || Failure::internal("the loop has left no run folder");
    folder.map(PathBuf::from).ok_or_else(none)
}

/// The diagnosis by hand; what was changed in it, if anything.
fn diagnose(done: &CommissionDone, exit: Exit) -> Result<String, Failure> {
    let Some(discovery) = done.discovery.clone() else {
        return Ok(String::new());
    };
    let fitted_on = first_folder(done)?;
    let mut shown = shown("the runs of this commissioning", &fitted_on);
    if exit == Exit::Traces {
        shown.opens = Opens::Traces;
    }
    let seen = by_hand::show(discovery, shown)?;
    if seen.is_interrupted() {
        return Err(Failure::interrupted("interrupted in the diagnosis by hand"));
    }
    let standing = &seen.standing;
    let is_changed = !standing.heading().is_empty() || standing.model().is_some();
    Ok(if is_changed { answered(&seen.standing) } else { String::new() })
}

fn shown(title: &str, fitted_on: &Path) -> Shown {
    Shown {
        title: title.to_owned(),
        opens: Opens::Search,
        stopped_at: None,
        fitted_on: fitted_on.display().to_string(),
        history: FileHistory::default(),
        output: None,
    }
}

/// Records the run that was recommended and shows what it and those before it say together; what came of it. What that
/// recommends is what is recommended then.
fn experiment(
    done: &mut CommissionDone,
    next_file: &mut Option<PathBuf>,
    options: &RigOptions,
) -> Result<String, Failure> {
    let none = || Failure::internal("no run was recommended");
    let path = next_file.clone().ok_or_else(none)?;
    let bench = BenchFile::parse(&path.display().to_string(), &read_text(&path)?)?;
    let mut base = bench.clone();
    base.sequence.clone_from(&options.bench.sequence);
    let options = RigOptions { bench, ..once_more(options) };
    let ended = conduct(Audience::Leads("on to its diagnosis"), move |controls| {
        run(options, None, Box::new(Rig::open), controls)
    })?;
    let mut recorded = match ended.work {
        RunDone::Named(result) => {
            let failure = escalation_failure(&result);
            return Err(failure.unwrap_or_else(|| Failure::internal("no motor, and no reason")));
        }
        RunDone::Run(whole) => whole.recorded,
    };
    goes_on(ended.left, recorded.failure())?;
    let folder = recorded.folder.path().to_owned();
    let none = || Failure::internal("a recommended run without a diagnosis before it");
    let before = done.discovery.as_ref().ok_or_else(none)?;
    let fitted = before.evidence().first_run();
    let (scenario, notes) = admit_later(&recorded.load()?, before.model(), fitted)?;
    let discovery = before.with_run(scenario);
    let seen = by_hand::show(discovery.clone(), shown("with the run that tells more", &folder))?;
    if seen.is_interrupted() {
        return Err(Failure::interrupted("interrupted in the diagnosis by hand"));
    }
    let mut came = answered(&seen.standing);
    for note in notes {
        came = format!("{came}; {note}");
    }
    came = format!("{came}; {}", folder.display());
    let is_changed = !seen.standing.heading().is_empty();
    let mut found = seen.standing.diagnosis;
    // The run is made, whatever comes of the next one.
    let with_answer = |found: Option<&Diagnosis>| match found.filter(|_| !is_changed) {
        Some(found) => discovery.clone().with_answer(found.clone()),
        None => discovery.clone(),
    };
    done.discovery = Some(with_answer(found.as_ref()));
    *next_file = None;
    // It may have been left before the run was recommended.
    let next = match (seen.standing.next, &found, discovery.limits()) {
        (Some(next), _, _) => Some(next),
        (None, Some(found), Some(limits)) => {
            let next = recommend(found, discovery.evidence(), limits);
            next.unwrap_or_else(|error| {
                came = format!("{came}; which run would tell more is not known: {error}");
                None
            })
        }
        _ => None,
    };
    if let (Some(mut next), Some(found)) = (next, &mut found) {
        came = format!("{came}; {}", next.sentence);
        if let Some(recipe) = &next.recipe {
            let text = next_bench(&base, recipe, &found.model.model, &next.sentence);
            // A disk that does not take it is told of.
            *next_file = recorded.write(RunFile::NextBench, &text);
            next.bench = Some(text);
        }
        found.next_experiment = Some(next);
    }
    done.discovery = Some(with_answer(found.as_ref()));
    Ok(came)
}

/// Runs the speed loop of the bench with the model that was found; what came of it.
fn speed_loop(
    done: &CommissionDone,
    options: &RigOptions,
    source: &(String, String),
) -> Result<String, Failure> {
    let request = SpeedRequest {
        rig: once_more(options),
        source: source.clone(),
        model: Some(first_folder(done)?.join(RunFile::Model.name())),
        controller: None,
        feed_forward: None,
        maps: Vec::new(),
        actuator: None,
    };
    let ended = conduct(Audience::Leads("back to the loop"), move |controls| {
        speed(request, Box::new(Rig::open), controls)
    })?;
    let recorded = ended.work.recorded;
    let folder = recorded.folder.path();
    let seen = by_hand::go_on(&ended.left, folder);
    // A trip or a lost drive is said before anything that became of the look at its record.
    goes_on(ended.left, recorded.failure())?;
    seen?;
    let folder = folder.display();
    let report = recorded.summary.speed.as_ref();
    let last = report.and_then(|report| report.tracking.last());
    let tracking = last.map_or_else(
        || "no reference was followed to its end".to_owned(),
        |pass| {
            let (rms, peak) = (significant(pass.rms_rad_s, 3), significant(pass.peak_rad_s, 3));
            format!("reference followed within {rms} rad/s rms, {peak} at most")
        },
    );
    Ok(format!("{tracking}; {folder}"))
}

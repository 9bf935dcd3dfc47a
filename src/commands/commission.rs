//! `commission`: the whole procedure, guided. The screen and the headless run drive the same state machine, whose tasks are
//! carried out over a rig until it is finished. From its screen the user may go on to the recommended run, to the speed loop
//! with the identified model and to the diagnosis by hand, and returns to the screen.
//!
//! ```text
//! commission -> its screen -+- x: checks, next-bench.toml, diagnosis of that run -+
//!                  ^        +- l: checks, speed loop with the identified model ---+
//!                  |        +- d, v: diagnosis by hand ---------------------------+
//!                  '--------------------------------------------------------------'
//! ```
//!
//! Each energises anew, from the checks on, and the start of a real motor is confirmed by hand again.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::commands::arguments::{LiveArguments, UnknownMotor};
use crate::commands::by_hand::{ScreenResult, Shown};
use crate::commands::evidence::admit_later;
use crate::commands::run::{
    BETWEEN_RUNS, RunDone, escalate, escalation_failure, find_by_currents, of_balances, run,
};
use crate::commands::speed::{LoopArguments, SpeedRequest, speed};
use crate::commands::{by_hand, pages};
use crate::report::wording::diagnosis as words;
use crate::report::wording::next_run::next_run;
use crate::report::{Document, tables};
use crate::runtime::{
    Audience, Controls, Failure, Recorded, Rig, RigOptions, ScreenEnd, Switches, Terminal, USAGE,
    conduct, model_file, quoted, read_text, signals,
};
use crate::tui::{Exit, Opens};
use crate::workflow::{
    BurstResult, CommandContext, Commission, CommissionResult, Discovery, Progress, ProgressCell,
    Role, RunRecord, Step, StepState, Task, next_bench,
};
use drivebench_bench::recording::RunFile;
use drivebench_bench::{BenchFile, Snapshot, burst_part};
use drivebench_diagnose::{Diagnosis, recommend};
use drivebench_emulator::mystery::TrueEffect;
use drivebench_model::plant::{FileHistory, Model, Scenario};
use drivebench_model::text::number::significant;

/// The whole procedure: check, plan, excite, identify, compare, name the missing effect, add it, report
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

pub(super) fn execute(arguments: Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let live = arguments.live;
    let options = live.options(arguments.unknown.escalate, terminal)?;
    let source = live.source()?;
    let file = live.bench.as_ref().map(|_| source.0.as_str());
    let context = CommandContext::new(&options.bench, file, live.words());
    let cell = ProgressCell::default();
    let shown = live.is_headless().then(|| terminal.progress("commission"));
    let mut log = shown.is_some().then(StepLog::default);
    let audience = live.audience(Some(cell.clone()));
    let of_rig = options.clone();
    let printed = terminal.clone();
    let done = conduct(terminal, audience, move |controls| {
        commission(of_rig, context, controls, |latest| {
            cell.publish(latest.clone());
            if let Some(log) = &mut log {
                log.print(latest, &printed);
            }
        })
    })?;
    drop(shown);
    let (screen, mut done) = (done.screen, done.work);
    let mut results = Vec::new();
    let outcome = follow(&mut done, &mut results, screen, &options, &source);
    // The result of the commissioning is printed however its screen was left.
    done.document.say("then", results, 4);
    terminal.document(&done.result, live.form(), &done.document)?;
    outcome
}

/// Progress on stderr: each step once when it begins and once with its figure.
#[derive(Default)]
struct StepLog {
    lines: Vec<(StepState, String)>,
}

impl StepLog {
    fn print(&mut self, progress: &Progress, terminal: &Terminal) {
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
                    terminal.message(&format!("{head} ..."));
                    terminal.stage(step.step.title(), 0);
                }
                StepState::Done => terminal.message(&format!("{head}: {}", step.line)),
                StepState::Failed => terminal.message(&format!("{head} failed")),
            }
            self.lines[index] = now;
        }
    }
}

/// The commands that follow a commissioning, and its page.
fn go_on(document: &mut Document, result: &CommissionResult, rig: &Rig, records: &[Recorded]) {
    let Some(first) = records.first() else { return };
    let options = rig.options.words.as_str();
    let (folder, file) = (first.folder.path(), |file| quoted(&first.folder.file(file)));
    let next = result.diagnosis.next_experiment.as_ref();
    if next.is_some_and(|next| next.bench.is_some()) {
        document.go_on(format!("drivebench run {}", file(RunFile::NextBench)));
        // Only runs that were made can judge.
        let option =
            |(name, run): (&str, &Recorded)| format!(" --{name} {}", quoted(run.folder.path()));
        let judging: String =
            ["holdout", "confirm"].into_iter().zip(&records[1..]).map(option).collect();
        document.go_on(format!(
            "drivebench diagnose {} --model baseline{judging} --with NEW_RUN",
            quoted(folder)
        ));
    }
    let model = file(RunFile::Model);
    document.go_on(format!("drivebench speed{options} --model {model}"));
    document.ends_with(first.folder.file(RunFile::Report).display().to_string());
}

/// Result of the commissioning, and what the steps after it need.
struct CommissionDone {
    pub result: CommissionResult,
    pub document: Document,
    /// At the end, with the steps that can follow.
    pub progress: Progress,
    /// Latest snapshot of the bench.
    pub last: Arc<Snapshot>,
    pub discovery: Option<Discovery>,
    /// Why the record of a run could not be kept.
    pub record_failure: Option<Failure>,
}

/// Carries out the tasks until the commissioning is finished; `context` is for the commands that its steps print.
fn commission(
    options: RigOptions,
    context: CommandContext,
    controls: &Controls,
    mut publish: impl FnMut(&Progress),
) -> Result<CommissionDone, Failure> {
    let purpose = options.bench.purpose();
    let mut rig = Rig::open(options, None, purpose)?;
    // On a machine that changes while it runs the hidden effects are not the whole truth: the diagnosis is not scored.
    let emulator = rig.connection.emulator.as_ref();
    let steady = emulator.filter(|emulator| emulator.changes.is_empty());
    let truth = steady.map(|emulator| emulator.hidden.iter().map(TrueEffect::from).collect());
    let (plate, bench) = (Model::baseline(rig.nameplate_motor.clone()), rig.bench.clone());
    let mut workflow = Commission::new(plate, rig.escalates, bench, truth, context);
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
        .ok_or_else(|| Failure::internal("the commissioning ended without a result"))?;
    let mut document = pages::commission(workflow.scenarios(), &result, &rig, &records)?;
    if let Some(found) = &result.escalation {
        found.put("found by", &mut document);
    }
    let burst = result.burst.as_ref().map(BurstResult::text);
    document.say("burst", burst.as_ref().and_then(|text| text.lines().next()), 0);
    tables::nameplate_section(&mut document, result.nameplate.as_ref());
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
        record_failure: records.iter().find_map(Recorded::record_failure),
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
            let report = rig.check(controls, false);
            if let (Some(identity), Err(_)) = (&rig.answered, &report) {
                workflow.answered(&identity.name());
            }
            workflow.checked(&report?);
        }
        Task::Escalate => {
            let print = |line: &str| {
                workflow.escalating(line);
                publish(&workflow.progress());
            };
            if rig.bench.currents.is_some() {
                let sentence = find_by_currents(rig, controls, print)?;
                workflow.found(rig.nameplate()?.motor(), &sentence);
            } else {
                let result = escalate(rig, controls, print)?;
                if let Some(failure) = escalation_failure(&result) {
                    return Err(failure);
                }
                workflow.escalated(rig.nameplate()?.motor(), result);
            }
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
            of_balances(&rig.bench, &mut recorded)?;
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
                // The burst is optional.
                Some((_, Err(failure))) => {
                    rig.options
                        .terminal
                        .message(&format!("burst not used: {}", failure.headline()));
                }
                None => {}
            }
            let scenario = Scenario::from_run(&loaded.run)?;
            workflow.recorded(role, scenario, record, recorded.summary.estimates.clone());
            records.push(recorded);
        }
        Task::Analyse => {
            // Nothing is energised and everything recorded is on the disk. With a screen, the screen handles the signals.
            let terminal = &rig.options.terminal;
            let _endable = if rig.options.switches.headless {
                terminal.endable()?
            } else {
                terminal.leavable()
            };
            workflow.analyse(|now| publish(&now), &|event| terminal.diagnosis(event))?;
        }
        Task::Save => {
            let line = save(workflow, rig, records)?;
            workflow.saved(&line);
        }
        Task::Finished => {}
    }
    Ok(())
}

/// Model, result and report into every run folder of the commissioning.
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

/// Carries out the steps that the keys of a commissioning's screen request, until it is left, and adds a sentence of each
/// to the results. `source` is the name and the text of the bench file.
fn follow(
    done: &mut CommissionDone,
    results: &mut Vec<String>,
    mut screen: ScreenEnd,
    options: &RigOptions,
    source: &(String, String),
) -> Result<(), Failure> {
    // From here on a signal ends whichever step is under way.
    let hang_up = signals::flag()?;
    let interrupted = || Failure::interrupted(BETWEEN_RUNS);
    let first_file = first_folder(done).map(|folder| folder.join(RunFile::NextBench.name()));
    let mut next_file = first_file.ok();
    loop {
        let ScreenEnd::Screen(exit) = screen else {
            return screen.conclude(done.record_failure.take());
        };
        let (step, result) = match exit {
            Exit::Diagnosis | Exit::Traces => {
                (Step::Diagnose, diagnose(done, exit, &options.terminal))
            }
            Exit::Experiment => (Step::Experiment, experiment(done, &mut next_file, options)),
            Exit::SpeedLoop => (Step::SpeedLoop, speed_loop(done, options, source)),
            _ => return screen.conclude(done.record_failure.take()),
        };
        let is_hung_up = hang_up.load(Ordering::Acquire);
        match result {
            Ok(_) if is_hung_up => return Err(interrupted()),
            Ok(line) if line.is_empty() => {}
            Ok(line) => {
                results.push(format!("{}: {line}", step.title()));
                if step.is_on_request() {
                    done.progress.done_on_request(step, Ok(line));
                }
                if step == Step::Experiment {
                    done.progress.follows(step, next_file.as_deref());
                }
            }
            // A refused step, or a run that cannot be judged, is reported; everything else ends the program.
            Err(failure) if failure.status == USAGE && step.is_on_request() && !is_hung_up => {
                let text = format!("{}; {}", failure.headline(), failure.help());
                done.progress.done_on_request(step, Err(text));
            }
            Err(failure) => return Err(failure),
        }
        screen = match show_again(done, &options.terminal) {
            Ok(ScreenEnd::Screen(Exit::Interrupted | Exit::Forced)) => return Err(interrupted()),
            Ok(_) if hang_up.load(Ordering::Acquire) => return Err(interrupted()),
            Ok(screen) => screen,
            Err(failure) => return Err(failure),
        };
    }
}

/// The failure of a run that followed, or an interruption of its screen.
fn conclude_run(screen: ScreenEnd, run: Option<Failure>) -> Result<(), Failure> {
    let is_interrupted = matches!(screen, ScreenEnd::Screen(Exit::Interrupted | Exit::Forced));
    screen.conclude(run)?;
    if is_interrupted {
        return Err(Failure::interrupted(BETWEEN_RUNS));
    }
    Ok(())
}

/// The options for another rig, without what is done once: escalation, fault reset, capture file.
fn options_again(options: &RigOptions) -> RigOptions {
    let switches = Switches { reset_fault: false, tap: None, ..options.switches.clone() };
    RigOptions { escalate: false, switches, ..options.clone() }
}

/// Result of a diagnosis by hand: the changes, and the diagnosis after them.
fn answered(screen_result: &ScreenResult) -> String {
    let changes = screen_result.heading();
    let answer = screen_result.diagnosis.as_ref();
    let answer =
        answer.map_or_else(|| "left before the diagnosis was done".to_owned(), words::diagnosis);
    let model = screen_result.model().map(|model| format!("model: {model}"));
    let parts: Vec<_> = changes.lines().chain([answer.as_str()]).chain(model.as_deref()).collect();
    parts.join("; ")
}

/// Shows the screen of the commissioning again; nothing is energised.
fn show_again(done: &CommissionDone, terminal: &Terminal) -> Result<ScreenEnd, Failure> {
    let cell = ProgressCell::default();
    cell.publish(done.progress.clone());
    let last = Arc::clone(&done.last);
    let ended = conduct(terminal, Audience::Screen(Some(cell)), move |controls| {
        controls.snapshots.publish((*last).clone());
        Ok(())
    })?;
    Ok(ended.screen)
}

/// The folder of the fitted run, with the model and the next bench file.
fn first_folder(done: &CommissionDone) -> Result<PathBuf, Failure> {
    let folder = done.result.runs.first().and_then(|run| run.folder.as_ref());
    let none = || Failure::internal("the commissioning has no run folder");
    folder.map(PathBuf::from).ok_or_else(none)
}

/// The diagnosis by hand; its result where something was changed, else empty.
fn diagnose(done: &CommissionDone, exit: Exit, terminal: &Terminal) -> Result<String, Failure> {
    let Some(discovery) = done.discovery.clone() else {
        return Ok(String::new());
    };
    let (title, opens) = ("the runs of this commissioning", Opens::after(exit).unwrap_or_default());
    let screen_result = by_hand(discovery, (title, opens), &first_folder(done)?, terminal)?;
    let is_changed = !screen_result.heading().is_empty() || screen_result.model().is_some();
    Ok(if is_changed { answered(&screen_result) } else { String::new() })
}

fn by_hand(
    discovery: Discovery,
    (title, opens): (&str, Opens),
    fitted_on: &Path,
    terminal: &Terminal,
) -> Result<ScreenResult, Failure> {
    let shown = Shown {
        title: title.to_owned(),
        opens,
        stopped_at: None,
        fitted_on: fitted_on.display().to_string(),
        history: FileHistory::default(),
        output: None,
    };
    by_hand::show(discovery, shown, terminal)?.left("interrupted in the diagnosis by hand")
}

/// Records the recommended run and diagnoses it together with those before it; the result in a sentence. The run that this
/// diagnosis recommends is the next one.
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
    let terminal = options.terminal.clone();
    let options = RigOptions { bench, ..options_again(options) };
    let ended = conduct(&terminal, Audience::FollowedBy("on to its diagnosis"), move |controls| {
        run(options, None, Box::new(Rig::open), controls)
    })?;
    let mut recorded = match ended.work {
        RunDone::NotFound(result) => {
            return Err(escalation_failure(&result).unwrap_or_else(|| {
                Failure::internal("no motor was found, and no reason is given")
            }));
        }
        RunDone::Run(whole) => whole.recorded,
    };
    conclude_run(ended.screen, recorded.failure())?;
    let folder = recorded.folder.path().to_owned();
    let none = || Failure::internal("a recommended run without a diagnosis before it");
    let before = done.discovery.as_ref().ok_or_else(none)?;
    let fitted = before.evidence().first_run();
    let (scenario, notes) = admit_later(&recorded.load()?, before.model(), fitted, &terminal)?;
    let discovery = before.with_run(scenario);
    let shown = ("with the recommended run", Opens::Search);
    let screen_result = by_hand(discovery.clone(), shown, &folder, &terminal)?;
    let mut result = vec![answered(&screen_result)];
    result.extend(notes);
    result.push(folder.display().to_string());
    let is_changed = !screen_result.heading().is_empty();
    let mut found = screen_result.diagnosis;
    // The run counts even if no next one can be recommended.
    let with_answer = |found: Option<&Diagnosis>| match found.filter(|_| !is_changed) {
        Some(found) => discovery.clone().with_answer(found.clone()),
        None => discovery.clone(),
    };
    done.discovery = Some(with_answer(found.as_ref()));
    *next_file = None;
    // The screen may have been left before the run was recommended.
    let next = match (screen_result.next, &found, discovery.limits()) {
        (Some(next), _, _) => Some(next),
        (None, Some(found), Some(limits)) => {
            let next = recommend(found, discovery.evidence(), limits);
            next.unwrap_or_else(|error| {
                result.push(format!("no next run can be recommended: {error}"));
                None
            })
        }
        _ => None,
    };
    if let (Some(mut next), Some(found)) = (next, &mut found) {
        let words = next_run(&next);
        result.push(words.clone());
        if let Some(recipe) = &next.recipe {
            let text = next_bench(&base, recipe, &found.model.model, &words);
            *next_file = recorded.write(RunFile::NextBench, &text);
            next.bench = Some(text);
        }
        found.next_experiment = Some(next);
    }
    done.discovery = Some(with_answer(found.as_ref()));
    Ok(result.join("; "))
}

/// Runs the speed loop of the bench with the model that was found; the result in a sentence.
fn speed_loop(
    done: &CommissionDone,
    options: &RigOptions,
    source: &(String, String),
) -> Result<String, Failure> {
    let request = SpeedRequest {
        rig: options_again(options),
        source: source.clone(),
        own: LoopArguments {
            model: Some(first_folder(done)?.join(RunFile::Model.name())),
            ..LoopArguments::default()
        },
    };
    let terminal = &options.terminal;
    let ended = conduct(terminal, Audience::FollowedBy("back to the steps"), move |controls| {
        speed(request, controls)
    })?;
    let recorded = ended.work.recorded;
    let diagnosed = by_hand::go_on(&ended.screen, recorded.folder.path(), terminal);
    // A trip or a lost drive goes before anything that happened in the diagnosis of its record.
    conclude_run(ended.screen, recorded.failure())?;
    diagnosed?;
    let folder = recorded.folder.path().display();
    let last = recorded.summary.speed.as_ref().and_then(|report| report.tracking.last());
    let tracking = last.map_or_else(
        || "no reference was followed to its end".to_owned(),
        |pass| {
            let (rms, peak) = (significant(pass.rms_rad_s, 3), significant(pass.peak_rad_s, 3));
            format!("reference followed within {rms} rad/s rms, {peak} at most")
        },
    );
    Ok(format!("{tracking}; {folder}"))
}

//! What can follow a commissioning on its screen: the run that would tell more, the speed loop with what was found, the
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

use super::by_hand::{self, Shown, Standing};
use super::ending::{Audience, Left, conduct};
use super::evidence::admit_later;
use super::failure::{Failure, USAGE};
use super::files::read_text;
use super::rig::{Rig, RigOptions};
use super::run::{CommissionDone, RunDone, escalation_failure, run};
use super::signals;
use super::speed::{SpeedRequest, speed};
use crate::tui::{Exit, Opens};
use crate::workflow::next_bench;
use crate::workflow::{ProgressCell, Step};
use drivebench_bench::BenchFile;
use drivebench_bench::recording::RunFile;
use drivebench_diagnose::{Diagnosis, recommend};
use drivebench_model::plant::FileHistory;
use drivebench_model::text::number::significant;

const INTERRUPTED: &str = "interrupted; nothing is energised, what was recorded is kept";

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
            return Followed {
                done,
                said,
                outcome,
            };
        }
    };
    let interrupted = || Failure::interrupted(INTERRUPTED);
    let first_file = first_folder(&done).map(|folder| folder.join(RunFile::NextBench.name()));
    let mut next_file = first_file.ok();
    let outcome = loop {
        let Left::Screen(exit) = left else {
            break left.conclude(done.unkept.take());
        };
        let (step, came) = match exit {
            Exit::Diagnosis | Exit::Traces => (Step::Diagnose, diagnose(&done, exit)),
            Exit::Experiment => (
                Step::Experiment,
                experiment(&mut done, &mut next_file, options),
            ),
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
    Followed {
        done,
        said,
        outcome,
    }
}

/// How the screen of a run that followed was left: on to what comes of the run, or away.
fn goes_on(left: Left, run: Option<Failure>) -> Result<(), Failure> {
    let is_interrupted = matches!(left, Left::Screen(Exit::Interrupted | Exit::Forced));
    left.conclude(run)?;
    if is_interrupted {
        return Err(Failure::interrupted(INTERRUPTED));
    }
    Ok(())
}

/// The options of a rig that follows: what is done once, and a capture that has its file, are not done again.
fn once_more(options: &RigOptions) -> RigOptions {
    RigOptions {
        escalate: false,
        reset_fault: false,
        tap: None,
        ..options.clone()
    }
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
    Ok(if is_changed {
        answered(&seen.standing)
    } else {
        String::new()
    })
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
    let options = RigOptions {
        bench,
        ..once_more(options)
    };
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
    let seen = by_hand::show(
        discovery.clone(),
        shown("with the run that tells more", &folder),
    )?;
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
            let (rms, peak) = (
                significant(pass.rms_rad_s, 3),
                significant(pass.peak_rad_s, 3),
            );
            format!("reference followed within {rms} rad/s rms, {peak} at most")
        },
    );
    Ok(format!("{tracking}; {folder}"))
}

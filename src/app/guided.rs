//! What can follow a commissioning on its screen: the run that would tell more, the speed loop with what was found, the
//! diagnosis by hand; then the page of the loop again.
//!
//! ```text
//! commission -> page of the loop -+- x: checks, next-bench.toml, diagnosis of that run -+-> page of the loop
//!                  ^              +- l: checks, speed loop with the model that was found +        |
//!                  |              '- d, v, g: diagnosis by hand -> end                             |
//!                  '------------------------------------------------------------------------------'
//! ```
//!
//! Each energises anew, from the checks on, and a motor of copper is started by hand again.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::by_hand::{self, Shown};
use super::ending::{Audience, Left, conduct};
use super::failure::{Failure, USAGE};
use super::files::read_text;
use super::rig::{Rig, RigOptions};
use super::run::{CommissionDone, RunDone, escalation_failure, run};
use super::speed::{SpeedRequest, speed};
use crate::bench::BenchFile;
use crate::plant::{FileHistory, Scenario};
use crate::recording::RunFile;
use crate::text::number::significant;
use crate::tui::{Exit, Opens};
use crate::workflow::{Discovery, ProgressCell, Step};

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
    let outcome = loop {
        let Left::Screen(exit) = left else {
            break left.conclude(done.unkept.take());
        };
        let (step, came) = match exit {
            Exit::Diagnosis | Exit::Guess | Exit::Traces => break diagnose(&mut done, exit),
            Exit::Experiment => (Step::Experiment, experiment(&done, options)),
            Exit::SpeedLoop => (Step::SpeedLoop, speed_loop(&done, options, source)),
            _ => break Left::Screen(exit).conclude(done.unkept.take()),
        };
        match came {
            Ok(line) => {
                said.push(format!("{}: {line}", step.title()));
                done.progress.done_on_request(step, Ok(line));
            }
            // What was asked for too much is said, and nothing was energised; everything else ends the program.
            Err(failure) if failure.status == USAGE => {
                let reason = failure.headline().to_owned();
                done.progress.done_on_request(step, Err(reason));
            }
            Err(failure) => break Err(failure),
        }
        left = match again(&done) {
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

fn diagnose(done: &mut CommissionDone, exit: Exit) -> Result<(), Failure> {
    let Some(discovery) = done.discovery.take() else {
        return done.unkept.take().map_or(Ok(()), Err);
    };
    let fitted_on = first_folder(done)?;
    let guess_first = exit == Exit::Guess;
    let mut shown = shown("the runs of this commissioning", guess_first, &fitted_on);
    if exit == Exit::Traces {
        shown.opens = Opens::Traces;
    }
    if by_hand::show(discovery, shown)?.is_interrupted() {
        return Err(Failure::interrupted("interrupted in the diagnosis by hand"));
    }
    done.unkept.take().map_or(Ok(()), Err)
}

fn shown(title: &str, guess_first: bool, fitted_on: &Path) -> Shown {
    Shown {
        title: title.to_owned(),
        guess_first,
        opens: Opens::Search,
        fitted_on: fitted_on.display().to_string(),
        history: FileHistory::default(),
        output: None,
    }
}

/// Records the run that was recommended and shows its diagnosis, the fit run of the loop held out; what came of it.
fn experiment(done: &CommissionDone, options: &RigOptions) -> Result<String, Failure> {
    let path = first_folder(done)?.join(RunFile::NextBench.name());
    let bench = BenchFile::parse(&path.display().to_string(), &read_text(&path)?)?;
    let options = RigOptions {
        bench,
        escalate: false,
        ..options.clone()
    };
    let ended = conduct(Audience::Screen(None), move |controls| {
        run(options, None, Box::new(Rig::open), controls)
    })?;
    let recorded = match ended.work {
        RunDone::Named(result) => {
            let failure = escalation_failure(&result);
            return Err(failure.unwrap_or_else(|| Failure::internal("no motor, and no reason")));
        }
        RunDone::Run(whole) => whole.recorded,
    };
    ended.left.conclude(recorded.failure())?;
    let folder = recorded.folder.path().to_owned();
    let scenario = Scenario::from_run(&recorded.load()?.run)?;
    let none = || Failure::internal("a recommended run without a diagnosis before it");
    let discovery = done.discovery.as_ref().ok_or_else(none)?;
    let seen = by_hand::show(
        Discovery::with_run(discovery, scenario),
        shown("the run that tells more", false, &folder),
    )?;
    if seen.is_interrupted() {
        return Err(Failure::interrupted("interrupted in the diagnosis by hand"));
    }
    let folder = folder.display();
    Ok(match &seen.standing.diagnosis {
        Some(found) => format!("{}; {folder}", found.sentence),
        None => format!("left before there was an answer; {folder}"),
    })
}

/// Runs the speed loop of the bench with the model that was found; what came of it.
fn speed_loop(
    done: &CommissionDone,
    options: &RigOptions,
    source: &(String, String),
) -> Result<String, Failure> {
    let request = SpeedRequest {
        rig: RigOptions {
            escalate: false,
            ..options.clone()
        },
        source: source.clone(),
        model: Some(first_folder(done)?.join(RunFile::Model.name())),
        controller: None,
        feed_forward: None,
        actuator: None,
    };
    let ended = conduct(Audience::Screen(None), move |controls| {
        speed(request, Box::new(Rig::open), controls)
    })?;
    let recorded = ended.work.recorded;
    let folder = recorded.folder.path();
    by_hand::go_on(&ended.left, folder)?;
    ended.left.conclude(recorded.failure())?;
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

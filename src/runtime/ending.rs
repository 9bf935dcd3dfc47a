//! The one owner of the end: whatever ends the work, or the screen that shows it, the drive is told to stop, its word is
//! waited for, and only then the program goes on.
//!
//! ```text
//! headless: work on this thread ---------------------------+-- returns, panics --> what it came to
//! screen:   threads "bench" and "screen"; this one waits --'
//!             '-- left, failed, panicked, terminal closed --> hang up -> zero, disable, confirmed? -> what it came to
//! ```

use std::any::Any;
use std::io::{self, IsTerminal as _};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::runtime::controls::{Controls, DriveWord, Ends};
use crate::runtime::failure::{Failure, INTERNAL, INTERRUPTED, LINK, TRIP};
use crate::runtime::{appearance, output, signals};
use crate::tui::{Exit, LiveScreen, LiveSources, WorkerCell, is_gone, show};
use crate::workflow::{ProgressCell, RankingCell, RankingWatch};
use drivebench_bench::{Level, Notice, SnapshotCell};

/// How often it is looked whether the work is over.
const LOOK: Duration = Duration::from_millis(50);
/// How long a worker that was left by force is given, s.
const FORCED_S: f64 = 5.0;
/// How long a screen is given to leave when there is nothing more to show, s.
const SCREEN_S: f64 = 2.0;
/// How long the work is given for its record after the drive has stopped, s.
const RECORD_S: f64 = 30.0;

/// Who looks at the work.
pub enum Audience {
    /// Nobody: progress on stderr.
    Headless,
    /// Somebody at the screen, with the steps of a workflow where there is one.
    Screen(Option<ProgressCell>),
    /// The same for a run after which the program goes on; the words say where `q` leads then.
    Leads(&'static str),
}

/// Work that is over, with how its screen was left.
pub struct Ended<T> {
    pub work: T,
    pub left: Left,
}

/// How the work was left to itself.
#[derive(Debug)]
pub enum Left {
    /// There was no screen.
    Headless,
    /// By its own ways out.
    Screen(Exit),
    /// The terminal was closed, or failed.
    Gone(Failure),
    /// The screen has panicked.
    Panicked(Failure),
}

impl Left {
    /// What the command ends with, where the run itself ended with `run`: a trip or a lost drive is said before anything
    /// that happened to the screen, a fault of this program before an interruption.
    pub fn conclude(self, run: Option<Failure>) -> Result<(), Failure> {
        let of_screen = match self {
            Self::Headless | Self::Screen(_) => None,
            Self::Gone(failure) | Self::Panicked(failure) => Some(failure),
        };
        let ends_run = |failure: &Failure| matches!(failure.status, LINK | TRIP);
        match (run, of_screen) {
            (Some(run), Some(screen))
                if run.status == INTERRUPTED || screen.status == INTERNAL && !ends_run(&run) =>
            {
                Err(screen)
            }
            (Some(failure), _) | (None, Some(failure)) => Err(failure),
            (None, None) => Ok(()),
        }
    }
}

/// Does the work, shown on a screen or not, and sees to its end.
///
/// # Errors
/// The work's own failure; else that of a panic, after the drive was told to stop.
pub fn conduct<T: Send + 'static>(
    audience: Audience,
    work: impl FnOnce(&Controls) -> Result<T, Failure> + Send + 'static,
) -> Result<Ended<T>, Failure> {
    match audience {
        Audience::Headless => {
            let (listener, notices) = channel();
            let (controls, ends) = Controls::new(SnapshotCell::with_notices(listener));
            signals::pull(ends)?;
            let work = alone(controls, notices, work)?;
            Ok(Ended { work, left: Left::Headless })
        }
        Audience::Screen(progress) => on_screen(progress, None, work),
        Audience::Leads(leads) => on_screen(None, Some(leads), work),
    }
}

fn on_screen<T: Send + 'static>(
    progress: Option<ProgressCell>,
    leads: Option<&'static str>,
    work: impl FnOnce(&Controls) -> Result<T, Failure> + Send + 'static,
) -> Result<Ended<T>, Failure> {
    let (controls, ends) = Controls::new(SnapshotCell::default());
    signals::pull(ends.clone())?;
    let shown =
        move |sources| show(LiveScreen::new(LiveSources { leads, ..sources }), appearance::get());
    beside_screen(controls, &ends, progress, shown, work)
}

/// Without a screen: what has to be known at once is told on stderr, by a thread that may wait for it.
pub(crate) fn alone<T>(
    controls: Controls,
    notices: Receiver<Notice>,
    work: impl FnOnce(&Controls) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let drive = controls.drive.clone();
    let teller = spawn("notices", move || {
        let mut told: Vec<String> = Vec::new();
        for notice in notices {
            if notice.level != Level::Info && !told.contains(&notice.text) {
                output::message(&format!("warning: {}", notice.text));
                told.push(notice.text);
            }
        }
    })?;
    let done = catch_unwind(AssertUnwindSafe(|| work(&controls)));
    drop(controls);
    let done = done.unwrap_or_else(|panic| Err(bench_panicked(panic.as_ref(), &drive.get())));
    // What was told stands above the result.
    let _ = teller.join();
    done
}

/// The work on a thread of its own while `show` has this one.
///
/// # Errors
/// As [`conduct`]; and where the work does not come to its end in time.
pub fn beside_screen<T: Send + 'static>(
    controls: Controls,
    ends: &Ends,
    progress: Option<ProgressCell>,
    show: impl FnOnce(LiveSources) -> io::Result<Exit> + Send + 'static,
    work: impl FnOnce(&Controls) -> Result<T, Failure> + Send + 'static,
) -> Result<Ended<T>, Failure> {
    let worker = WorkerCell::default();
    let ranking = RankingCell::default();
    rank_beside(ends.snapshots.reader(), ranking.clone(), worker.clone())?;
    let sources = LiveSources {
        snapshots: ends.snapshots.clone(),
        ranking,
        workflow: progress,
        leads: None,
        intents: ends.intents.clone(),
        worker: worker.clone(),
        stop_requested: Arc::clone(&ends.stop_requested),
        hang_up: Arc::clone(&ends.leaving),
    };
    // A message in the middle of the screen would be in nobody's way but the screen's.
    let held = output::hold();
    let thread = spawn("bench", move || {
        let _finish = worker.finish_on_drop();
        work(&controls)
    })?;
    let shown = watched(
        move || show(sources),
        || ends.hang_up(),
        || thread.is_finished() && ends.leaving.load(Ordering::Acquire),
    )?;
    let left = match shown {
        Watched::Left(exit) => Left::Screen(exit),
        Watched::Failed(reason) => Left::Gone(Failure::with_help(
            INTERRUPTED,
            format!("the screen has failed: {reason}"),
            "the drive was told to stop; start the command again to repeat the run",
        )),
        Watched::Panicked(said) => {
            let headline = format!("the screen has panicked ({said}); the run was ended");
            Left::Panicked(Failure::internal(headline))
        }
    };
    if !matches!(left, Left::Screen(_)) {
        ends.hang_up();
    }
    drop(held);
    let over = match &left {
        Left::Screen(Exit::Forced) => is_over_within(&thread, FORCED_S),
        Left::Screen(_) | Left::Headless => true,
        Left::Gone(_) | Left::Panicked(_) => is_over_after_stop(&thread, ends),
    };
    if !over {
        return Err(unfinished(left, &ends.drive.get()));
    }
    let drive = ends.drive.clone();
    let done =
        thread.join().unwrap_or_else(|panic| Err(bench_panicked(panic.as_ref(), &drive.get())));
    match done {
        Ok(work) => Ok(Ended { work, left }),
        Err(failure) => Err(left
            .conclude(Some(failure))
            .err()
            .unwrap_or_else(|| Failure::internal("the work failed and nothing was said of it"))),
    }
}

/// Time between two provisional rankings.
const RANK: Duration = Duration::from_millis(500);

/// Looks twice a second at what the screen is shown, for as long as the work goes on. It shares nothing with the bench but
/// the snapshot that is published for the screen. Never joined: it has nothing to put down.
fn rank_beside(
    snapshots: SnapshotCell,
    ranking: RankingCell,
    worker: WorkerCell,
) -> Result<(), Failure> {
    spawn("ranking", move || {
        let mut watch = RankingWatch::default();
        let mut seen = None;
        while !worker.is_finished() {
            let latest = snapshots.latest();
            // Between two runs and beside an analysis nothing new comes.
            if !seen.as_ref().is_some_and(|seen| Arc::ptr_eq(seen, &latest)) {
                watch.take(&latest);
                ranking.publish(watch.rank().unwrap_or_default());
                seen = Some(latest);
            }
            thread::sleep(RANK);
        }
    })?;
    Ok(())
}

/// How a screen was left.
pub(crate) enum Watched {
    Left(Exit),
    /// Why there is none any more.
    Failed(String),
    /// With these words.
    Panicked(String),
}

/// Has a screen shown on a thread of its own, so that nothing that becomes of it or of its terminal keeps this one: whoever
/// reads keys from a terminal that is just being closed may do so for ever. `gone` is called, once or more often, when the
/// terminal is closed; a screen that does not come back when it `must_leave` is left alone.
pub(crate) fn watched(
    show: impl FnOnce() -> io::Result<Exit> + Send + 'static,
    gone: impl Fn(),
    must_leave: impl Fn() -> bool,
) -> Result<Watched, Failure> {
    let has_terminal = io::stdout().is_terminal();
    let screen = spawn("screen", show)?;
    let (mut closed, mut waited_s) = (false, 0.0);
    while !screen.is_finished() {
        if has_terminal && !closed && is_closed() {
            closed = true;
            gone();
        }
        if must_leave() {
            waited_s += LOOK.as_secs_f64();
        }
        if waited_s > SCREEN_S {
            let reason =
                if closed { "the terminal is gone" } else { "the terminal takes nothing any more" };
            return Ok(Watched::Failed(reason.to_owned()));
        }
        thread::sleep(LOOK);
    }
    Ok(match screen.join() {
        Ok(Ok(exit)) => Watched::Left(exit),
        Ok(Err(error)) => Watched::Failed(error.to_string()),
        Err(panic) => Watched::Panicked(said(panic.as_ref()).to_owned()),
    })
}

/// Whether the terminal on standard output has been closed at its other end.
fn is_closed() -> bool {
    is_gone(Duration::ZERO).unwrap_or(true)
}

/// Whether the thread ends within so many seconds.
fn is_over_within<T>(thread: &JoinHandle<T>, seconds: f64) -> bool {
    wait_while(|waited_s| !thread.is_finished() && waited_s < seconds);
    thread.is_finished()
}

/// Looks again and again, with the seconds that have passed, until there is nothing more to wait for.
fn wait_while(is_to_wait: impl Fn(f64) -> bool) {
    let mut waited_s = 0.0;
    while is_to_wait(waited_s) {
        thread::sleep(LOOK);
        waited_s += LOOK.as_secs_f64();
    }
}

/// Waits for the drive's confirmed stop as long as that may take, then for the record. Work with nothing energised and
/// nothing half written, as a diagnosis, is left where it is.
fn is_over_after_stop<T>(thread: &JoinHandle<T>, ends: &Ends) -> bool {
    let mut on_s = 0.0;
    while let (DriveWord::MayBeOn { end_s }, false) = (ends.drive.get(), thread.is_finished()) {
        if on_s > end_s {
            return false;
        }
        thread::sleep(LOOK);
        on_s += LOOK.as_secs_f64();
    }
    wait_while(|waited_s| !thread.is_finished() && !signals::is_endable() && waited_s < RECORD_S);
    thread.is_finished()
}

/// What is said of work that did not come to its end.
fn unfinished(left: Left, drive: &DriveWord) -> Failure {
    let is_on = matches!(drive, DriveWord::MayBeOn { .. });
    match left {
        Left::Gone(failure) | Left::Panicked(failure) if !is_on => failure,
        left => Failure::with_help(
            match left {
                Left::Panicked(_) => INTERNAL,
                _ => INTERRUPTED,
            },
            "left by force: the bench did not confirm that it has stopped",
            "see that the motor stands still; the drive's watchdog stops it",
        ),
    }
}

/// A panic of the work, with what came of the stop that was sent on its way out.
fn bench_panicked(panic: &(dyn Any + Send), drive: &DriveWord) -> Failure {
    let stopped = match drive {
        DriveWord::Panicked(Ok(())) => "the drive was told to stop and took it".to_owned(),
        DriveWord::Panicked(Err(error)) => {
            format!("the drive did NOT confirm its stop: {error}; see that the motor stands still")
        }
        DriveWord::Off => "nothing was energised".to_owned(),
        DriveWord::MayBeOn { .. } => {
            "the drive was told to stop; see that the motor stands still".to_owned()
        }
    };
    Failure::internal(format!("the bench has panicked ({}); {stopped}", said(panic)))
}

/// The words of a panic.
fn said(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a word")
}

/// A thread with a name.
pub(crate) fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, Failure> {
    let thread = thread::Builder::new().name(name.to_owned());
    let cannot = |error| Failure::internal(format!("cannot start a thread: {error}"));
    thread.spawn(work).map_err(cannot)
}

//! How work on a drive ends: whatever ends the work or its screen, the drive is stopped, and the program continues only after
//! the drive has confirmed the stop.
//!
//! ```text
//! headless: work on this thread ---------------------------+-- returns, panics --> result
//! screen:   threads "bench" and "screen"; this one waits --'
//!             '-- left, failed, panicked, terminal closed --> hang up -> zero, disable, confirmed? -> result
//! ```

use std::any::Any;
use std::io::{self, IsTerminal as _};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::runtime::controls::{Controls, DrivePower, Ends};
use crate::runtime::failure::{Failure, INTERNAL, INTERRUPTED, LINK, TRIP};
use crate::runtime::output::Terminal;
use crate::runtime::signals;
use crate::tui::{Exit, LiveScreen, LiveSources, WorkerCell, is_gone, show};
use crate::workflow::{ProgressCell, RankingCell, RankingWatch};
use drivebench_bench::{Level, Notice, SnapshotCell};

/// Between two polls of threads that end.
const POLL: Duration = Duration::from_millis(50);

/// Where the work is shown.
pub(crate) enum Audience {
    /// Messages on stderr.
    Headless,
    /// A screen, with the steps of a workflow where there is one.
    Screen(Option<ProgressCell>),
    /// A screen of a run after which the program continues; the text names what follows `q`.
    FollowedBy(&'static str),
}

/// Work that is over, with how its screen was left.
pub(crate) struct Ended<T> {
    pub work: T,
    pub screen: ScreenEnd,
}

#[derive(Debug)]
pub(crate) enum ScreenEnd {
    NoScreen,
    /// By one of its keys, or at the end of the work.
    Screen(Exit),
    /// The terminal was closed, or failed.
    Gone(Failure),
    Panicked(Failure),
}

impl ScreenEnd {
    /// The failure of the command, where the run itself ended with `run`: a trip or a lost drive has priority over a failure of
    /// the screen, a fault of this program over an interruption.
    pub(crate) fn conclude(self, run: Option<Failure>) -> Result<(), Failure> {
        let of_screen = match self {
            Self::NoScreen | Self::Screen(_) => None,
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

/// Does the work, shown on a screen or not.
///
/// # Errors
/// The work's own failure; else that of a panic, after the drive was stopped.
pub(crate) fn conduct<T: Send + 'static>(
    terminal: &Terminal,
    audience: Audience,
    work: impl FnOnce(&Controls) -> Result<T, Failure> + Send + 'static,
) -> Result<Ended<T>, Failure> {
    match audience {
        Audience::Headless => {
            let (listener, notices) = channel();
            let (controls, ends) = Controls::new(SnapshotCell::with_notices(listener));
            signals::end_run_by_signals(ends)?;
            let work = alone(terminal, controls, notices, work)?;
            Ok(Ended { work, screen: ScreenEnd::NoScreen })
        }
        Audience::Screen(progress) => on_screen(terminal, progress, None, work),
        Audience::FollowedBy(followed_by) => on_screen(terminal, None, Some(followed_by), work),
    }
}

fn on_screen<T: Send + 'static>(
    terminal: &Terminal,
    progress: Option<ProgressCell>,
    followed_by: Option<&'static str>,
    work: impl FnOnce(&Controls) -> Result<T, Failure> + Send + 'static,
) -> Result<Ended<T>, Failure> {
    let (controls, ends) = Controls::new(SnapshotCell::default());
    signals::end_run_by_signals(ends.clone())?;
    let appearance = terminal.appearance();
    let shown =
        move |sources| show(LiveScreen::new(LiveSources { followed_by, ..sources }), appearance);
    with_screen(terminal, controls, &ends, progress, shown, work)
}

/// Without a screen: warnings go to stderr at once, by a thread that may wait for it.
pub(crate) fn alone<T>(
    terminal: &Terminal,
    controls: Controls,
    notices: Receiver<Notice>,
    work: impl FnOnce(&Controls) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let drive = controls.drive.clone();
    let terminal = terminal.clone();
    let printer = spawn("notices", move || {
        let mut printed: Vec<String> = Vec::new();
        for notice in notices {
            if notice.level != Level::Info && !printed.contains(&notice.text) {
                terminal.message(&format!("warning: {}", notice.text));
                printed.push(notice.text);
            }
        }
    })?;
    let done = catch_unwind(AssertUnwindSafe(|| work(&controls)));
    drop(controls);
    let done = done.unwrap_or_else(|panic| Err(bench_panicked(panic.as_ref(), &drive.get())));
    // Warnings are printed before the result.
    let _ = printer.join();
    done
}

/// The work on a thread of its own while `show` has this one.
///
/// # Errors
/// As [`conduct`]; and where the work does not end in time.
pub(crate) fn with_screen<T: Send + 'static>(
    terminal: &Terminal,
    controls: Controls,
    ends: &Ends,
    progress: Option<ProgressCell>,
    show: impl FnOnce(LiveSources) -> io::Result<Exit> + Send + 'static,
    work: impl FnOnce(&Controls) -> Result<T, Failure> + Send + 'static,
) -> Result<Ended<T>, Failure> {
    let worker = WorkerCell::default();
    let ranking = RankingCell::default();
    rank_effects(ends.snapshots.reader(), ranking.clone(), worker.clone())?;
    let sources = LiveSources {
        snapshots: ends.snapshots.clone(),
        ranking,
        workflow: progress,
        followed_by: None,
        intents: ends.intents.clone(),
        worker: worker.clone(),
        stop_requested: Arc::clone(&ends.stop_requested),
        hang_up: Arc::clone(&ends.leaving),
    };
    let held = terminal.hold();
    let thread = spawn("bench", move || {
        let _finish = worker.finish_on_drop();
        work(&controls)
    })?;
    let shown = watched(
        move || show(sources),
        || ends.hang_up(),
        || thread.is_finished() && ends.leaving.load(Ordering::Acquire),
    )?;
    let screen = match shown {
        ScreenReturn::Left(exit) => ScreenEnd::Screen(exit),
        ScreenReturn::Failed(reason) => ScreenEnd::Gone(Failure::with_help(
            INTERRUPTED,
            format!("the screen has failed: {reason}"),
            "the drive was stopped; start the command again to repeat the run",
        )),
        ScreenReturn::Panicked(text) => ScreenEnd::Panicked(Failure::internal(format!(
            "the screen has panicked ({text}); the run was ended"
        ))),
    };
    if !matches!(screen, ScreenEnd::Screen(_)) {
        ends.hang_up();
    }
    drop(held);
    let is_over = match &screen {
        ScreenEnd::Screen(Exit::Forced) => {
            wait_while(|waited_s| !thread.is_finished() && waited_s < 5.0);
            thread.is_finished()
        }
        ScreenEnd::Screen(_) | ScreenEnd::NoScreen => true,
        ScreenEnd::Gone(_) | ScreenEnd::Panicked(_) => is_over_after_stop(terminal, &thread, ends),
    };
    if !is_over {
        return Err(unfinished(screen, &ends.drive.get()));
    }
    let drive = ends.drive.clone();
    let done =
        thread.join().unwrap_or_else(|panic| Err(bench_panicked(panic.as_ref(), &drive.get())));
    match done {
        Ok(work) => Ok(Ended { work, screen }),
        Err(failure) => Err(screen
            .conclude(Some(failure))
            .err()
            .unwrap_or_else(|| Failure::internal("the work failed without a reason"))),
    }
}

/// Ranks the effects provisionally, twice a second, from the snapshots of the screen, for as long as the work goes on. It
/// shares nothing else with the bench. Never joined: it has nothing to finish.
fn rank_effects(
    snapshots: SnapshotCell,
    ranking: RankingCell,
    worker: WorkerCell,
) -> Result<(), Failure> {
    spawn("ranking", move || {
        let mut watch = RankingWatch::default();
        let mut ranked = None;
        while !worker.is_finished() {
            let latest = snapshots.latest();
            // Between two runs and during an analysis there is no new snapshot.
            if !ranked.as_ref().is_some_and(|ranked| Arc::ptr_eq(ranked, &latest)) {
                watch.take(&latest);
                ranking.publish(watch.rank().unwrap_or_default());
                ranked = Some(latest);
            }
            thread::sleep(Duration::from_millis(500));
        }
    })?;
    Ok(())
}

pub(crate) enum ScreenReturn {
    Left(Exit),
    /// With the reason.
    Failed(String),
    /// With the text of the panic.
    Panicked(String),
}

/// Shows a screen on a thread of its own, so that nothing that happens to it or to its terminal blocks this one: a read of
/// keys from a terminal that is just being closed may never return. `gone` is called, once or more often, when the terminal
/// is closed; a screen that does not return within 2 s when it `must_leave` is abandoned.
pub(crate) fn watched(
    show: impl FnOnce() -> io::Result<Exit> + Send + 'static,
    gone: impl Fn(),
    must_leave: impl Fn() -> bool,
) -> Result<ScreenReturn, Failure> {
    let has_terminal = io::stdout().is_terminal();
    let screen = spawn("screen", show)?;
    let (mut closed, mut waited_s) = (false, 0.0);
    while !screen.is_finished() {
        // Closed at its other end.
        if has_terminal && !closed && is_gone(Duration::ZERO).unwrap_or(true) {
            closed = true;
            gone();
        }
        if must_leave() {
            waited_s += POLL.as_secs_f64();
        }
        if waited_s > 2.0 {
            let reason =
                if closed { "the terminal is gone" } else { "the terminal does not respond" };
            return Ok(ScreenReturn::Failed(reason.to_owned()));
        }
        thread::sleep(POLL);
    }
    Ok(match screen.join() {
        Ok(Ok(exit)) => ScreenReturn::Left(exit),
        Ok(Err(error)) => ScreenReturn::Failed(error.to_string()),
        Err(panic) => ScreenReturn::Panicked(panic_text(panic.as_ref()).to_owned()),
    })
}

/// Polls, with the seconds that have passed, until the condition is false.
fn wait_while(is_to_wait: impl Fn(f64) -> bool) {
    let mut waited_s = 0.0;
    while is_to_wait(waited_s) {
        thread::sleep(POLL);
        waited_s += POLL.as_secs_f64();
    }
}

/// Waits for the drive's confirmed stop as long as that may take, then 30 s at most for the record. Work with nothing
/// energised and nothing half written, as a diagnosis, is abandoned.
fn is_over_after_stop<T>(terminal: &Terminal, thread: &JoinHandle<T>, ends: &Ends) -> bool {
    let mut on_s = 0.0;
    while let (DrivePower::MayBeOn { end_s }, false) = (ends.drive.get(), thread.is_finished()) {
        if on_s > end_s {
            return false;
        }
        thread::sleep(POLL);
        on_s += POLL.as_secs_f64();
    }
    wait_while(|waited_s| !thread.is_finished() && !terminal.is_endable() && waited_s < 30.0);
    thread.is_finished()
}

fn unfinished(screen: ScreenEnd, drive: &DrivePower) -> Failure {
    let is_on = matches!(drive, DrivePower::MayBeOn { .. });
    match screen {
        ScreenEnd::Gone(failure) | ScreenEnd::Panicked(failure) if !is_on => failure,
        screen => Failure::with_help(
            match screen {
                ScreenEnd::Panicked(_) => INTERNAL,
                _ => INTERRUPTED,
            },
            "closed by force: the bench did not confirm that it has stopped",
            "see that the motor stands still; the drive's watchdog stops it",
        ),
    }
}

/// A panic of the work, with the result of the stop that was sent on its way out.
fn bench_panicked(panic: &(dyn Any + Send), drive: &DrivePower) -> Failure {
    let stopped = match drive {
        DrivePower::Panicked(Ok(())) => "the drive has confirmed its stop".to_owned(),
        DrivePower::Panicked(Err(error)) => {
            format!("the drive did NOT confirm its stop: {error}; see that the motor stands still")
        }
        DrivePower::Off => "nothing was energised".to_owned(),
        DrivePower::MayBeOn { .. } => {
            "a stop was sent to the drive; see that the motor stands still".to_owned()
        }
    };
    Failure::internal(format!("the bench has panicked ({}); {stopped}", panic_text(panic)))
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no text")
}

pub(crate) fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, Failure> {
    let thread = thread::Builder::new().name(name.to_owned());
    let cannot = |error| Failure::internal(format!("cannot start a thread: {error}"));
    thread.spawn(work).map_err(cannot)
}

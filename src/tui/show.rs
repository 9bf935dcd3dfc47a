//! The loop: keys and cells in, effects out, a frame after each change.

use std::io;
use std::os::fd::AsFd as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;

use crossterm::event::{self, Event as TerminalEvent};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use super::model::Model;
use super::terminal::Owned;
use super::update::{Effect, Event};
use super::view::view;
use super::worker::WorkerCell;
use crate::bench::{Intent, SnapshotCell};
use crate::workflow::ProgressCell;

/// Longest time between two looks at the cells: 25 frames a second. A key is answered at once.
pub(super) const FRAME: Duration = Duration::from_millis(40);

/// What the screens are given; the worker holds the other ends.
#[derive(Debug)]
pub struct ShowOptions {
    pub snapshots: SnapshotCell,
    /// The steps of a workflow, where there is one.
    pub workflow: Option<ProgressCell>,
    pub intents: Sender<Intent>,
    pub worker: WorkerCell,
    /// Set with every stop: nothing more is to be started, also between two runs, where nobody reads intents.
    pub stop_requested: Arc<AtomicBool>,
    /// Set by signals (SIGTERM, SIGHUP): the screens close by themselves as soon as the worker has finished.
    pub hang_up: Arc<AtomicBool>,
}

/// Why the screens were left. The motor's outcome is the worker's to tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// The work was over.
    Finished,
    /// `d` when the work was over: the diagnosis is to be gone on with by hand.
    Diagnosis,
    /// `q` before the end; the worker has been told to stop.
    Quit,
    /// Ctrl-C; the worker has stopped.
    Interrupted,
    /// Ctrl-C three times: the worker did not come back. Wait for it, but not for ever.
    Forced,
    /// Another thread panicked; its message is on standard error.
    WorkerPanicked,
}

/// Shows the screens on the calling thread until they are left.
///
/// # Errors
/// Standard output is not a terminal, or the terminal fails. A bench must not go on under a screen that has failed or
/// panicked: that is for the caller to see to.
pub fn show(options: &ShowOptions) -> io::Result<Exit> {
    let mut owned = Owned::take()?;
    run(&mut owned, options)
}

/// Waits for a key, for `longest` at most; whether the terminal has been closed.
pub fn is_gone(longest: Duration) -> io::Result<bool> {
    let stdout = io::stdout();
    let mut terminal = [PollFd::new(stdout.as_fd(), PollFlags::POLLIN)];
    let timeout = PollTimeout::try_from(longest).unwrap_or(PollTimeout::ZERO);
    match poll(&mut terminal, timeout) {
        // A signal, as that of a change of size, ends the wait.
        Ok(_) | Err(Errno::EINTR) => {}
        Err(error) => return Err(error.into()),
    }
    let gone = PollFlags::POLLHUP | PollFlags::POLLERR | PollFlags::POLLNVAL;
    Ok(terminal[0]
        .revents()
        .is_some_and(|seen| seen.intersects(gone)))
}

fn run(owned: &mut Owned, options: &ShowOptions) -> io::Result<Exit> {
    let mut model = Model::new(options.workflow.as_ref().map(ProgressCell::latest));
    let mut changed = true;
    loop {
        for event in changes(&model, options) {
            changed = true;
            if let Some(exit) = act(options, model.update(event)) {
                return Ok(exit);
            }
        }
        if owned.panicked_elsewhere() && model.is_finished() {
            return Ok(Exit::WorkerPanicked);
        }
        if std::mem::take(&mut changed) {
            owned.terminal.draw(|frame| view(&model, frame))?;
        }
        // Asked of the terminal itself first: crossterm reads one that is gone for ever.
        if is_gone(FRAME)? {
            return Err(io::Error::other("the terminal is gone"));
        }
        while event::poll(Duration::ZERO)? {
            changed = true;
            // Everything else, as a change of size, only needs a new frame.
            if let TerminalEvent::Key(key) = event::read()?
                && let Some(exit) = act(options, model.update(Event::Key(key)))
            {
                return Ok(exit);
            }
        }
    }
}

/// What has changed in the cells since the model last looked.
fn changes(model: &Model, options: &ShowOptions) -> Vec<Event> {
    let mut events = Vec::new();
    // The worker publishes before it finishes: read in the other order, the last snapshot cannot be missed.
    let hang_up = options.hang_up.load(Ordering::Acquire);
    let worker = options.worker.state(hang_up);
    let snapshot = options.snapshots.latest();
    if !Arc::ptr_eq(&snapshot, &model.snapshot) {
        events.push(Event::Snapshot(snapshot));
    }
    if let Some(cell) = &options.workflow {
        let latest = cell.latest();
        if !model
            .workflow
            .as_ref()
            .is_some_and(|shown| Arc::ptr_eq(shown, &latest))
        {
            events.push(Event::Workflow(latest));
        }
    }
    if worker != model.worker {
        events.push(Event::Worker(worker));
    }
    events
}

fn act(options: &ShowOptions, effects: Vec<Effect>) -> Option<Exit> {
    let mut exit = None;
    for effect in effects {
        match effect {
            Effect::Send(intent) => {
                // Between two runs nobody listens; `stop_requested` covers that.
                let _ = options.intents.send(intent);
            }
            Effect::RequestStop => options.stop_requested.store(true, Ordering::Release),
            Effect::Leave(reason) => exit = Some(reason),
        }
    }
    exit
}

//! Controls of a run: signals, the intents of a screen, what the screen sees, and whether the drive may be on.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};

use drivebench_bench::{Intent, SnapshotCell};

/// What ties a run to the world. The thread that works has it; whoever ends it holds [`Ends`].
pub struct Controls {
    pub snapshots: SnapshotCell,
    /// Raised once for each request to end: the first ramps down, the second switches the output off at once.
    pub interrupted: Arc<AtomicBool>,
    /// Set by every stop key: nothing more is to be started, also between two runs, where nobody reads intents.
    pub stop_requested: Arc<AtomicBool>,
    /// What the rig tells of its drive.
    pub drive: DriveCell,
    intents: Receiver<Intent>,
}

impl Controls {
    /// Controls that nobody pulls but who holds the other ends.
    pub fn new(snapshots: SnapshotCell) -> (Self, Ends) {
        let (sender, intents) = channel();
        let controls = Self {
            snapshots,
            interrupted: Arc::default(),
            stop_requested: Arc::default(),
            drive: DriveCell::default(),
            intents,
        };
        let ends = Ends {
            // Whoever hears the notices hears that the work is over when the worker's controls are gone.
            snapshots: controls.snapshots.reader(),
            interrupted: Arc::clone(&controls.interrupted),
            stop_requested: Arc::clone(&controls.stop_requested),
            drive: controls.drive.clone(),
            intents: sender,
            hung_up: Arc::default(),
            leaving: Arc::default(),
        };
        (controls, ends)
    }

    /// Whether nothing more is to be started.
    pub fn is_stopped(&self) -> bool {
        self.interrupted.load(Ordering::Acquire) || self.stop_requested.load(Ordering::Acquire)
    }

    /// The flags of which one is up then.
    pub(crate) fn stop_flags(&self) -> [Arc<AtomicBool>; 2] {
        [&self.interrupted, &self.stop_requested].map(Arc::clone)
    }

    pub const fn intents(&self) -> &Receiver<Intent> {
        &self.intents
    }
}

/// The other ends of [`Controls`], for whoever may end the run.
#[derive(Clone)]
pub struct Ends {
    pub snapshots: SnapshotCell,
    pub interrupted: Arc<AtomicBool>,
    pub stop_requested: Arc<AtomicBool>,
    pub drive: DriveCell,
    pub intents: Sender<Intent>,
    hung_up: Arc<AtomicBool>,
    /// Set by every signal: a screen closes by itself as soon as the work is over.
    pub leaving: Arc<AtomicBool>,
}

impl Ends {
    /// A person or another program asks for the end; asked twice, the output goes off at once.
    pub fn interrupt(&self) {
        self.leaving.store(true, Ordering::Release);
        self.interrupted.store(true, Ordering::Release);
    }

    /// Nobody is there any more: the terminal is closed, or the screen has failed. However often that shows, it asks once,
    /// so that the output ramps down as its profile says.
    pub fn hang_up(&self) {
        self.leaving.store(true, Ordering::Release);
        self.stop_requested.store(true, Ordering::Release);
        if !self.hung_up.swap(true, Ordering::AcqRel) {
            self.interrupted.store(true, Ordering::Release);
        }
    }
}

/// Whether a drive may be on, as the rig tells it.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum DriveWord {
    /// Nothing is energised by us.
    #[default]
    Off,
    /// The drive may be on. Told to end, it takes at most so long until its stop is confirmed, s.
    MayBeOn { end_s: f64 },
    /// The work has panicked: what came of the stop that was sent then.
    Panicked(Result<(), String>),
}

/// The latest word, shared between the rig and whoever waits for the end.
#[derive(Clone, Debug, Default)]
pub struct DriveCell(Arc<Mutex<DriveWord>>);

impl DriveCell {
    pub fn get(&self) -> DriveWord {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn set(&self, word: DriveWord) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = word;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_that_is_closed_asks_once_and_a_person_as_often_as_they_like() {
        let (controls, ends) = Controls::new(SnapshotCell::default());
        let asked = || controls.interrupted.swap(false, Ordering::AcqRel);
        ends.hang_up();
        assert!(asked() && controls.is_stopped());
        // SIGHUP, the screen's own look at its terminal, a shell that passes the signal on.
        ends.hang_up();
        assert!(!asked());
        ends.interrupt();
        assert!(asked());
        ends.interrupt();
        assert!(asked());
    }
}

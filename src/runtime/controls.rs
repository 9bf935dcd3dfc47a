//! Controls of a run: signals, the intents and the snapshots of a screen, and whether the drive may be on.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};

use drivebench_bench::{Intent, SnapshotCell};

/// The inputs and outputs of the thread that works; whoever may end it holds [`Ends`].
pub(crate) struct Controls {
    pub snapshots: SnapshotCell,
    /// Raised for each request to end: the first ramps down, the second switches the output off at once.
    pub interrupted: Arc<AtomicBool>,
    /// Set by every stop key: nothing more is to be started, also between two runs, where intents are not read.
    pub stop_requested: Arc<AtomicBool>,
    pub drive: DriveCell,
    intents: Receiver<Intent>,
}

impl Controls {
    pub(crate) fn new(snapshots: SnapshotCell) -> (Self, Ends) {
        let (sender, intents) = channel();
        let controls = Self {
            snapshots,
            interrupted: Arc::default(),
            stop_requested: Arc::default(),
            drive: DriveCell::default(),
            intents,
        };
        let ends = Ends {
            // The receiver of the notices ends with the worker's controls.
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
    pub(crate) fn is_stopped(&self) -> bool {
        self.interrupted.load(Ordering::Acquire) || self.stop_requested.load(Ordering::Acquire)
    }

    /// The flags of which one is up when [`is_stopped`](Self::is_stopped).
    pub(crate) fn stop_flags(&self) -> [Arc<AtomicBool>; 2] {
        [&self.interrupted, &self.stop_requested].map(Arc::clone)
    }

    pub(crate) const fn intents(&self) -> &Receiver<Intent> {
        &self.intents
    }
}

/// The other ends of [`Controls`], for whoever may end the run.
#[derive(Clone)]
pub(crate) struct Ends {
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
    /// A person or another program requests the end; requested twice, the output goes off at once.
    pub(crate) fn interrupt(&self) {
        self.leaving.store(true, Ordering::Release);
        self.interrupted.store(true, Ordering::Release);
    }

    /// The terminal is closed, or the screen has failed. Repeated calls count as one request, so that the output ramps down.
    pub(crate) fn hang_up(&self) {
        self.leaving.store(true, Ordering::Release);
        self.stop_requested.store(true, Ordering::Release);
        if !self.hung_up.swap(true, Ordering::AcqRel) {
            self.interrupted.store(true, Ordering::Release);
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) enum DrivePower {
    /// Nothing is energised by us.
    #[default]
    Off,
    /// At most `end_s` pass from a request to end to the confirmed stop, s.
    MayBeOn { end_s: f64 },
    /// The work has panicked: the result of the stop that was sent then.
    Panicked(Result<(), String>),
}

/// Shared between the rig and whoever waits for the end.
#[derive(Clone, Debug, Default)]
pub(crate) struct DriveCell(Arc<Mutex<DrivePower>>);

impl DriveCell {
    pub(crate) fn get(&self) -> DrivePower {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn set(&self, power: DrivePower) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = power;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_terminal_requests_one_end_and_a_person_each_time() {
        let (controls, ends) = Controls::new(SnapshotCell::default());
        let requested = || controls.interrupted.swap(false, Ordering::AcqRel);
        ends.hang_up();
        assert!(requested() && controls.is_stopped());
        // By SIGHUP and by the screen.
        ends.hang_up();
        assert!(!requested());
        ends.interrupt();
        assert!(requested());
        ends.interrupt();
        assert!(requested());
    }
}

//! How the thread that does the work tells the screen that it is done.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the worker still works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WorkerState {
    Working,
    /// Nothing more will happen; the screen stays until it is closed.
    Finished,
    /// Nothing more will happen and nobody may be there to press a key (SIGTERM, SIGHUP): the screen closes.
    Leave,
}

/// Shared between worker and screen.
#[derive(Clone, Debug, Default)]
pub struct WorkerCell(Arc<AtomicBool>);

impl WorkerCell {
    /// The work is over; the screen shows the end until `q`.
    pub fn finish(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Calls `finish` when dropped: held by the worker, it covers every return and a panic.
    #[must_use = "the work counts as finished as soon as this is dropped"]
    pub fn finish_on_drop(&self) -> FinishOnDrop {
        FinishOnDrop(self.clone())
    }

    pub(super) fn state(&self, hang_up: bool) -> WorkerState {
        match (self.0.load(Ordering::Acquire), hang_up) {
            (false, _) => WorkerState::Working,
            (true, false) => WorkerState::Finished,
            (true, true) => WorkerState::Leave,
        }
    }
}

/// See [`WorkerCell::finish_on_drop`].
#[derive(Debug)]
pub struct FinishOnDrop(WorkerCell);

impl Drop for FinishOnDrop {
    fn drop(&mut self) {
        self.0.finish();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_that_panics_has_finished() {
        let cell = WorkerCell::default();
        let inner = cell.clone();
        let worker = std::thread::spawn(move || {
            let _guard = inner.finish_on_drop();
            assert_eq!(inner.state(true), WorkerState::Working);
            std::panic::resume_unwind(Box::new("on purpose"));
        });
        assert!(worker.join().is_err());
        assert_eq!(cell.state(false), WorkerState::Finished);
        assert_eq!(cell.state(true), WorkerState::Leave);
    }
}

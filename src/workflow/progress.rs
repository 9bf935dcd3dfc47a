//! What a screen shows of the loop.

use std::sync::{Arc, Mutex, PoisonError};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepState {
    Waiting,
    Active,
    Done,
    Failed,
}

/// One step of the loop with its figure, or its reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepView {
    pub title: String,
    pub state: StepState,
    pub line: String,
}

/// The loop so far, and the report once it is over.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    pub steps: Vec<StepView>,
    pub report: Vec<String>,
    pub finished: bool,
}

/// The latest progress, shared between the worker and the screen; neither waits for the other.
#[derive(Clone, Debug, Default)]
pub struct ProgressCell(Arc<Mutex<Arc<Progress>>>);

impl ProgressCell {
    pub fn latest(&self) -> Arc<Progress> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub fn publish(&self, progress: Progress) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(progress);
    }
}

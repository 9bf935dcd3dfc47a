//! What the steps screen shows of a workflow.

use std::sync::{Arc, Mutex, PoisonError};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StepState {
    #[default]
    Waiting,
    Active,
    Done,
    Failed,
}

impl StepState {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Active => "active",
            Self::Done => "done",
            Self::Failed => "failed",
        }
    }
}

/// One step and one line about it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StepLine {
    pub title: String,
    pub state: StepState,
    pub line: String,
}

/// The steps of a workflow, and what it has to say at its end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkflowView {
    pub steps: Vec<StepLine>,
    /// Verdict, ladder and parameters as lines of text; empty until the end.
    pub report: Vec<String>,
}

impl WorkflowView {
    /// Position and step of the one that is being done.
    pub(super) fn active(&self) -> Option<(usize, &StepLine)> {
        self.steps
            .iter()
            .enumerate()
            .find(|(_, step)| step.state == StepState::Active)
    }
}

/// The latest view, shared between workflow and screen. Neither waits for the other.
#[derive(Clone, Debug, Default)]
pub struct WorkflowCell(Arc<Mutex<Arc<WorkflowView>>>);

impl WorkflowCell {
    pub fn latest(&self) -> Arc<WorkflowView> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub fn publish(&self, view: WorkflowView) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(view);
    }
}

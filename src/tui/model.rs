//! What is shown, and nothing else.

use std::sync::Arc;

use super::worker::WorkerState;
use crate::bench::{Phase, Snapshot, Target};
use crate::sample::DriveState;
use crate::workflow::Progress;

/// Lengths of the time axis that the zoom key goes through, s.
pub(super) const ZOOM_S: [f64; 5] = [10.0, 5.0, 2.0, 1.0, 0.5];

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Screen {
    #[default]
    Live,
    Parameters,
    Steps,
}

impl Screen {
    pub(super) const ALL: [Self; 3] = [Self::Live, Self::Parameters, Self::Steps];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Live => "live",
            Self::Parameters => "parameters",
            Self::Steps => "steps",
        }
    }
}

/// The state of the screens.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub(super) snapshot: Arc<Snapshot>,
    /// What scope and parameters show while the view is frozen; bars, notices and trips stay live.
    pub(super) frozen: Option<Arc<Snapshot>>,
    pub(super) workflow: Option<Arc<Progress>>,
    pub(super) worker: WorkerState,
    pub(super) screen: Screen,
    pub(super) help: bool,
    /// First row of the help that is shown.
    pub(super) help_row: usize,
    /// On hardware a start is asked for twice.
    pub(super) confirm_start: bool,
    /// Index into [`ZOOM_S`].
    pub(super) zoom: usize,
    /// First line shown of the steps screen.
    pub(super) scroll: usize,
    pub(super) marks: u32,
    /// Answer to the last key.
    pub(super) message: Option<String>,
    /// Leaves as soon as the worker has finished.
    pub(super) leaving: Option<Leaving>,
    pub(super) interrupts: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Leaving {
    Quit,
    Interrupted,
}

impl Model {
    pub(super) fn new(workflow: Option<Arc<Progress>>) -> Self {
        Self {
            snapshot: Arc::default(),
            frozen: None,
            workflow,
            worker: WorkerState::Working,
            screen: Screen::Live,
            help: false,
            help_row: 0,
            confirm_start: false,
            zoom: 0,
            scroll: 0,
            marks: 0,
            message: None,
            leaving: None,
            interrupts: 0,
        }
    }

    /// The snapshot of the scope and the parameters.
    pub(super) fn viewed(&self) -> &Snapshot {
        self.frozen.as_ref().unwrap_or(&self.snapshot)
    }

    pub(super) fn is_finished(&self) -> bool {
        self.worker != WorkerState::Working
    }

    /// No run has begun and no report has come.
    pub(super) fn has_shown_nothing(&self) -> bool {
        self.snapshot.phase.is_none() && !self.shows_report()
    }

    pub(super) fn shows_report(&self) -> bool {
        let workflow = self.workflow.as_ref();
        workflow.is_some_and(|workflow| !workflow.report.is_empty())
    }

    /// Whether the whole loop is over, so that its runs can be diagnosed by hand.
    pub(super) fn has_report(&self) -> bool {
        self.is_finished() && self.shows_report()
    }

    /// Whether the drive's output may be on, as far as the screen knows.
    pub(super) fn is_energised(&self) -> bool {
        let phase = self.snapshot.phase;
        if self.is_finished() || phase.is_some_and(Phase::is_final) {
            return false;
        }
        phase.is_some_and(Phase::is_recorded)
            || self.snapshot.drive_state == Some(DriveState::Running)
    }

    pub(super) fn waits_for_start(&self) -> bool {
        !self.is_finished() && matches!(self.snapshot.phase, Some(Phase::Safe | Phase::Armed))
    }

    pub(super) fn is_hardware(&self) -> bool {
        self.snapshot.target == Target::Hardware
    }

    /// The screens that there are, in the order of the Tab key.
    pub(super) fn screens(&self) -> &'static [Screen] {
        if self.workflow.is_some() {
            &Screen::ALL
        } else {
            &Screen::ALL[..2]
        }
    }

    pub(super) const fn window_s(&self) -> f64 {
        ZOOM_S[self.zoom]
    }
}

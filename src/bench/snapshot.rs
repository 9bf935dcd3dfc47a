//! What a screen needs to know of a run, published some twenty times a second; it never reaches back into the run.

mod model_trace;
mod publisher;

pub(super) use publisher::{Publisher, RunState};

use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};

use super::guard::Trip;
use super::runner::Excitation;
use super::session::{Notice, Phase};
use super::timing::Timing;
use crate::drive::{Identity, LinkStatistics};
use crate::sample::{DriveState, ParameterEstimate};

/// Software or copper: shown on every screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// The drive itself says that it is software.
    Sim,
    #[default]
    Hardware,
}

impl Target {
    pub const fn of(identity: &Identity) -> Self {
        if identity.is_emulator {
            Self::Sim
        } else {
            Self::Hardware
        }
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Sim => "SIM",
            Self::Hardware => "HARDWARE",
        }
    }
}

/// One instant of the scope; NaN where a value is missing, so that a gap stays a gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracePoint {
    /// Since the first point of the run, s.
    pub time_s: f64,
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// Free run of the model under the same voltage.
    pub model_speed_rad_s: f64,
    /// What a speed loop follows; NaN without one.
    pub reference_rad_s: f64,
}

/// The state of a run at one instant; cloning copies a few words, two short lists and one shared trace.
#[derive(Clone, Debug, Default)]
pub struct Snapshot {
    pub name: String,
    pub link: String,
    pub target: Target,
    pub phase: Option<Phase>,
    pub drive_state: Option<DriveState>,
    pub elapsed_s: f64,
    pub total_s: f64,
    pub segment: Option<String>,
    /// The last seconds, oldest first.
    pub trace: Arc<Vec<TracePoint>>,
    pub estimates: Arc<Vec<ParameterEstimate>>,
    /// How far the data carry each parameter so far.
    pub excitation: Arc<Excitation>,
    /// Whether the model of the trace is the nameplate's or the identified one.
    pub model_is_identified: bool,
    pub link_statistics: LinkStatistics,
    pub timing: Timing,
    pub rows: u64,
    /// What the recorder could not write, if anything.
    pub recorder_error: Option<String>,
    /// The newest last.
    pub notices: Vec<Notice>,
    pub trip: Option<Trip>,
    /// The search for a drive that was lost: how it goes, and what came of it.
    pub reopening: Option<String>,
    /// Set once, when the run is over.
    pub outcome: Option<&'static str>,
}

/// The latest snapshot, shared between the runner and the screens. Neither waits for the other.
#[derive(Clone, Debug, Default)]
pub struct SnapshotCell {
    latest: Arc<Mutex<Arc<Snapshot>>>,
    /// Hears every notice as it comes, where nobody looks at snapshots.
    listener: Option<Sender<Notice>>,
}

impl SnapshotCell {
    /// A cell that passes on every notice as well.
    pub fn heard_by(listener: Sender<Notice>) -> Self {
        Self {
            listener: Some(listener),
            ..Self::default()
        }
    }

    /// The same cell for somebody who only looks.
    #[must_use]
    pub fn unheard(&self) -> Self {
        Self {
            latest: Arc::clone(&self.latest),
            listener: None,
        }
    }

    fn tell(&self, notice: &Notice) {
        if let Some(listener) = &self.listener {
            // Nobody listens any more: the notice is in the summary all the same.
            let _ = listener.send(notice.clone());
        }
    }

    pub fn latest(&self) -> Arc<Snapshot> {
        Arc::clone(&self.latest.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub fn publish(&self, snapshot: Snapshot) {
        *self.latest.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(snapshot);
    }
}

//! Collects what the runner sees and publishes it from time to time.

use std::collections::VecDeque;
use std::sync::Arc;

use super::model_trace::ModelTrace;
use super::{Snapshot, SnapshotCell, TracePoint};
use crate::bench::limits::Nameplate;
use crate::bench::runner::Excitation;
use crate::bench::session::{Notice, Session};
use crate::bench::timing::Timing;
use crate::drive::LinkStatistics;
use crate::recording::RecorderStatus;
use crate::sample::{Channel, Demand, ParameterEstimate, Sample};

/// Points kept for the scope: the widest screen has fewer columns.
const POINTS: usize = 1200;
/// Notices kept.
const NOTICES: usize = 50;
/// Snapshots per second of the run.
const SNAPSHOT_RATE_HZ: f64 = 20.0;

/// What the runner knows at one instant.
pub(in crate::bench) struct RunState<'a> {
    pub(in crate::bench) session: &'a Session,
    pub(in crate::bench) link: LinkStatistics,
    pub(in crate::bench) timing: Timing,
    pub(in crate::bench) recorder: RecorderStatus,
    pub(in crate::bench) estimates: Vec<ParameterEstimate>,
    pub(in crate::bench) excitation: Excitation,
    /// Only at the end.
    pub(in crate::bench) outcome: Option<&'static str>,
}

pub(in crate::bench) struct Publisher {
    cell: SnapshotCell,
    snapshot: Snapshot,
    points: VecDeque<TracePoint>,
    origin_s: Option<f64>,
    model: ModelTrace,
    next_s: f64,
}

impl Publisher {
    pub(in crate::bench) fn new(
        cell: SnapshotCell,
        first: Snapshot,
        motor: Option<&Nameplate>,
    ) -> Self {
        Self {
            cell,
            snapshot: first,
            points: VecDeque::with_capacity(POINTS),
            origin_s: None,
            model: ModelTrace::new(motor),
            next_s: f64::NEG_INFINITY,
        }
    }

    pub(in crate::bench) fn sample(
        &mut self,
        sample: &Sample,
        demand: Demand,
        reference_rad_s: Option<f64>,
    ) {
        let origin_s = *self.origin_s.get_or_insert(sample.time_s);
        let cell = |channel| sample.get(channel).unwrap_or(f64::NAN);
        if self.points.len() == POINTS {
            self.points.pop_front();
        }
        self.points.push_back(TracePoint {
            time_s: sample.time_s - origin_s,
            voltage_v: cell(Channel::Voltage),
            current_a: cell(Channel::Current),
            speed_rad_s: cell(Channel::Speed),
            model_speed_rad_s: self.model.follow(sample, demand),
            reference_rad_s: reference_rad_s.unwrap_or(f64::NAN),
        });
    }

    pub(in crate::bench) fn notice(&mut self, notice: Notice) {
        self.cell.tell(&notice);
        if self.snapshot.notices.len() == NOTICES {
            self.snapshot.notices.remove(0);
        }
        self.snapshot.notices.push(notice);
    }

    pub(in crate::bench) fn is_due(&self, now_s: f64) -> bool {
        now_s >= self.next_s
    }

    pub(in crate::bench) fn publish(&mut self, now_s: f64, state: RunState<'_>) {
        let RunState {
            session,
            link,
            timing,
            recorder,
            estimates,
            excitation,
            outcome,
        } = state;
        self.next_s = now_s + 1.0 / SNAPSHOT_RATE_HZ;
        if !self.model.is_identified() {
            self.model.learn(&estimates);
        }
        let (elapsed_s, total_s) = session.progress_s(now_s);
        let snapshot = &mut self.snapshot;
        snapshot.phase = Some(session.phase());
        snapshot.drive_state = session.last_sample().and_then(|sample| sample.state);
        (snapshot.elapsed_s, snapshot.total_s) = (elapsed_s, total_s);
        snapshot.segment = session.segment_name().map(str::to_owned);
        snapshot.trace = Arc::new(self.points.iter().copied().collect());
        snapshot.estimates = Arc::new(estimates);
        snapshot.excitation = Arc::new(excitation);
        snapshot.model_is_identified = self.model.is_identified();
        snapshot.link_statistics = link;
        snapshot.timing = timing;
        snapshot.rows = recorder.rows as u64;
        snapshot.recorder_error = recorder.error;
        snapshot.trip = session.guard().tripped().cloned();
        snapshot.outcome = outcome;
        self.cell.publish(snapshot.clone());
    }
}

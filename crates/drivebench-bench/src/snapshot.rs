//! Snapshot of a run for a screen, published twenty times a second of the run; read-only.

use drivebench_model::tabulated;
use std::collections::VecDeque;
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};

use super::limits::{MODEL_KEYS, Nameplate};
use super::live_online::Excitation;
use super::plan::under_voltage;
use super::push_within;
use super::session::{Notice, Phase, Session};
use super::stop::Stop;
use super::timing::Timing;
use super::trip::Trip;
use drivebench_identify::online::Frozen;
use drivebench_link::{Identity, LinkStatistics};
use drivebench_model::plant::{Input, Model, Motor, Plant, Scenario, State, Trajectory};
use drivebench_model::sample::{Channel, Demand, DriveState, ParameterEstimate, Sample, Verdict};

tabulated! {
    /// Emulator or hardware: shown on every screen.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Target {
        /// By the identity of the drive.
        Sim = "SIM",
        #[default]
        Hardware = "HARDWARE",
    }
    pub const fn name(self) -> &'static str;
}

impl Target {
    pub const fn of(identity: &Identity) -> Self {
        if identity.is_emulator { Self::Sim } else { Self::Hardware }
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
    /// Of a speed loop; NaN without one.
    pub reference_rad_s: f64,
    /// Voltage command, and when it reached the motor, on the same clock; NaN where it is not known.
    pub command_v: f64,
    pub applied_s: f64,
}

/// Innovation of the on-line estimators at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InnovationPoint {
    /// On the time axis of the trace.
    pub time_s: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
}

/// The state of a run at one instant; traces are shared, so that a copy is cheap.
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
    /// Of the on-line estimators over the same seconds, one for each snapshot.
    pub innovations: Arc<Vec<InnovationPoint>>,
    pub estimates: Arc<Vec<ParameterEstimate>>,
    /// Persistence of excitation of each parameter so far.
    pub excitation: Arc<Excitation>,
    /// Time in which a limit of the drive froze the estimators.
    pub frozen: Frozen,
    /// Whether the model of the trace is the nameplate's or the identified one.
    pub model_is_identified: bool,
    pub link_statistics: LinkStatistics,
    pub timing: Timing,
    pub rows: u64,
    pub recorder_error: Option<String>,
    /// The newest last.
    pub notices: Vec<Notice>,
    pub trip: Option<Trip>,
    pub reopening: Option<String>,
    /// Set once, when the run is over.
    pub outcome: Option<&'static str>,
    /// Why zero output could not be confirmed then, if it could not.
    pub stop_error: Option<String>,
    /// Where its output was on.
    pub stop: Option<Stop>,
}

/// The latest value, shared between its thread and the screens; neither waits for the other.
#[derive(Clone, Debug, Default)]
pub struct Latest<T>(Arc<Mutex<Arc<T>>>);

impl<T> Latest<T> {
    pub fn latest(&self) -> Arc<T> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub fn publish(&self, value: T) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(value);
    }
}

#[derive(Clone, Debug, Default)]
pub struct SnapshotCell {
    latest: Latest<Snapshot>,
    /// Receives every notice at once, where no screen reads snapshots.
    notices: Option<Sender<Notice>>,
}

impl SnapshotCell {
    /// A cell that sends every notice as well.
    pub fn with_notices(notices: Sender<Notice>) -> Self {
        Self { notices: Some(notices), ..Self::default() }
    }

    /// The same cell for a reader.
    #[must_use]
    pub fn reader(&self) -> Self {
        Self { latest: self.latest.clone(), notices: None }
    }

    pub fn send(&self, notice: &Notice) {
        if let Some(notices) = &self.notices {
            // Without a receiver the notice is in the summary all the same.
            let _ = notices.send(notice.clone());
        }
    }

    pub fn latest(&self) -> Arc<Snapshot> {
        self.latest.latest()
    }

    pub fn publish(&self, snapshot: Snapshot) {
        self.latest.publish(snapshot);
    }
}

/// Points kept for the scope: the widest screen has fewer columns.
const POINTS: usize = 1200;

pub(super) struct Publisher {
    cell: SnapshotCell,
    snapshot: Snapshot,
    points: VecDeque<TracePoint>,
    innovations: VecDeque<InnovationPoint>,
    origin_s: Option<f64>,
    model: ModelTrace,
    pub(super) next_s: f64,
}

impl Publisher {
    pub(super) fn new(cell: SnapshotCell, first: Snapshot, motor: Option<&Nameplate>) -> Self {
        Self {
            cell,
            snapshot: first,
            points: VecDeque::with_capacity(POINTS),
            innovations: VecDeque::new(),
            origin_s: None,
            model: ModelTrace::new(motor),
            next_s: f64::NEG_INFINITY,
        }
    }

    pub(super) fn sample(&mut self, sample: &Sample, demand: Demand, reference_rad_s: Option<f64>) {
        let origin_s = *self.origin_s.get_or_insert(sample.time_s);
        let cell = |channel| sample.get(channel).unwrap_or(f64::NAN);
        let applied = sample.applied.map_or(sample.time_s, |applied| applied.time_s);
        let command_v = match demand {
            Demand::Voltage(volts) => volts,
            _ => f64::NAN,
        };
        let point = TracePoint {
            command_v,
            applied_s: applied - origin_s,
            time_s: sample.time_s - origin_s,
            voltage_v: cell(Channel::Voltage),
            current_a: cell(Channel::Current),
            speed_rad_s: cell(Channel::Speed),
            model_speed_rad_s: self.model.follow(sample, demand),
            reference_rad_s: reference_rad_s.unwrap_or(f64::NAN),
        };
        push_within(&mut self.points, point, POINTS);
    }

    /// Innovation of the newest sample; NaN without a prediction.
    pub(super) fn innovation(&mut self, innovation: Option<(f64, f64)>) {
        let Some(newest) = self.points.back() else {
            return;
        };
        let (current_a, speed_rad_s) = innovation.unwrap_or((f64::NAN, f64::NAN));
        let point = InnovationPoint { time_s: newest.time_s, current_a, speed_rad_s };
        push_within(&mut self.innovations, point, POINTS);
    }

    pub(super) fn notice(&mut self, notice: Notice) {
        self.cell.send(&notice);
        if self.snapshot.notices.len() == 50 {
            self.snapshot.notices.remove(0);
        }
        self.snapshot.notices.push(notice);
    }

    /// Publishes the state of the session, and what the runner puts in with `rest`.
    pub(super) fn publish(
        &mut self,
        now_s: f64,
        session: &Session,
        estimates: Vec<ParameterEstimate>,
        rest: impl FnOnce(&mut Snapshot),
    ) {
        self.next_s = now_s + 1.0 / 20.0;
        if !self.model.is_identified {
            self.model.adopt(&estimates);
        }
        let snapshot = &mut self.snapshot;
        snapshot.phase = Some(session.phase());
        snapshot.drive_state = session.last_sample().and_then(|sample| sample.state);
        (snapshot.elapsed_s, snapshot.total_s) = session.progress_s(now_s);
        snapshot.segment = session.segment_name().map(str::to_owned);
        snapshot.trace = Arc::new(self.points.iter().copied().collect());
        snapshot.innovations = Arc::new(self.innovations.iter().copied().collect());
        snapshot.estimates = Arc::new(estimates);
        snapshot.model_is_identified = self.model.is_identified;
        snapshot.trip = session.guard().tripped().cloned();
        rest(snapshot);
        self.cell.publish(snapshot.clone());
    }
}

/// Free run of the nameplate's model, then of the identified one as soon as all of its values are settled.
struct ModelTrace {
    plant: Option<Plant>,
    motor: Motor,
    state: State,
    last_s: Option<f64>,
    /// `None`: the output was off, or not known.
    voltage_v: Option<f64>,
    is_identified: bool,
    scenario: Scenario,
    out: Trajectory,
}

impl ModelTrace {
    /// Without a nameplate there is no model until one is identified.
    fn new(nameplate: Option<&Nameplate>) -> Self {
        let motor = nameplate.map(Nameplate::motor).unwrap_or_default();
        Self {
            plant: Plant::new(&Model::baseline(motor.clone()), Input::Voltage).ok(),
            motor,
            state: State::default(),
            last_s: None,
            voltage_v: None,
            is_identified: false,
            scenario: under_voltage("live", vec![0.0]),
            out: Trajectory::default(),
        }
    }

    /// Takes over estimates once every one of the five is settled.
    fn adopt(&mut self, estimates: &[ParameterEstimate]) {
        let mut motor = self.motor.clone();
        for key in MODEL_KEYS {
            match ParameterEstimate::find(estimates, key.key()) {
                Some(ParameterEstimate {
                    verdict: Verdict::Settled, value: Some(value), ..
                }) => motor.set(key, *value),
                _ => return,
            }
        }
        let model = Model::baseline(motor);
        if model.validate().is_ok()
            && let Ok(plant) = Plant::new(&model, Input::Voltage)
        {
            self.plant = Some(plant);
            self.is_identified = true;
        }
    }

    /// The model's speed at the sample, rad/s; NaN where there is none. `demand` is the command in force.
    fn follow(&mut self, sample: &Sample, demand: Demand) -> f64 {
        let now_s = sample.time_s;
        let now_v = match demand {
            Demand::Voltage(volts) => Some(volts),
            _ if demand.energises() => sample.get(Channel::Voltage),
            // Off: no current flows, and a drive that reports 0 V has not shorted the winding.
            _ => None,
        };
        let before_v = std::mem::replace(&mut self.voltage_v, now_v);
        let last_s = self.last_s.replace(now_s);
        // After a longer gap a new free run begins at the measurement.
        let is_next = |last_s: &f64| (0.0..0.5).contains(&(now_s - last_s));
        let (Some(plant), Some(now_v)) = (self.plant.as_mut(), now_v) else {
            return f64::NAN;
        };
        let Some((begin_s, before_v)) = last_s.filter(is_next).zip(before_v) else {
            let read = |channel| sample.get(channel).unwrap_or(0.0);
            self.state = State::at(read(Channel::Current), read(Channel::Speed));
            return self.state.speed_rad_s;
        };
        let applied_s = sample.applied.map_or(begin_s, |applied| applied.time_s);
        let applied_s = applied_s.clamp(begin_s, now_s);
        self.scenario.events.clear();
        if applied_s > begin_s {
            self.scenario.events.push((begin_s, before_v));
        }
        self.scenario.events.push((applied_s, now_v));
        self.scenario.sample_time_s[0] = now_s;
        plant.simulate_into(&self.scenario, self.state, &mut self.out);
        self.state = State::at(self.out.current_a[0], self.out.speed_rad_s[0]);
        self.state.speed_rad_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::near;

    #[test]
    fn the_model_is_not_shorted_while_the_output_is_off() {
        let mut model = ModelTrace::new(Some(&Nameplate::zk_22fc()));
        let at =
            |time_s| Sample::at(time_s).with(Channel::Speed, 100.0).with(Channel::Voltage, 0.0);
        for time_s in [0.0, 0.1] {
            assert!(model.follow(&at(time_s), Demand::Stop).is_nan());
        }
        near(model.follow(&at(0.2), Demand::Voltage(35.0)), 100.0, 1e-9);
    }
}

//! What the residual of a run leans on while the run goes on: a look every half second, on a thread of its own, at what the
//! screen is shown anyway.
//!
//! ```text
//! Snapshot (trace, estimates) --take--> LeaningWatch: the run so far, thinned to a bounded number of samples
//!                                          '--look--> Provisional, latest value in LeaningCell --> screen
//! ```
//!
//! The bench knows nothing of it: it reads the snapshot that is published for the screen, and what it makes of it is marked
//! as provisional.

use std::sync::{Arc, Mutex, PoisonError};

use drivebench_bench::{Snapshot, TracePoint};
use drivebench_diagnose::{Leaning, lean};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::recursive::INERTIA_HAS_CHANGED;
use drivebench_model::plant::{Input, Model, Motor, MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate};

/// Samples that are kept: beyond, every other one is left out.
const MOST_SAMPLES: usize = 4000;
/// Changes of the voltage that are kept: a run with more is looked at no further.
const MOST_EVENTS: usize = 8000;
/// Samples below which nothing is looked at.
const FEWEST_SAMPLES: usize = 200;

/// What the run so far seems to ask for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Provisional {
    /// The effects that the residual leans on, the one that explains most first.
    pub effects: Vec<Leaning>,
    /// Of the run that was looked at.
    pub seconds: f64,
}

impl Provisional {
    /// One line for the screen.
    pub fn line(&self) -> String {
        let seconds = self.seconds;
        let Some(first) = self.effects.first() else {
            return format!("provisional, {seconds:.0} s: the residual leans on no effect");
        };
        let named = |own: &Leaning| format!("{} {:.0} %", own.effect, 100.0 * own.share);
        let others = self.effects[1..].iter().filter(|own| own.equation == first.equation);
        let others: Vec<String> = others.take(2).map(named).collect();
        let or = if others.is_empty() { "" } else { ", or " };
        format!(
            "provisional, {seconds:.0} s: {} residual leans on {}{or}{}",
            first.equation,
            named(first),
            others.join(", ")
        )
    }
}

/// The latest look, shared between its thread and the screen. Neither waits for the other.
#[derive(Clone, Debug, Default)]
pub struct LeaningCell(Arc<Mutex<Arc<Provisional>>>);

impl LeaningCell {
    pub fn latest(&self) -> Arc<Provisional> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub fn publish(&self, found: Provisional) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(found);
    }
}

/// The run so far, as its snapshots showed it.
#[derive(Clone, Debug, Default)]
pub struct LeaningWatch {
    name: String,
    /// Every so many samples are kept.
    stride: usize,
    seen: usize,
    last_s: f64,
    times: Vec<f64>,
    current_a: Vec<f64>,
    speed_rad_s: Vec<f64>,
    events: Vec<(f64, f64)>,
    motor: Motor,
}

impl LeaningWatch {
    /// Takes in what is new in a snapshot. Another run begins anew.
    pub fn take(&mut self, snapshot: &Snapshot) {
        let newest = snapshot.trace.last().map_or(f64::NEG_INFINITY, |p| p.time_s);
        if snapshot.name != self.name || newest < self.last_s {
            *self = Self {
                name: snapshot.name.clone(),
                stride: 1,
                last_s: f64::NEG_INFINITY,
                ..Self::default()
            };
        }
        let new = snapshot.trace.partition_point(|p| p.time_s <= self.last_s);
        for point in &snapshot.trace[new..] {
            self.push(point);
        }
        self.last_s = self.last_s.max(newest);
        let inertia = ParameterEstimate::find(&snapshot.estimates, MotorKey::Inertia.key());
        let reason = inertia.and_then(|inertia| inertia.reason.as_deref());
        if reason.is_some_and(|reason| reason.starts_with(INERTIA_HAS_CHANGED)) {
            // What came before was another machine, to which the values that are found now do not belong.
            self.forget();
        }
        for key in MotorKey::ALL {
            let found = ParameterEstimate::find(&snapshot.estimates, key.key());
            if let Some(value) = found.and_then(|estimate| estimate.value) {
                self.motor.set(key, value);
            }
        }
    }

    fn forget(&mut self) {
        self.events.clear();
        for values in [&mut self.times, &mut self.current_a, &mut self.speed_rad_s] {
            values.clear();
        }
    }

    fn push(&mut self, point: &TracePoint) {
        if point.command_v.is_finite() && self.events.len() < MOST_EVENTS {
            let last = self.events.last().copied();
            let at_s = point.applied_s;
            let is_new = last.is_none_or(|(_, volts)| (volts - point.command_v).abs() > 0.0);
            if is_new && last.is_none_or(|(last_s, _)| at_s > last_s) {
                self.events.push((at_s, point.command_v));
            }
        }
        let is_kept = self.seen.is_multiple_of(self.stride.max(1));
        self.seen += 1;
        if !is_kept || self.events.is_empty() {
            return;
        }
        self.times.push(point.time_s);
        self.current_a.push(point.current_a);
        self.speed_rad_s.push(point.speed_rad_s);
        if self.times.len() >= MOST_SAMPLES {
            for values in [&mut self.times, &mut self.current_a, &mut self.speed_rad_s] {
                let mut index = 0;
                values.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
            }
            self.stride *= 2;
        }
    }

    /// What the residual leans on so far; `None` where there is too little to look at, or no model yet.
    pub fn look(&self) -> Option<Provisional> {
        if self.times.len() < FEWEST_SAMPLES || self.events.len() >= MOST_EVENTS {
            return None;
        }
        let mut motor = self.motor.clone();
        if motor.get(MotorKey::LoadTorque).is_none() {
            // Not told yet: what it would explain is taken out of the balance all the same.
            motor.set(MotorKey::LoadTorque, 0.0);
        }
        let model = Model::baseline(motor);
        model.require_complete().ok()?;
        let first = self.times.partition_point(|t| *t < self.events[0].0);
        let times = self.times[first..].to_vec();
        let seconds = times.last()? - times.first()?;
        let events = self.events.clone();
        let mut run =
            Scenario::planned("so far", Input::Voltage, Channel::VoltageCmd, events, times);
        run.current_a = self.current_a[first..].to_vec();
        run.speed_rad_s = self.speed_rad_s[first..].to_vec();
        let noise =
            NoiseFloor::from_standstill(&run).unwrap_or_else(|| NoiseFloor::from_spread(&run));
        let effects = lean(&model, &run, &noise).ok()?;
        Some(Provisional { effects, seconds })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::plant::testing::with_a_fan;

    /// A snapshot of a run with a fan up to a sample, with the last `kept` points, as it is published.
    fn snapshot(run: &Scenario, end: usize, kept: usize) -> Snapshot {
        let point = |k: usize| TracePoint {
            time_s: run.sample_time_s[k],
            voltage_v: run.input_at(run.sample_time_s[k]),
            current_a: run.current_a[k],
            speed_rad_s: run.speed_rad_s[k],
            model_speed_rad_s: f64::NAN,
            reference_rad_s: f64::NAN,
            command_v: run.input_at(run.sample_time_s[k]),
            applied_s: run.sample_time_s[k],
        };
        let estimate = |key: MotorKey| {
            let value = Motor::zk_22fc().get(key)?;
            let std = 0.001 * value;
            Some(ParameterEstimate::found(key.key().to_owned(), key.unit(), value, std, None))
        };
        let estimates = MotorKey::ALL.into_iter().filter_map(estimate).collect();
        Snapshot {
            name: "fan".to_owned(),
            trace: Arc::new((end.saturating_sub(kept)..end).map(point).collect()),
            estimates: Arc::new(estimates),
            ..Snapshot::default()
        }
    }

    #[test]
    fn a_run_with_a_fan_leans_on_it_before_it_is_over_and_says_that_this_is_provisional() {
        let run = with_a_fan(0);
        let mut watch = LeaningWatch::default();
        assert_eq!(watch.look(), None);
        for end in (0..900).step_by(60) {
            watch.take(&snapshot(&run, end, 200));
        }
        let found = watch.look().unwrap();
        assert_eq!(found.effects[0].effect, "quadratic_load", "{found:?}");
        assert!(found.line().starts_with("provisional, 4 s: torque residual leans on"));
        // Another run begins anew.
        let mut other = snapshot(&run, 50, 50);
        other.name = "another".to_owned();
        watch.take(&other);
        assert_eq!(watch.look(), None);
    }

    #[test]
    fn what_came_before_another_inertia_is_not_looked_at() {
        let run = with_a_fan(0);
        let mut watch = LeaningWatch::default();
        watch.take(&snapshot(&run, 600, 600));
        assert!(watch.look().is_some());
        let mut changed = snapshot(&run, 700, 200);
        let mut all = Arc::make_mut(&mut changed.estimates).iter_mut();
        let inertia = all.find(|own| own.key == MotorKey::Inertia.key()).unwrap();
        inertia.unsettle(format!("{INERTIA_HAS_CHANGED}: begun again"));
        watch.take(&changed);
        assert_eq!(watch.look(), None);
        watch.take(&snapshot(&run, 1000, 300));
        assert!(watch.look().is_some_and(|found| found.seconds < 2.0));
    }

    #[test]
    fn memory_and_work_are_bounded_however_long_the_run() {
        let mut watch = LeaningWatch::default();
        let run = with_a_fan(0);
        let base = snapshot(&run, 1000, 1000);
        for round in 0..60 {
            let later = |point: &TracePoint| TracePoint {
                time_s: point.time_s + 5.5 * f64::from(round),
                applied_s: point.applied_s + 5.5 * f64::from(round),
                ..*point
            };
            let trace = base.trace.iter().map(later).collect();
            watch.take(&Snapshot { trace: Arc::new(trace), ..base.clone() });
            assert!(watch.times.len() < MOST_SAMPLES && watch.events.len() <= MOST_EVENTS);
        }
        assert!(watch.times.len() > MOST_SAMPLES / 4);
        let found = watch.look().unwrap();
        assert!(found.seconds > 300.0, "{}", found.seconds);
    }
}

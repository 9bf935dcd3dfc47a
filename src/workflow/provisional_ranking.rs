//! Provisional ranking of the effects during a run: marginal screening of the residual to first order (Fan and Lv 2008),
//! every half second, on a thread of its own, from the snapshots that are published for the screen.
//!
//! ```text
//! Snapshot (trace, estimates) --take--> RankingWatch: the run so far, thinned to a bounded number of samples
//!                                          '--rank--> ProvisionalRanking, latest value in RankingCell --> screen
//! ```

use drivebench_bench::{Snapshot, TracePoint};
use drivebench_diagnose::{RankedEffect, provisional_ranking};
use drivebench_identify::noise::NoiseFloor;
use drivebench_model::plant::{Input, Model, Motor, MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason};

/// Bounds of memory and work, whatever the length of the run.
struct Bounds {
    /// Beyond them every other sample is left out.
    most_samples: usize,
    /// Changes of the voltage: a run with more is not ranked any further.
    most_events: usize,
    /// Below them nothing is ranked.
    fewest_samples: usize,
}

const BOUNDS: Bounds = Bounds { most_samples: 4000, most_events: 8000, fewest_samples: 200 };

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProvisionalRanking {
    /// The one that explains most of the residual first.
    pub effects: Vec<RankedEffect>,
    /// Of the run so far.
    pub seconds: f64,
}

impl ProvisionalRanking {
    /// One line for the screen.
    pub fn line(&self) -> String {
        let seconds = self.seconds;
        let Some(first) = self.effects.first() else {
            return format!("provisional, {seconds:.0} s: the residual fits no effect");
        };
        let named = |own: &RankedEffect| format!("{} {:.0} %", own.effect, 100.0 * own.share);
        let others = self.effects[1..].iter().filter(|own| own.equation == first.equation);
        let others: Vec<String> = others.take(2).map(named).collect();
        let or = if others.is_empty() { "" } else { ", or " };
        format!(
            "provisional, {seconds:.0} s: {} residual fits {}{or}{}",
            first.equation,
            named(first),
            others.join(", ")
        )
    }
}

/// The run so far, from its snapshots.
#[derive(Clone, Debug, Default)]
pub struct RankingWatch {
    name: String,
    /// Every so many samples are kept.
    stride: usize,
    count: usize,
    last_s: f64,
    times: Vec<f64>,
    current_a: Vec<f64>,
    speed_rad_s: Vec<f64>,
    events: Vec<(f64, f64)>,
    motor: Motor,
}

impl RankingWatch {
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
        if inertia.is_some_and(|inertia| inertia.code == Some(Reason::InertiaChanged)) {
            // Earlier samples are of another inertia: the present values do not fit them.
            self.clear();
        }
        for key in MotorKey::ALL {
            let found = ParameterEstimate::find(&snapshot.estimates, key.key());
            if let Some(value) = found.and_then(|estimate| estimate.value) {
                self.motor.set(key, value);
            }
        }
    }

    fn clear(&mut self) {
        self.events.clear();
        self.columns().into_iter().for_each(Vec::clear);
    }

    fn columns(&mut self) -> [&mut Vec<f64>; 3] {
        [&mut self.times, &mut self.current_a, &mut self.speed_rad_s]
    }

    fn push(&mut self, point: &TracePoint) {
        if point.command_v.is_finite() && self.events.len() < BOUNDS.most_events {
            let last = self.events.last().copied();
            let at_s = point.applied_s;
            let is_new = last.is_none_or(|(_, volts)| (volts - point.command_v).abs() > 0.0);
            if is_new && last.is_none_or(|(last_s, _)| at_s > last_s) {
                self.events.push((at_s, point.command_v));
            }
        }
        let is_kept = self.count.is_multiple_of(self.stride.max(1));
        self.count += 1;
        if !is_kept || self.events.is_empty() {
            return;
        }
        self.times.push(point.time_s);
        self.current_a.push(point.current_a);
        self.speed_rad_s.push(point.speed_rad_s);
        if self.times.len() >= BOUNDS.most_samples {
            for values in self.columns() {
                let mut index = 0;
                values.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
            }
            self.stride *= 2;
        }
    }

    /// `None` where there is too little of the run, or no model yet.
    pub fn rank(&self) -> Option<ProvisionalRanking> {
        if self.times.len() < BOUNDS.fewest_samples || self.events.len() >= BOUNDS.most_events {
            return None;
        }
        let mut motor = self.motor.clone();
        if motor.get(MotorKey::LoadTorque).is_none() {
            // Not estimated yet: the screening removes the constant torque from the balance.
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
        let effects = provisional_ranking(&model, &run, &noise).ok()?;
        Some(ProvisionalRanking { effects, seconds })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

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
    fn a_fan_is_ranked_first_before_its_run_is_over() {
        let run = with_a_fan(0);
        let mut watch = RankingWatch::default();
        assert_eq!(watch.rank(), None);
        for end in (0..900).step_by(60) {
            watch.take(&snapshot(&run, end, 200));
        }
        let found = watch.rank().unwrap();
        assert_eq!(found.effects[0].effect, "quadratic_load", "{found:?}");
        assert!(found.line().starts_with("provisional, 4 s: torque residual fits"));
        // Another run begins anew.
        let mut other = snapshot(&run, 50, 50);
        other.name = "another".to_owned();
        watch.take(&other);
        assert_eq!(watch.rank(), None);
    }

    #[test]
    fn samples_before_a_change_of_inertia_are_not_ranked() {
        let run = with_a_fan(0);
        let mut watch = RankingWatch::default();
        watch.take(&snapshot(&run, 600, 600));
        assert!(watch.rank().is_some());
        let mut changed = snapshot(&run, 700, 200);
        let mut all = Arc::make_mut(&mut changed.estimates).iter_mut();
        let inertia = all.find(|own| own.key == MotorKey::Inertia.key()).unwrap();
        inertia.unsettle(Reason::InertiaChanged, "begun again");
        watch.take(&changed);
        assert_eq!(watch.rank(), None);
        watch.take(&snapshot(&run, 1000, 300));
        assert!(watch.rank().is_some_and(|found| found.seconds < 2.0));
    }

    #[test]
    fn memory_and_work_are_bounded_however_long_the_run() {
        let mut watch = RankingWatch::default();
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
            assert!(
                watch.times.len() < BOUNDS.most_samples && watch.events.len() <= BOUNDS.most_events
            );
        }
        assert!(watch.times.len() > BOUNDS.most_samples / 4);
        let found = watch.rank().unwrap();
        assert!(found.seconds > 300.0, "{}", found.seconds);
    }
}

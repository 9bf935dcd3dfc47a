//! History of commands and samples as rows between two samples, with the voltage that may have been in force meanwhile.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use crate::push_within;
use drivebench_identify::belief::{Range, Row, Scale, Settings};
use drivebench_model::numerics::count::whole;
use drivebench_model::sample::{Channel, Command, Demand, Sample, Sensors};

/// Commands and samples kept: more than any latency in cycles.
const KEPT: usize = 64;

/// One sample with the command in force.
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation {
    pub(super) time_s: f64,
    key: Option<u64>,
    /// The drive stamps samples and commands itself.
    pub(super) exact: bool,
    pub(super) current_a: Option<f64>,
    pub(super) speed_rad_s: Option<f64>,
    pub(super) angle_rad: Option<f64>,
    pub(super) voltage_v: Option<f64>,
    pub(super) limited: bool,
    sensors: Sensors,
    pub(super) demand: Option<Demand>,
}

/// The last commands and samples.
#[derive(Clone, Debug, Default)]
pub(super) struct History {
    pub(super) commands: VecDeque<(u64, Demand)>,
    samples: VecDeque<Observation>,
    rows: VecDeque<Row>,
}

impl History {
    pub(super) fn clear(&mut self) {
        self.samples.clear();
        self.rows.clear();
    }

    pub(super) fn sent(&mut self, command: &Command) {
        push_within(&mut self.commands, (command.seq, command.demand), KEPT);
    }

    pub(super) fn last(&self) -> Option<&Observation> {
        self.samples.back()
    }

    pub(super) const fn rows(&self) -> &VecDeque<Row> {
        &self.rows
    }

    /// Mean sampling period, s; `None` before there are two samples.
    pub(super) fn period_s(&self) -> Option<f64> {
        let rows = self.rows.len();
        let all_s: f64 = self.rows.iter().map(|row| row.seconds).sum();
        (rows > 0).then(|| all_s / rows as f64)
    }

    /// Rows by which the speed may show a change later than the current does: the filter of its sensor, three rows where nobody has
    /// stated one, as of an observer that works at the rate of the samples.
    pub(super) fn speed_lag_rows(&self) -> usize {
        let sensors = self.samples.back().map_or(Sensors::default(), |last| last.sensors);
        if sensors.has_unknown_filter {
            return 3;
        }
        let period_s = self.period_s().unwrap_or(f64::INFINITY);
        whole((2.0 * sensors.speed.filter_s / period_s).ceil())
    }

    /// Demands that may have been in force from `lag` commands before the first sample's until the last one's.
    fn in_force(
        &self,
        first: &Observation,
        last: &Observation,
        lag: u64,
    ) -> impl Iterator<Item = Demand> {
        let keys = first.key.zip(last.key);
        let (from, to) = keys.map_or((u64::MAX, 0), |(from, to)| (from.saturating_sub(lag), to));
        self.sent_in(from..=to)
    }

    fn sent_in(&self, seqs: RangeInclusive<u64>) -> impl Iterator<Item = Demand> {
        self.commands.iter().filter_map(move |(seq, demand)| seqs.contains(seq).then_some(*demand))
    }

    /// The demands that may be in force in the newest sample.
    pub(super) fn demands(&self) -> Option<impl Iterator<Item = Demand>> {
        let last = self.samples.back()?;
        last.key?;
        let late = Settings::LATENCY_CYCLES as u64;
        Some(self.in_force(last, last, if last.exact { 2 } else { late }))
    }

    /// The same as one range in their quantity; `None` where they are mixed. `cycles`: latency of the drive.
    pub(super) fn set_points(&self, cycles: usize) -> Option<(Demand, Range)> {
        let last = self.samples.back()?;
        let lag = if last.exact { 2 } else { cycles as u64 };
        let wanted = last.demand?;
        let values = self.in_force(last, last, lag).map(|demand| match (demand, wanted) {
            (Demand::Voltage(value), Demand::Voltage(_))
            | (Demand::Current(value), Demand::Current(_))
            | (Demand::Speed(value), Demand::Speed(_)) => Some(value),
            _ => None,
        });
        Some((wanted, Range::of_known(values)?))
    }

    fn volts(&self, last: &Observation, now: &Observation, scale: &Scale) -> Option<Range> {
        let measured = last.voltage_v.zip(now.voltage_v);
        // Such a loop follows a step within a part of a cycle.
        let steady = |a: f64, b: f64| (b - a).abs() <= Settings::CLEAR * scale.volts;
        let demand = last.demand?;
        if let Demand::Speed(_) = demand {
            // The drive's own loop sets the voltage, and the reported one may be that of another machine.
            return None;
        }
        if last.limited || now.limited {
            let (a, b) = measured?;
            return steady(a, b).then(|| Range::new(a.min(b), a.max(b)));
        }
        if let Demand::Current(_) = demand {
            let (a, b) = measured?;
            let amps = self.in_force(last, now, 1).map(|demand| match demand {
                Demand::Current(amps) => amps,
                _ => 0.0,
            });
            let set_point = Range::of(amps)?;
            let (from_a, to_a) = last.current_a.zip(now.current_a)?;
            let is_steady = steady(a, b)
                && (to_a - from_a).abs() <= Settings::FOLLOWS * scale.amps
                // A loop gives several volts for each ampere.
                && set_point.width() <= 0.03 * scale.amps;
            return is_steady.then(|| Range::new(a.min(b), a.max(b)));
        }
        let keys = last.key.zip(now.key)?;
        // Without stamps an answer may be a cycle late; with them the newest command is in force only after its sample.
        let from = keys.0.saturating_sub(if now.exact { 1 } else { 2 });
        let sent = self.sent_in(from..=keys.1.saturating_sub(u64::from(now.exact)));
        let range = Range::of_known(sent.map(Demand::voltage_v))?;
        Some(match measured {
            Some((a, _)) if now.exact => range.with(a),
            Some((a, b)) => range.with(a).with(b),
            None => range,
        })
    }

    /// Takes a sample; false after a gap.
    pub(super) fn push(&mut self, sample: &Sample, scale: &Scale) -> bool {
        let key = sample.applied.map(|applied| applied.seq).or(sample.seq);
        let sent = |key| self.commands.iter().rev().find(|(seq, _)| *seq == key);
        let demand = key.and_then(sent).map(|(_, demand)| *demand);
        let now = Observation {
            time_s: sample.time_s,
            key: key.filter(|_| demand.is_some()),
            exact: sample.applied.is_some(),
            current_a: sample.get(Channel::Current),
            speed_rad_s: sample.get(Channel::Speed),
            angle_rad: sample.get(Channel::Angle),
            voltage_v: sample.get(Channel::Voltage),
            limited: sample.limited,
            sensors: sample.sensors,
            demand,
        };
        let last = self.samples.back();
        let row = last.and_then(|last| self.row(last, &now, scale));
        if row.is_none() {
            self.clear();
        }
        push_within(&mut self.samples, now, KEPT);
        let Some(row) = row else {
            return false;
        };
        push_within(&mut self.rows, row, KEPT);
        true
    }

    fn row(&self, last: &Observation, now: &Observation, scale: &Scale) -> Option<Row> {
        let seconds = now.time_s - last.time_s;
        let (from_a, to_a) = last.current_a.zip(now.current_a)?;
        let (from_rad_s, to_rad_s) = last.speed_rad_s.zip(now.speed_rad_s)?;
        let angles = last.angle_rad.zip(now.angle_rad);
        // Over a longer time a mean of two samples is no measurement.
        (seconds > 0.0 && seconds < 0.5).then(|| Row {
            seconds,
            // A mean since the last read is that of the row.
            current_a: if now.sensors.averages_current { to_a } else { 0.5 * (from_a + to_a) },
            speed_rad_s: 0.5 * (from_rad_s + to_rad_s),
            current_change_a: to_a - from_a,
            speed_change_rad_s: to_rad_s - from_rad_s,
            // A filter that is not stated may be as long as a row.
            speed_lead_rad_s: (to_rad_s - from_rad_s)
                * if now.sensors.has_unknown_filter {
                    1.0
                } else {
                    now.sensors.speed.filter_s / seconds
                },
            turned_rad: angles.map(|(from, to)| to - from),
            volts: self.volts(last, now, scale),
            exact: now.exact,
            limited: last.limited || now.limited,
        })
    }
}

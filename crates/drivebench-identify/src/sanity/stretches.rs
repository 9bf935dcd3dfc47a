//! A signal that is wrongly constant: frozen, saturated, or a command instead of a measurement.
//!
//! A value repeats for many reasons that are none of these: a coarse quantum, a settled machine, a shaft at rest. What
//! counts is the value that follows from the other signals, and how the signal comes to rest.

use std::ops::Range;

use super::sensor::{Expected, Sensor, is_same, runs_of, stops_suddenly, stretches};
use super::table::{Activity, Table};
use super::{Fault, Finding, Kind, SignalFault};
use crate::belief::Settings;
use drivebench_model::numerics::statistics::{finite, largest};

/// Rows of one and the same value from which a live signal may count as frozen.
pub(super) const FROZEN_ROWS: usize = 20;
/// Rows at the very same extreme value that make a plateau.
const PLATEAU_ROWS: usize = 3;

/// A measured signal beside the others.
pub(super) struct Watched<'a> {
    pub(super) table: &'a Table,
    pub(super) key: &'static str,
    pub(super) values: &'a [f64],
    /// The other of current and speed.
    pub(super) other: &'a [f64],
    pub(super) activity: Activity,
    pub(super) sensor: Sensor,
}

impl<'a> Watched<'a> {
    /// Current and speed.
    pub(super) fn both(table: &'a Table) -> [Self; 2] {
        let [_, current, speed] = table.columns();
        let of = |key, values, other, sensor| Self {
            table,
            key,
            values,
            other,
            activity: Activity::of(values),
            sensor,
        };
        [
            of("current_a", current, speed, table.current),
            of("speed_rad_s", speed, current, table.speed),
        ]
    }

    /// The longest stretch of one non-zero value in which it cannot have stood still.
    pub(super) fn frozen(&self) -> Option<Finding> {
        let values = self.values;
        let same = |row: usize| values[row].is_finite() && is_same(values[row - 1], values[row]);
        let mut still = stretches(values.len(), FROZEN_ROWS, same);
        // At rest an encoder gives exactly zero.
        still.retain(|rows| values[rows.start].abs() > 0.0);
        still.sort_by_key(|rows| std::cmp::Reverse(rows.len()));
        let longest = still.into_iter().find(|rows| self.is_frozen(rows))?;
        let fault = SignalFault::Froze {
            key: self.key,
            value: values[longest.start],
            rows: longest.len(),
            from_s: self.table.time_s[longest.start],
            to_s: self.table.time_s[longest.end - 1],
        };
        Some(Finding::refusal(Kind::Frozen, Fault::Signal(fault)))
    }

    fn is_frozen(&self, rows: &Range<usize>) -> bool {
        let moved = [self.other, &self.table.voltage_v].iter().any(|other| {
            let part = Activity::of(&other[rows.clone()]);
            part.moves && part.range() > Settings::CHANGES * Activity::of(other).range()
        });
        if !moved || self.is_controlled(rows) {
            return false;
        }
        let value = self.values[rows.start];
        if stops_suddenly(self.values, &self.sensor, rows) {
            return true;
        }
        let expected = Expected::of(self, |row| !rows.contains(&row));
        expected.is_some_and(|expected| {
            let off = |row: &usize| expected.beyond(*row, value, &self.sensor).abs() > 0.0;
            // The others need not expect another value from the first row on.
            rows.clone().filter(off).count() as f64 > 0.3 * rows.len() as f64
        })
    }

    /// Whether it is a current that the drive controls, and its command does not step in these rows.
    fn is_controlled(&self, rows: &Range<usize>) -> bool {
        let steps_s = &self.table.current_steps_s;
        let [from_s, to_s] = [rows.start, rows.end - 1].map(|row| self.table.time_s[row]);
        let steps = steps_s.iter().any(|step_s| (from_s..to_s).contains(step_s));
        self.key == "current_a" && !steps_s.is_empty() && !steps
    }

    /// A measured signal that stands still between jumps while the others move is a command, or in a command's column: no
    /// shaft and no winding does that. A settled machine stands still with all its signals.
    pub(super) fn held(&self) -> Option<Finding> {
        let present = finite(self.values);
        let (activity, range) = (&self.activity, self.activity.range());
        let pairs = || present.windows(2).map(|pair| (pair[0], pair[1]));
        // At rest every signal is constant.
        let lively = pairs().filter(|(_, b)| b.abs() > Settings::CHANGES * activity.largest());
        let equal = lively.clone().filter(|(a, b)| is_same(*a, *b)).count();
        let jumps: Vec<f64> =
            pairs().map(|(a, b)| (b - a).abs()).filter(|jump| *jump > 0.0).collect();
        let large = jumps.iter().filter(|jump| **jump > Settings::CHANGES * range).count();
        let stands = equal as f64 > 0.8 * lively.count() as f64;
        let is_held = stands && large >= 3 && 2 * large > jumps.len();
        (is_held && (self.is_the_voltage() || self.others_move())).then(|| {
            let (key, jumps, largest) = (self.key, large, largest(&jumps));
            let fault = SignalFault::HeldLikeACommand { key, jumps, largest };
            Finding::refusal(Kind::Swapped, Fault::Signal(fault))
        })
    }

    /// Whether it is a multiple of the voltage, row by row.
    fn is_the_voltage(&self) -> bool {
        let rows = || self.values.iter().zip(&self.table.voltage_v);
        let rows = || rows().filter(|(x, u)| x.is_finite() && u.is_finite());
        let (both, power) = rows().fold((0.0, 0.0), |sum, (x, u)| (sum.0 + x * u, sum.1 + u * u));
        let off = |(x, u): (&f64, &f64)| (x - u * both / power).abs();
        power > 0.0 && rows().map(off).fold(0.0, f64::max) < 0.005 * self.activity.range()
    }

    /// Whether another signal moves in most of the stretches in which this one stands, but for the rows beside its jumps.
    fn others_move(&self) -> bool {
        let same = |row: usize| is_same(self.values[row - 1], self.values[row]);
        let still = stretches(self.values.len(), 3 * PLATEAU_ROWS, same);
        let others = [self.other, &self.table.voltage_v];
        let ranges = others.map(|other| Activity::of(other).range());
        let moves = |rows: &&Range<usize>| {
            let settled = rows.start + PLATEAU_ROWS..rows.end - PLATEAU_ROWS;
            others.iter().zip(ranges).any(|(other, range)| {
                let part = Activity::of(&other[settled.clone()]);
                part.is_there() && part.range() > Settings::CHANGES * range
            })
        };
        2 * still.iter().filter(moves).count() > still.len()
    }

    /// Plateaus at the largest or smallest value where the other signals let expect a further one.
    pub(super) fn clipped(&self) -> Option<Finding> {
        let is_limit = |value: f64| {
            (value >= self.activity.most && self.activity.most > 0.0)
                || (value <= self.activity.least && self.activity.least < 0.0)
        };
        let expected = Expected::of(self, |row| !is_limit(self.values[row]));
        let cut: Vec<(f64, Vec<Range<usize>>)> = [self.activity.most, self.activity.least]
            .into_iter()
            .filter(|level| is_limit(*level))
            .map(|level| (level, self.plateaus(level)))
            .filter(|(level, plateaus)| self.is_cut(*level, plateaus, expected.as_ref()))
            .collect();
        let plateaus = cut.iter().flat_map(|(_, plateaus)| plateaus);
        let (plateaus, rows) = plateaus.fold((0, 0), |sum, rows| (sum.0 + 1, sum.1 + rows.len()));
        // One plateau may be a stalled motor under one voltage; the very same value several times is a limit.
        if plateaus < 2 {
            return None;
        }
        let levels = cut.iter().map(|(level, _)| *level).collect();
        let share = rows as f64 / self.activity.count as f64;
        let fault = SignalFault::CutOff { key: self.key, levels, rows, share, plateaus };
        Some(Finding::of_all(Kind::Clipped, share > 0.01, Fault::Signal(fault)))
    }

    fn plateaus(&self, level: f64) -> Vec<Range<usize>> {
        let at = |row: usize| is_same(self.values[row], level);
        runs_of(self.values.len(), PLATEAU_ROWS, at)
    }

    /// Whether the signal goes beyond a level on most of its plateaus; where nothing else is measured, whether it enters
    /// and leaves them at full slope.
    fn is_cut(&self, level: f64, plateaus: &[Range<usize>], expected: Option<&Expected>) -> bool {
        let Some(expected) = expected else {
            let steep = plateaus.iter().filter(|rows| self.is_steep(rows));
            return finite(self.other).is_empty() && 2 * steep.count() > plateaus.len();
        };
        let goes_on = |rows: &&Range<usize>| {
            let beyond =
                |row: &usize| level.signum() * expected.beyond(*row, level, &self.sensor) > 0.0;
            2 * (**rows).clone().filter(beyond).count() > rows.len()
        };
        2 * plateaus.iter().filter(goes_on).count() > plateaus.len()
    }

    /// A settling signal creeps into a plateau, and a coarse one creeps by one quantum.
    fn is_steep(&self, rows: &Range<usize>) -> bool {
        let slope = |from: Option<usize>, to: usize| {
            let from = from.and_then(|from| self.values.get(from));
            from.map_or(0.0, |from| (self.values[to] - from).abs())
        };
        let entry = slope(rows.start.checked_sub(1), rows.start);
        let leave = slope(Some(rows.end), rows.end - 1);
        entry.min(leave) > (0.03 * self.activity.range()).max(1.5 * self.sensor.quantum)
    }
}

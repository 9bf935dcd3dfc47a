//! Resolution of the sensor of a signal, its interval of renewal, and the value that the other signals let expect. Every check
//! of a record judges a value that repeats by these.

use std::ops::Range;

use super::stretches::Watched;
use super::table::Table;
use crate::belief::Settings;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares::fit_normal;
use drivebench_model::numerics::statistics::{
    extent, finite, median, median_step, robust_deviation,
};

/// The sensor of a signal, as far as the record shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sensor {
    /// Quantum: the smallest change from row to row; zero for a constant signal.
    pub(super) quantum: f64,
    /// Sampling interval of the sensor in rows: one where each row is a new sample.
    pub(super) held_rows: usize,
}

impl Sensor {
    pub(super) fn of(values: &[f64]) -> Self {
        let present = finite(values);
        let steps = present.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
        steps.sort_by(f64::total_cmp);
        // A reading that was rounded once more, or a torn row, may make a smaller step.
        let place = whole(steps.len() as f64 * 0.02);
        Self { quantum: steps.get(place).copied().unwrap_or(0.0), held_rows: held_rows(&present) }
    }
}

/// The interval of renewal in rows. A coarse quantum repeats values over stretches of any length; a signal that is sampled
/// more slowly than it is logged changes at multiples of one interval only.
fn held_rows(present: &[f64]) -> usize {
    let changes: Vec<usize> =
        (1..present.len()).filter(|row| !is_same(present[row - 1], present[*row])).collect();
    let mut gaps: Vec<usize> = changes.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if gaps.len() < 20 {
        return 1;
    }
    gaps.sort_unstable();
    // Where a value comes again by chance the gap is a multiple.
    let rows = gaps[gaps.len() / 10];
    let keeps = |gap: &&usize| {
        // Two clocks drift against each other: a change of a long interval may come a row early or late.
        let off = **gap % rows;
        off == 0 || rows >= 4 && (off == 1 || off + 1 == rows) && **gap + 1 >= rows
    };
    let kept = gaps.iter().filter(keeps).count();
    if rows > 1 && kept as f64 >= 0.95 * gaps.len() as f64 { rows } else { 1 }
}

/// Equal to the bit.
pub(super) const fn is_same(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits()
}

/// Runs of at least `fewest` rows for all of which `is` holds.
pub(super) fn runs_of(rows: usize, fewest: usize, is: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut found = stretches(rows, fewest, |row| is(row) && is(row - 1));
    found.retain(|rows| is(rows.start));
    found
}

/// Stretches of at least `fewest` rows of which each but the first is as the one before, by `stays`.
pub(super) fn stretches(
    rows: usize,
    fewest: usize,
    stays: impl Fn(usize) -> bool,
) -> Vec<Range<usize>> {
    let (mut found, mut begin) = (Vec::new(), 0);
    for row in 1..=rows {
        if row == rows || !stays(row) {
            if row - begin >= fewest {
                found.push(begin..row);
            }
            begin = row;
        }
    }
    found
}

/// Whether a signal that moves on both sides of a stretch stands in it to the bit. Neither a settling machine nor a coarse
/// quantum does that: the one creeps into the stretch by steps of one quantum, the other repeats values beside it too.
pub(super) fn stops_suddenly(values: &[f64], sensor: &Sensor, still: &Range<usize>) -> bool {
    let usual = |rows: Range<usize>| {
        let steps = values[rows].windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let steps: Vec<f64> = steps.filter(|step| step.is_finite()).collect();
        (steps.len() >= 5).then(|| median(&steps))
    };
    let before = usual(still.start.saturating_sub(10)..still.start + 1);
    let after = usual(still.end..(still.end + 11).min(values.len()));
    let lively = |step: f64| sensor.quantum > 0.0 && step > 3.0 * sensor.quantum;
    // A machine settles in ever smaller steps; a source that freezes stops in the middle of them.
    let last =
        (values[still.start.saturating_sub(1)] - values[still.start.saturating_sub(2)]).abs();
    if !lively(last) {
        return false;
    }
    match (before, after) {
        (Some(before), Some(after)) => lively(before) && lively(after),
        // A record may end with it.
        (Some(before), None) => lively(before) && still.end == values.len(),
        (None, _) => false,
    }
}

/// Time constants of the lag of the voltage, in rows, that are tried where no current is measured.
const LAGS: [f64; 7] = [0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0];

/// The value that follows from the other signals, by a line through the rest of the record: of the voltage and the third
/// signal, or of the voltage behind a lag where there is none.
pub(super) struct Expected {
    values: Vec<f64>,
    /// What nine in ten rows of the rest are off by at most: not those behind a step, where the other signals are ahead.
    error: f64,
}

impl Expected {
    /// `counts`: rows that the relation is taken from.
    pub(super) fn of(watched: &Watched<'_>, counts: impl Fn(usize) -> bool) -> Option<Self> {
        let Watched { table, values, other, .. } = watched;
        let rows: Vec<usize> = (0..values.len()).filter(|row| counts(*row)).collect();
        let by_line =
            |second: &[f64], both| Self::by_line(values, &table.voltage_v, second, &rows, both);
        if finite(other).len() * 2 > other.len() {
            return by_line(other, true);
        }
        let lags = LAGS.iter().filter_map(|rows| by_line(&table.lagged_voltage(*rows), false));
        lags.min_by(|a, b| a.error.total_cmp(&b.error))
    }

    /// `both`: the voltage counts beside `second`.
    fn by_line(
        own: &[f64],
        voltage: &[f64],
        second: &[f64],
        rows: &[usize],
        both: bool,
    ) -> Option<Self> {
        let mut kept = rows.to_vec();
        let mut values = Vec::new();
        // Rows with a residual of more than four standard deviations are left out of the next fit.
        for _ in 0..3 {
            let line = if both {
                let points = kept.iter().map(|row| ([voltage[*row], second[*row], 1.0], own[*row]));
                fit_normal(&points.collect::<Vec<_>>(), 1e-5)?.x
            } else {
                let points = kept.iter().map(|row| ([second[*row], 1.0], own[*row]));
                let fit = fit_normal(&points.collect::<Vec<_>>(), 1e-5)?;
                [0.0, fit.x[0], fit.x[1]]
            };
            values = (voltage.iter().zip(second))
                .map(|(u, x)| line[0] * u + line[1] * x + line[2])
                .collect();
            let left = kept.iter().map(|row| own[*row] - values[*row]);
            let deviation = robust_deviation(&left.collect::<Vec<f64>>());
            kept.retain(|row| (own[*row] - values[*row]).abs() <= 4.0 * deviation);
        }
        let left = rows.iter().map(|row| (own[*row] - values[*row]).abs());
        let mut left: Vec<f64> = left.filter(|off| off.is_finite()).collect();
        if left.len() < 60 {
            return None;
        }
        left.sort_by(f64::total_cmp);
        let error = left[whole(0.9 * (left.len() - 1) as f64)];
        let (least, most) = extent(finite(own));
        (error < Settings::FAR * (most - least)).then_some(Self { values, error })
    }

    /// By how much a row is expected away from `value`, where that is beyond three errors, five deviations of a normal one, and
    /// the quantum; else zero.
    pub(super) fn beyond(&self, row: usize, value: f64, sensor: &Sensor) -> f64 {
        let off = self.values[row] - value;
        if off.abs() > 3.0 * self.error + sensor.quantum { off } else { 0.0 }
    }
}

impl Table {
    /// The voltage behind a first-order lag of this many rows.
    fn lagged_voltage(&self, rows: f64) -> Vec<f64> {
        let lag_s = rows * median_step(&self.time_s);
        let (mut level, mut last_s) = (self.voltage_v.first().copied().unwrap_or(0.0), f64::NAN);
        (self.time_s.iter().zip(&self.voltage_v))
            .map(|(time_s, volts)| {
                let share = if lag_s > 0.0 && last_s.is_finite() {
                    1.0 - (-(time_s - last_s) / lag_s).exp()
                } else {
                    1.0
                };
                level += share * (volts - level);
                last_s = *time_s;
                level
            })
            .collect()
    }
}

//! Missing data: interpolation of the input over lost rows of a record, with its variance from the nearest neighbours (in the
//! change of the input) among the complete intervals of the same record.
//!
//! ```text
//! rows     u0    u1    (lost) (lost) u4        zero-order hold: u1 holds for one period, u4 from its stamp on
//! known    |-----|-----|             |-----
//! lost                 |------|------|         the line from u1 to u4; its variance is that of the same estimate in complete
//!                                              intervals of the record; in short holes the current reduces it
//! ```
//!
//! No row counts as lost in a record that has rows only at changes of its command, nor in an irregular one, nor where commands
//! have rows of their own: there the value before holds until the next row.

use std::collections::HashMap;

use nalgebra::{SMatrix, SVector};

use crate::numerics::count::whole;
use crate::numerics::statistics::{largest, mean, median};

/// An interval without a row of the input, or, without a lost row, one in which it changed at an unknown instant or a command was not
/// confirmed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnknownInput {
    pub from_s: f64,
    pub to_s: f64,
    pub lost_rows: usize,
    /// Estimate of the mean of the input over the interval.
    pub mean: f64,
    /// Deviation of each lost row of a short hole from that mean.
    pub beside: [f64; SHORT_HOLE],
    /// Variance of the mean; zero where the estimate is exact in all such intervals of the record, as between equal values of an
    /// input that changes slowly, or on a ramp.
    pub variance: f64,
    /// Current and speed measured at `to_s` (NaN where missing), where the variance is so large that a simulation has to restart
    /// from them.
    pub restart: Option<[f64; 2]>,
}

/// Rows of a record that have the input.
pub(super) struct Rows<'a> {
    pub(super) input: &'a [(f64, f64)],
    /// Current and speed in the same rows, NaN where missing.
    pub(super) measured: &'a [[f64; 2]],
    /// Median time between the samples, s.
    pub(super) sample_period_s: f64,
}

/// Lost rows up to which the currents before and after determine the voltage between, and up to which no restart is needed.
const SHORT_HOLE: usize = 3;

/// Largest deviation of the time between rows from a multiple of the period, as a share of the period.
const GRID_TOLERANCE: f64 = 0.1;
/// Nearest neighbours, by the change of the input, of which a variance is the mean.
const NEIGHBOURS: usize = 50;
/// Fewest rows for an estimate of the period and for a prediction of the current.
const FEWEST_ROWS: usize = 100;

impl UnknownInput {
    /// The time between two concatenated runs: zero input, and a restart of the simulation after it.
    pub(super) const fn between_runs(from_s: f64, to_s: f64, begins_with: [f64; 2]) -> Self {
        Self::of_unconfirmed([from_s, to_s], 0.0, 0.0, begins_with)
    }

    /// The interval of a change at an unknown instant.
    pub(super) const fn of_edge(from_s: f64, to_s: f64, mean: f64, variance: f64) -> Self {
        let beside = [0.0; SHORT_HOLE];
        Self { from_s, to_s, lost_rows: 0, mean, beside, variance, restart: None }
    }

    /// The interval of a command that was not confirmed; `measured` at its end.
    pub(super) const fn of_unconfirmed(
        [from_s, to_s]: [f64; 2],
        mean: f64,
        variance: f64,
        measured: [f64; 2],
    ) -> Self {
        Self { restart: Some(measured), ..Self::of_edge(from_s, to_s, mean, variance) }
    }

    /// Whether no row was lost: the input changed at an unknown instant.
    pub const fn is_of_edge(&self) -> bool {
        self.lost_rows == 0 && self.variance > 0.0 && self.restart.is_none()
    }

    pub const fn is_unconfirmed(&self) -> bool {
        self.lost_rows == 0 && self.variance > 0.0 && self.restart.is_some()
    }

    /// The estimate as a zero-order hold: `(time, value)`.
    pub(super) fn steps(&self) -> impl Iterator<Item = (f64, f64)> {
        let is_even = self.beside.iter().all(|beside| beside.abs() <= 0.0);
        let rows = if is_even { 1 } else { self.lost_rows };
        let row_s = (self.to_s - self.from_s) / rows as f64;
        let (from_s, mean) = (self.from_s, self.mean);
        let beside = self.beside.into_iter().take(rows).enumerate();
        beside.map(move |(row, beside)| (from_s + row as f64 * row_s, mean + beside))
    }
}

pub(super) fn find(record: &Rows<'_>) -> Vec<UnknownInput> {
    let Some((period_s, lost)) = lost_rows(record) else { return Vec::new() };
    let input = record.input;
    let largest = largest(input.iter().map(|row| row.1));
    let intervals = CompleteIntervals::of(record, &lost, period_s);
    let mut by_length: HashMap<usize, [IntervalErrors; 4]> = HashMap::new();
    let holes = (0..).zip(&lost).filter(|(_, rows)| **rows > 0);
    let estimate = |(row, &rows): (usize, &usize)| {
        let ((begin_s, before), (to_s, after)) = (input[row], input[row + 1]);
        let errors = by_length.entry(rows).or_insert_with(|| intervals.errors(rows));
        let expected = |basis: Basis| errors[basis as usize].expected((after - before).abs(), rows);
        let mut course = intervals.course(row, row + 1, rows);
        let mut error = expected(course.basis);
        // The line is better than a course without enough complete intervals, and than a corner whose error is not smaller.
        let line = if errors[course.basis as usize].0.len() < NEIGHBOURS {
            Some(Basis::Ends)
        } else {
            let is_worse = || error.total() >= expected(Basis::LineForCorner).total();
            (course.corner.is_some() && is_worse()).then_some(Basis::LineForCorner)
        };
        if let Some(basis) = line {
            course = Course::line(course.from, course.to, basis);
            error = expected(basis);
        }
        let from_s = begin_s + period_s;
        let (mut mean, beside) = course.rows(from_s, to_s, rows);
        let mut variance = error.of_mean;
        // Mean of both estimates, weighted by their inverse variances.
        if variance > 0.0
            && let Some(current_variance) = error.by_current
            && let Some(by_current) = intervals.by_current([row, row + 1], &beside[..rows])
        {
            let share = variance / (variance + current_variance);
            mean += share * (by_current - mean);
            variance *= 1.0 - share;
        }
        variance += error.of_rows;
        if rows > SHORT_HOLE {
            // The state at the end of a long hole depends not on the mean of the input but on its last part, which may have had the
            // value of either side.
            variance += 0.25 * (after - before).powi(2);
        }
        // A deviation of 0.2 % of the largest input needs no restart.
        let needs_restart = rows > SHORT_HOLE && variance.sqrt() > 0.002 * largest;
        UnknownInput {
            from_s,
            to_s,
            lost_rows: rows,
            mean,
            beside,
            variance,
            restart: needs_restart.then_some(record.measured[row + 1]),
        }
    };
    holes.map(estimate).collect()
}

/// The period, and the number of rows lost after each row; `None` where the record is complete or irregular.
fn lost_rows(record: &Rows<'_>) -> Option<(f64, Vec<usize>)> {
    let input = record.input;
    let steps: Vec<f64> = input.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    if steps.len() < FEWEST_ROWS {
        return None;
    }
    let (period_s, multiples) = schedule(&steps);
    let share = |count: usize| count as f64 / steps.len() as f64;
    let is_on_the_grid =
        |(step, multiple): &(&f64, &f64)| (*step / period_s - *multiple).abs() <= GRID_TOLERANCE;
    let on_the_grid = steps.iter().zip(&multiples).filter(is_on_the_grid).count();
    let is_single = |multiple: &&f64| **multiple <= 1.0;
    let single = multiples.iter().filter(is_single).count();
    let own_rows = (record.sample_period_s / period_s - 1.0).abs() > GRID_TOLERANCE;
    // The period of a software loop is a multiple of a millisecond from row to row; a clock has a schedule, with rounded stamps or
    // with polls up to a quarter of a period late.
    let rounded_s = coarse_resolution_s(&steps, period_s);
    let late_s = rounded_s.map_or(0.25 * period_s, |rounded_s| 0.55 * rounded_s);
    let is_off =
        rounded_s.is_some_and(|rounded_s| holes_are_off((&steps, &multiples), period_s, rounded_s));
    let is_regular = share(on_the_grid) >= 0.95 && rounded_s.is_none()
        || share(on_schedule(input, &multiples, late_s)) >= 0.95 && !is_off;
    // A loop that pauses after one row in twenty, each time equally long, has lost no row.
    let pauses = share(most_frequent_pause(&multiples)) >= 0.05;
    if single == steps.len() || own_rows || !is_regular || share(single) < 0.5 || pauses {
        return None;
    }
    // A record of changes only has no equal neighbours, and its changes over two periods are as large as those over one.
    let changes = |alone: bool| -> Vec<f64> {
        (input.windows(2).zip(&multiples))
            .filter(|(_, multiple)| (**multiple <= 1.0) == alone)
            .map(|(pair, _)| (pair[1].1 - pair[0].1).abs())
            .collect()
    };
    let (alone, over_holes) = (changes(true), changes(false));
    let repeats = alone.iter().filter(|change| **change <= 0.0).count();
    let writes_repeats = repeats as f64 > 0.005 * alone.len() as f64;
    if !writes_repeats && mean(&over_holes) < 1.5 * mean(&alone) && !mostly_distinct(input) {
        return None;
    }
    Some((period_s, multiples.iter().map(|multiple| whole((multiple - 1.0).max(0.0))).collect()))
}

/// The period, and the length of each step in periods. The median of late polls is too long where rows were lost, by a whole row
/// over a long hole; the mean of steps of up to three periods is not.
fn schedule(steps: &[f64]) -> (f64, Vec<f64>) {
    let rounded = |period_s: f64| steps.iter().map(move |step| (step / period_s).round());
    let mut period_s = median(steps);
    let steps_and_multiples = steps.iter().zip(rounded(period_s));
    let (length_s, rows) = steps_and_multiples
        .filter(|(_, multiple)| (1.0..=3.0).contains(multiple))
        .fold((0.0, 0.0), |sum, (step, multiple)| (sum.0 + step, sum.1 + multiple));
    if rows > 0.0 {
        period_s = length_s / rows;
    }
    (period_s, rounded(period_s).collect())
}

/// The resolution of the stamps, s, where it is a tenth of the period or more; `None` where it is finer, or the period itself.
fn coarse_resolution_s(steps: &[f64], period_s: f64) -> Option<f64> {
    // The greatest common divisor of all times between rows, by Euclid's algorithm with a tolerance for the last digit.
    let divisor = |mut a: f64, mut b: f64| {
        while b > 1e-3 * period_s {
            (a, b) = (b, (a - (a / b).round() * b).abs());
        }
        a
    };
    let resolution_s = steps.iter().copied().fold(0.0, divisor);
    let coarse_s = GRID_TOLERANCE * period_s..(1.0 - GRID_TOLERANCE) * period_s;
    coarse_s.contains(&resolution_s).then_some(resolution_s)
}

/// Whether the mean error of the holes of up to ten periods exceeds five standard deviations of the rounding of stamps, which is
/// `resolution / sqrt(6)` for the difference of two.
fn holes_are_off((steps, multiples): (&[f64], &[f64]), period_s: f64, rounded_s: f64) -> bool {
    let holes =
        steps.iter().zip(multiples).filter(|(_, multiple)| (2.0..=10.0).contains(*multiple));
    let errors: Vec<f64> = holes.map(|(step, multiple)| step - multiple * period_s).collect();
    mean(&errors).abs() > 5.0 * rounded_s / (6.0 * errors.len() as f64).sqrt()
}

/// Number of the pauses of the most frequent length of more than two periods, if they are more than half of all pauses: such
/// pauses are an occasional task of the loop, because rows are lost one by one more often than several at once.
fn most_frequent_pause(multiples: &[f64]) -> usize {
    let pauses = multiples.iter().filter(|multiple| **multiple > 1.0);
    let mut pauses: Vec<usize> = pauses.map(|multiple| whole(*multiple)).collect();
    pauses.sort_unstable();
    let equal = pauses.chunk_by(|a, b| a == b);
    let most_frequent = equal.max_by_key(|equal| equal.len()).unwrap_or_default();
    let is_long = most_frequent.first().is_some_and(|periods| *periods > 2);
    let is_majority = 2 * most_frequent.len() > pauses.len();
    if is_long && is_majority { most_frequent.len() } else { 0 }
}

/// Number of rows within `within_s` of the regression line of their stamps over their numbers; `multiples` are the differences of
/// the numbers.
fn on_schedule(input: &[(f64, f64)], multiples: &[f64], within_s: f64) -> usize {
    let mut number = 0.0;
    let mut rows = vec![(0.0, input[0].0)];
    for (row, multiple) in input[1..].iter().zip(multiples) {
        number += multiple;
        rows.push((number, row.0));
    }
    let count = rows.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| rows.iter().map(of).sum::<f64>() / count;
    let (mean_number, mean_s) = (mean(|row| row.0), mean(|row| row.1));
    let (mut products, mut squares) = (0.0, 0.0);
    for (number, time_s) in &rows {
        products += (number - mean_number) * (time_s - mean_s);
        squares += (number - mean_number).powi(2);
    }
    let period_s = products / squares;
    let is_within =
        |row: &&(f64, f64)| (row.1 - mean_s - period_s * (row.0 - mean_number)).abs() <= within_s;
    rows.iter().filter(is_within).count()
}

/// Whether most values are distinct, so that equal ones were not left out.
fn mostly_distinct(input: &[(f64, f64)]) -> bool {
    let mut values: Vec<f64> = input.iter().map(|row| row.1).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    2 * values.len() > input.len()
}

/// Interpolation of the input between two rows: a line, or in a short hole the corner of the extrapolations from both sides.
struct Course {
    from: (f64, f64),
    to: (f64, f64),
    corner: Option<(f64, f64)>,
    basis: Basis,
}

/// The rows on which an interpolation is based.
#[derive(Clone, Copy)]
enum Basis {
    /// The line, from the two rows alone.
    Ends,
    /// The line, where the extrapolations from the neighbours of both rows have no corner between them.
    Line,
    Corner,
    /// The line, where they have a corner.
    LineForCorner,
}

impl Course {
    const fn line(from: (f64, f64), to: (f64, f64), basis: Basis) -> Self {
        Self { from, to, corner: None, basis }
    }

    fn at(&self, time_s: f64) -> f64 {
        let (from, to) = match self.corner {
            Some(corner) if time_s < corner.0 => (self.from, corner),
            Some(corner) => (corner, self.to),
            None => (self.from, self.to),
        };
        from.1 + (to.1 - from.1) * (time_s - from.0) / (to.0 - from.0)
    }

    /// Mean over the lost rows from `from_s` to `to_s`, and the deviations of the rows of a short hole from it.
    fn rows(&self, from_s: f64, to_s: f64, rows: usize) -> (f64, [f64; SHORT_HOLE]) {
        let mut beside = [0.0; SHORT_HOLE];
        if rows > SHORT_HOLE {
            return (0.5 * (self.from.1 + self.to.1), beside);
        }
        for (row, value) in beside[..rows].iter_mut().enumerate() {
            *value = self.at(from_s + row as f64 * (to_s - from_s) / rows as f64);
        }
        let mean = beside[..rows].iter().sum::<f64>() / rows as f64;
        beside[..rows].iter_mut().for_each(|value| *value -= mean);
        (mean, beside)
    }
}

/// Bound of the difference of two values by the rounding of decimals.
fn rounding(before: f64, after: f64) -> f64 {
    1e-6 * (before.abs() + after.abs())
}

/// Mean square errors of an interpolation: of the mean over the lost rows, and of the deviations of the rows from it.
#[derive(Clone, Copy, Default)]
struct SquareErrors {
    of_mean: f64,
    of_rows: f64,
    /// Of the mean estimated by the current; `None` where it was not measured.
    by_current: Option<f64>,
}

impl SquareErrors {
    fn total(&self) -> f64 {
        self.of_mean + self.of_rows
    }
}

/// Complete intervals of the length of a hole: the change of the input over each, by which they are sorted, and the errors of the
/// interpolation.
#[derive(Default)]
struct IntervalErrors(Vec<(f64, SquareErrors)>);

impl IntervalErrors {
    /// Mean over the nearest neighbours of the change; with too few intervals that of one edge at a uniformly distributed instant.
    fn expected(&self, change: f64, rows: usize) -> SquareErrors {
        let intervals = &self.0;
        if intervals.len() < NEIGHBOURS {
            let n = rows as f64;
            return SquareErrors {
                of_mean: change.powi(2) * (n + 2.0) / (12.0 * n),
                ..SquareErrors::default()
            };
        }
        let first = intervals.partition_point(|interval| interval.0 < change);
        let end = intervals.partition_point(|interval| interval.0 <= change);
        // Changes that are equal to the bit are the nearest neighbours, where they are enough.
        let nearest = if end - first >= NEIGHBOURS {
            &intervals[first..end]
        } else {
            let begin = first.saturating_sub(NEIGHBOURS / 2);
            &intervals[begin..end.max(begin + NEIGHBOURS).min(intervals.len())]
        };
        let mean_of = |of: fn(&SquareErrors) -> f64| {
            nearest.iter().map(|interval| of(&interval.1)).sum::<f64>() / nearest.len() as f64
        };
        let by_current = nearest.iter().filter_map(|interval| interval.1.by_current);
        let by_current: Vec<f64> = by_current.collect();
        SquareErrors {
            of_mean: mean_of(|error| error.of_mean),
            of_rows: mean_of(|error| error.of_rows),
            by_current: (2 * by_current.len() >= nearest.len()).then(|| mean(&by_current)),
        }
    }
}

/// The record, for the errors of interpolations over intervals without lost rows.
struct CompleteIntervals<'a> {
    input: &'a [(f64, f64)],
    measured: &'a [[f64; 2]],
    winding: Option<Winding>,
    period_s: f64,
    /// Integral of the input up to each row, holes interpolated linearly.
    integral: Vec<f64>,
    holes: Vec<(usize, usize)>,
}

impl<'a> CompleteIntervals<'a> {
    fn of(record: &Rows<'a>, lost: &[usize], period_s: f64) -> Self {
        let input = record.input;
        let mut integral = vec![0.0];
        let mut sum = 0.0;
        for (pair, &rows) in input.windows(2).zip(lost) {
            let length_s = pair[1].0 - pair[0].0;
            let known_s = if rows > 0 { period_s.min(length_s) } else { length_s };
            sum += pair[0].1 * known_s + 0.5 * (pair[0].1 + pair[1].1) * (length_s - known_s);
            integral.push(sum);
        }
        let holes = lost.iter().copied().enumerate().filter(|(_, rows)| *rows > 0);
        Self {
            input,
            measured: record.measured,
            winding: Winding::of(record, lost),
            period_s,
            integral,
            holes: holes.collect(),
        }
    }

    /// Mean over the lost rows between two, by the current; `beside` are their deviations from it.
    fn by_current(&self, [row, end]: [usize; 2], beside: &[f64]) -> Option<f64> {
        let measured = [self.measured[row], self.measured[end]];
        self.winding.as_ref()?.voltage(measured, self.input[row].1, beside)
    }

    /// The course between two rows that have `rows` lost ones between them.
    fn course(&self, row: usize, end: usize, rows: usize) -> Course {
        let (from, to) = (self.input[row], self.input[end]);
        let slope = |at: usize| {
            let (&(begin_s, first), &(end_s, last)) =
                (self.input.get(at)?, self.input.get(at + 1)?);
            // Neighbours are less than one period and a half apart.
            (end_s - begin_s < 1.5 * self.period_s).then(|| (last - first) / (end_s - begin_s))
        };
        let sides = (row.checked_sub(1).and_then(slope), slope(end));
        let (true, (Some(slope_before), Some(slope_after))) = (rows <= SHORT_HOLE, sides) else {
            return Course::line(from, to, Basis::Ends);
        };
        let length_s = to.0 - from.0;
        let corner_s = (to.1 - from.1 - slope_after * length_s) / (slope_before - slope_after);
        let value = from.1 + slope_before * corner_s;
        // A corner on the line, or at its ends, is none.
        let off_line = value - from.1 - (to.1 - from.1) * corner_s / length_s;
        if corner_s > 0.0 && corner_s < length_s && off_line.abs() > rounding(from.1, to.1) {
            return Course {
                corner: Some((from.0 + corner_s, value)),
                ..Course::line(from, to, Basis::Corner)
            };
        }
        Course::line(from, to, Basis::Line)
    }

    /// Errors over the intervals of the length of a hole of `rows` that have no such hole, by [`Basis`].
    fn errors(&self, rows: usize) -> [IntervalErrors; 4] {
        let mut found: [IntervalErrors; 4] = Default::default();
        let length_s = (rows + 1) as f64 * self.period_s;
        // 4,000 intervals are enough.
        let stride = self.input.len().div_ceil(4000).max(1);
        for row in (0..self.input.len().saturating_sub(1)).step_by(stride) {
            let (begin_s, before) = self.input[row];
            let end_s = begin_s + length_s;
            let half_s = 0.5 * self.period_s;
            let end = self.input.partition_point(|at| at.0 < end_s - half_s);
            let Some(&(to_s, after)) = self.input.get(end).filter(|at| at.0 < end_s + half_s)
            else {
                continue;
            };
            let first = self.holes.partition_point(|hole| hole.0 < row);
            let mut within = self.holes[first..].iter().take_while(|hole| hole.0 < end);
            if within.any(|hole| hole.1 >= rows) {
                continue;
            }
            let from_s = begin_s + self.period_s;
            let integral = self.integral[end] - self.integral[row] - before * self.period_s;
            let mean = integral / (to_s - from_s);
            let is_rounding = |square: f64| square.sqrt() <= rounding(before, after);
            let exact = |square: f64| if is_rounding(square) { 0.0 } else { square };
            let errors = |course: &Course| {
                let (estimate, beside) = course.rows(from_s, to_s, rows);
                let by_current =
                    (rows <= SHORT_HOLE).then(|| self.by_current([row, end], &beside[..rows]));
                let mut of_rows = 0.0;
                if rows > 1 && rows <= SHORT_HOLE {
                    let between = &self.input[row + 1..end];
                    let error = |at: &(f64, f64)| at.1 - course.at(at.0) - mean + estimate;
                    let squares = between.iter().map(error).map(|error| error * error);
                    of_rows = squares.sum::<f64>() / between.len().max(1) as f64;
                }
                SquareErrors {
                    of_mean: exact((mean - estimate).powi(2)),
                    of_rows: exact(of_rows),
                    by_current: by_current.flatten().map(|found| (mean - found).powi(2)),
                }
            };
            let change = (after - before).abs();
            let course = self.course(row, end, rows);
            let mut add =
                |basis: Basis, errors: SquareErrors| found[basis as usize].0.push((change, errors));
            let of_line = errors(&Course::line(course.from, course.to, Basis::Ends));
            add(Basis::Ends, of_line);
            if course.corner.is_some() {
                add(Basis::LineForCorner, of_line);
            }
            if !matches!(course.basis, Basis::Ends) {
                add(course.basis, errors(&course));
            }
        }
        for errors in &mut found {
            errors.0.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        found
    }
}

/// Prediction of the current one period ahead, `i' = f i + g u + h (w + w')/2`, by least squares over the complete intervals of
/// the record: accurate enough to infer a voltage, not to identify a motor.
struct Winding {
    f: f64,
    g: f64,
    h: f64,
}

impl Winding {
    fn of(record: &Rows<'_>, lost: &[usize]) -> Option<Self> {
        let rows: Vec<(SVector<f64, 3>, f64)> = (0..lost.len())
            .filter(|row| lost[*row] == 0)
            .filter_map(|row| {
                let ([i, w], [next_i, next_w]) = (record.measured[row], record.measured[row + 1]);
                let x = SVector::<f64, 3>::new(i, record.input[row].1, 0.5 * (w + next_w));
                let all = x.iter().all(|x| x.is_finite()) && next_i.is_finite();
                all.then_some((x, next_i))
            })
            .collect();
        if rows.len() < FEWEST_ROWS {
            return None;
        }
        let (mut normal, mut right) = (SMatrix::<f64, 3, 3>::zeros(), SVector::<f64, 3>::zeros());
        for (x, y) in &rows {
            normal += x * x.transpose();
            right += x * *y;
        }
        let solution = normal.cholesky()?.solve(&right);
        let (f, g, h) = (solution[0], solution[1], solution[2]);
        let is_stable = f > 0.0 && f < 1.0 && g > 0.0 && h.is_finite();
        is_stable.then_some(Self { f, g, h })
    }

    /// Mean voltage over the lost rows between two measured ones, the first with `before_v` for one period; `beside_v` are the
    /// deviations of the rows from it.
    fn voltage(
        &self,
        [[i, w], [next_i, next_w]]: [[f64; 2]; 2],
        before_v: f64,
        beside_v: &[f64],
    ) -> Option<f64> {
        let mut known = self.f * i + self.g * before_v + self.h * 0.5 * (w + next_w);
        let mut gain = 0.0;
        for beside_v in beside_v {
            known = self.f * known + self.g * beside_v + self.h * 0.5 * (w + next_w);
            gain = self.f * gain + self.g;
        }
        let volts = (next_i - known) / gain;
        volts.is_finite().then_some(volts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Holes of a record of one value a millisecond without the lost rows, with the current of `i' = 0.9 i + 0.1 u` and a speed where
    /// `measured`.
    fn holes(values: &[f64], measured: bool, lost: impl Fn(usize) -> bool) -> Vec<UnknownInput> {
        let mut current = 0.0;
        let (mut input, mut cells) = (Vec::new(), Vec::new());
        for (row, value) in values.iter().enumerate() {
            if !lost(row) {
                input.push((1e-3 * row as f64, *value));
                let speed = 0.1 * (row as f64).sin();
                cells.push(if measured { [current, speed] } else { [f64::NAN; 2] });
            }
            current = 0.9 * current + 0.1 * value;
        }
        find(&Rows { input: &input, measured: &cells, sample_period_s: 1e-3 })
    }

    /// The same of these rows without measurements.
    fn holes_of(rows: impl Iterator<Item = (f64, f64)>, sample_period_s: f64) -> Vec<UnknownInput> {
        let input: Vec<(f64, f64)> = rows.collect();
        find(&Rows { measured: &vec![[f64::NAN; 2]; input.len()], input: &input, sample_period_s })
    }

    fn all_lost(holes: &[UnknownInput]) -> usize {
        holes.iter().map(|hole| hole.lost_rows).sum()
    }

    /// Plus or minus five, held for `rows` at least, 3,000 values.
    fn switched(rows: usize) -> Vec<f64> {
        let mut state = 7_u32;
        let chips = (0..3000 / rows).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if state >> 31 == 0 { -5.0 } else { 5.0 }
        });
        let chips: Vec<f64> = chips.collect();
        (0..3000).map(|row| chips[row / rows]).collect()
    }

    #[test]
    fn equal_neighbours_prove_the_value_between_in_a_slow_input() {
        let one_row = |row: usize| row % 13 == 6;
        let slow = holes(&switched(10), false, one_row);
        let fast = holes(&switched(1), false, one_row);
        assert!(slow.len() > 200 && fast.len() > 200);
        let equal = |hole: &&UnknownInput| hole.mean.abs() > 1e-9;
        let off = |hole: &UnknownInput, variance: f64| (hole.variance - variance).abs();
        assert!(slow.iter().filter(equal).all(|hole| hole.variance == 0.0));
        // Half of the time the one between two equal values of a random sequence is the other: (2 x 5)^2 / 2.
        assert!(fast.iter().filter(equal).all(|hole| off(hole, 50.0) < 20.0));
        // Between two that differ it was one of them.
        assert!(slow.iter().filter(|hole| !equal(hole)).all(|hole| off(hole, 25.0) < 1.0));
    }

    #[test]
    fn ramps_and_their_corners_are_interpolated_exactly() {
        type Row = (&'static str, fn(i32) -> f64, fn(usize) -> bool, usize, usize);
        let corners = |row: i32| 3.5 * f64::from((row % 100 - 50).abs().clamp(10, 40));
        let rows: [Row; 3] = [
            (
                "three rows",
                |row| 3.5 * f64::from((row - 50).max(0)),
                |row| matches!(row % 40, 20..23),
                73,
                3,
            ),
            ("one row", |row| 0.25 * f64::from((row - 50).max(0)), |row| row % 40 == 20, 73, 1),
            // Two rows at the end of each third ramp, which is at 10, 40, 60 or 90 of a hundred.
            ("corners", corners, |row| matches!(row % 300, 39 | 40 | 159 | 160), 20, 2),
        ];
        for (name, value, lost, count, steps) in rows {
            let values: Vec<f64> = (0..3000).map(value).collect();
            let mut found = holes(&values, false, lost);
            found.retain(|hole| hole.from_s > 0.055 || name == "corners");
            assert!(found.len() >= count, "{name}: {}", found.len());
            for hole in &found {
                assert!(hole.variance < 1e-9 && hole.lost_rows == steps, "{name}: {hole:?}");
                for (from_s, value) in hole.steps() {
                    let expected = values[whole(from_s * 1e3 + 0.5)];
                    assert!((value - expected).abs() < 1e-6, "{name}: {value}, not {expected} V");
                }
            }
        }
    }

    #[test]
    fn the_current_determines_the_voltage_of_a_lost_row() {
        let values = switched(10);
        for (measured, most_v) in [(true, 0.1), (false, 5.1)] {
            let found = holes(&values, measured, |row| row % 13 == 6);
            let error = |hole: &UnknownInput| hole.mean - values[whole(hole.from_s * 1e3 + 0.5)];
            let worst = largest(found.iter().map(error));
            assert!(worst < most_v && (measured || worst > 4.9), "{worst}");
        }
    }

    #[test]
    fn a_long_hole_needs_a_restart_unless_the_input_is_constant() {
        let lost = |row: usize| (1000..1400).contains(&row);
        let [hole] = holes(&switched(10), true, lost)[..] else {
            panic!("one hole");
        };
        assert_eq!((hole.lost_rows, hole.restart.is_some()), (400, true));
        assert!((hole.from_s - 1.0).abs() < 1e-9 && (hole.to_s - 1.4).abs() < 1e-9);
        assert!(hole.variance > 0.5);
        let still = holes(&vec![3.0; 3000], true, lost)[0];
        assert!(still.variance < 1e-12 && still.restart.is_none());
    }

    #[test]
    fn rows_lost_from_late_polls_are_counted() {
        let values = switched(1);
        let late = |row: usize| 1e-2 * (row as f64 + 0.15 * (1.0 + (1.7 * row as f64).sin()));
        let lost = |row: usize| row > 0 && (row * 7919) % 100 < 10;
        let kept = (0..3000).filter(|row| !lost(*row));
        let found = holes_of(kept.clone().map(|row| (late(row), values[row])), 1e-2);
        assert_eq!(all_lost(&found), 3000 - kept.count());
        // A long hole among them, to the row.
        let late = |row: usize| 1e-2 * (row as f64 + 3e-4 * ((row * 7919) % 1000) as f64);
        let lost = |row: &usize| (row * 2741) % 97 < 10 || (500..541).contains(row);
        let kept: Vec<usize> = (0..1200).filter(|row| !lost(row)).collect();
        let steps = kept.windows(2).map(|pair| late(pair[1]) - late(pair[0]));
        let (_, multiples) = schedule(&steps.collect::<Vec<f64>>());
        for (pair, multiple) in kept.windows(2).zip(multiples) {
            assert_eq!(pair[1] - pair[0], whole(multiple), "row {}", pair[0]);
        }
        // A clock of 300 Hz in whole milliseconds, one row in thirteen lost.
        let stamp = |row: usize| (row as f64 / 0.3).round() * 1e-3;
        let kept = (0..3000).filter(|row| row % 13 != 6);
        let found = holes_of(kept.map(|row| (stamp(row), values[row])), 1.0 / 300.0);
        assert_eq!(all_lost(&found), 231);
    }

    #[test]
    fn whole_irregular_and_change_driven_records_have_lost_nothing() {
        let same = |a: f64, b: f64| a.to_bits() == b.to_bits();
        let values = switched(10);
        assert_eq!(holes(&values, true, |_| false), []);
        // A row for each change: every time between them is a multiple of the chips'.
        let changes = |row: usize| row > 0 && same(values[row], values[row - 1]);
        assert_eq!(holes(&values, true, changes), []);
        // A staircase of commands that a recorder wrote in the rows of its samples, where it changed.
        let chirp = (0..3000).map(|row| (5.0 * (2e-6 * f64::from(row).powi(2)).sin()).round());
        let chirp: Vec<f64> = chirp.collect();
        let repeats = |row: usize| row > 0 && same(chirp[row], chirp[row - 1]);
        assert_eq!(holes(&chirp, true, repeats), []);
        let stamps = |row: usize| (row as f64 + 0.4 * (1.7 * row as f64).sin()) * 9e-3;
        let kept = (0..3000).filter(|row| row % 10 != 0);
        assert_eq!(holes_of(kept.map(|row| (stamps(row), values[row])), 9e-3), []);
        // Commands on rows of their own.
        let fast = switched(1);
        let kept = (0..3000).filter(|row| row % 10 != 3);
        assert_eq!(holes_of(kept.map(|row| (0.01 * row as f64, fast[row])), 1e-3), []);
        // Irregular loops of whole milliseconds: times between rows in ms, and how often of a hundred.
        for steps in [
            &[(2, 89), (12, 10), (3, 1)][..],
            &[(2, 89), (12, 11)],
            &[(3, 96), (13, 4)],
            &[(2, 80), (3, 10), (4, 6), (7, 4)],
        ] {
            let step = |row: usize| {
                let mut left = row * 7919 % 100;
                let step = steps.iter().find(|(_, share)| {
                    let is_here = left < *share;
                    left = left.saturating_sub(*share);
                    is_here
                });
                step.unwrap().0
            };
            let mut at_ms = 0;
            let rows = fast.iter().enumerate().map(|(row, value)| {
                at_ms += step(row);
                (1e-3 * f64::from(at_ms), *value)
            });
            let rows: Vec<(f64, f64)> = rows.collect();
            let spans: Vec<f64> = rows.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
            assert_eq!(holes_of(rows.into_iter(), median(&spans)), [], "{steps:?}");
        }
    }
}

//! Unknown input: estimate of the input over lost rows of a record, and its variance.
//!
//! ```text
//! rows     u0    u1    (lost) (lost) u4        a held input: u1 holds for one period, u4 from its own stamp on
//! known    |-----|-----|             |-----
//! lost                 |------|------|         on the line from u1 to u4, with the variance that the record itself has between such
//!                                              rows; for a few lost rows the current improves it
//! ```
//!
//! Nothing counts as lost in a record that writes no row while its command stands still, nor in one whose rows come
//! irregularly, nor where commands stand on rows of their own: there the value before holds until the next.

use std::collections::HashMap;

use nalgebra::{SMatrix, SVector};

use crate::numerics::count::whole;
use crate::numerics::statistics::{largest, mean, median};

/// An interval without a row of the input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnknownInput {
    pub from_s: f64,
    pub to_s: f64,
    pub lost_rows: usize,
    /// Estimate of the mean of the input over the interval.
    pub mean: f64,
    /// Deviation of the estimate of each of a few lost rows from it.
    pub beside: [f64; FEW],
    /// Mean square of its error; zero where all such places of the record are as estimated: the same value on both sides of
    /// an input that changes slowly, a ramp that goes on.
    pub variance: f64,
    /// Where the error is so large that a simulation has to restart: the measured current and speed at `to_s`, not a number
    /// where missing.
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

/// Share of a period by which the time between rows may miss a multiple of it.
const OFF_THE_GRID: f64 = 0.1;
/// Lost rows up to which the current before and after tells the voltage between, and up to which no restart is needed.
const FEW: usize = 3;
/// Neighbours, in the size of the change, that a variance is taken from.
const NEIGHBOURS: usize = 50;
/// Fewest rows for a period and for a prediction of the current.
const FEWEST_ROWS: usize = 100;

impl UnknownInput {
    /// The time between two runs of one record: nothing is applied, and a simulation begins again behind it.
    pub(super) const fn between_runs(from_s: f64, to_s: f64, begins_with: [f64; 2]) -> Self {
        Self {
            from_s,
            to_s,
            lost_rows: 0,
            mean: 0.0,
            beside: [0.0; FEW],
            variance: 0.0,
            restart: Some(begins_with),
        }
    }

    /// The estimate as a held input: `(time, value)`.
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
    let Some((period_s, lost)) = lost_rows(record) else {
        return Vec::new();
    };
    let input = record.input;
    let largest = largest(input.iter().map(|row| row.1));
    let excursions = Excursions::of(record, &lost, period_s);
    let mut by_length: HashMap<usize, [Examples; 4]> = HashMap::new();
    let holes = (0..).zip(&lost).filter(|(_, rows)| **rows > 0);
    let estimate = |(row, &rows): (usize, &usize)| {
        let ((begin_s, before), (to_s, after)) = (input[row], input[row + 1]);
        let examples = by_length.entry(rows).or_insert_with(|| excursions.over(rows));
        let missed = |drawn: Drawn| examples[drawn as usize].misses((after - before).abs(), rows);
        let mut shape = excursions.shape(row, row + 1, rows);
        let mut miss = missed(shape.drawn);
        // A course without examples is worth less than a line; so is a corner where a line misses less.
        let instead = if examples[shape.drawn as usize].0.len() < NEIGHBOURS {
            Some(Drawn::Blind)
        } else {
            let is_worse = || miss.whole() >= missed(Drawn::Through).whole();
            (shape.corner.is_some() && is_worse()).then_some(Drawn::Through)
        };
        if let Some(drawn) = instead {
            shape = Shape::line(shape.from, shape.to, drawn);
            miss = missed(drawn);
        }
        let from_s = begin_s + period_s;
        let (mut mean, beside) = shape.rows(from_s, to_s, rows);
        let mut variance = miss.of_mean;
        if variance > 0.0
            && let Some(error) = miss.by_current
            && let Some(by_current) = excursions.by_current([row, row + 1], &beside[..rows])
        {
            let share = variance / (variance + error);
            mean += share * (by_current - mean);
            variance *= 1.0 - share;
        }
        variance += miss.bent;
        if rows > FEW {
            // The machine forgets: at the end of a long hole not its mean counts but the input in its last part, which may
            // have been that of either side.
            variance += 0.25 * (after - before).powi(2);
        }
        // A deviation of 0.2 % of the largest input needs no restart.
        let needs_restart = rows > FEW && variance.sqrt() > 0.002 * largest;
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

/// The period, and how many rows were lost after each row; `None` where the record is whole or irregular.
fn lost_rows(record: &Rows<'_>) -> Option<(f64, Vec<usize>)> {
    let input = record.input;
    let steps: Vec<f64> = input.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    if steps.len() < FEWEST_ROWS {
        return None;
    }
    let (period_s, multiples) = schedule(&steps);
    let share = |count: usize| count as f64 / steps.len() as f64;
    let is_on_the_grid =
        |(step, multiple): &(&f64, &f64)| (*step / period_s - *multiple).abs() <= OFF_THE_GRID;
    let on_the_grid = steps.iter().zip(&multiples).filter(is_on_the_grid).count();
    let is_single = |multiple: &&f64| **multiple <= 1.0;
    let single = multiples.iter().filter(is_single).count();
    let own_rows = (record.sample_period_s / period_s - 1.0).abs() > OFF_THE_GRID;
    // Loops keep to a grid of whole milliseconds each; a clock keeps to its schedule, but for the rounding of its stamps, and
    // polls come up to a quarter of a period late.
    let rounded_s = coarse_resolution_s(&steps, period_s);
    let late_s = rounded_s.map_or(0.25 * period_s, |rounded_s| 0.55 * rounded_s);
    let is_off =
        rounded_s.is_some_and(|rounded_s| holes_are_off((&steps, &multiples), period_s, rounded_s));
    let is_regular = share(on_the_grid) >= 0.95 && rounded_s.is_none()
        || share(on_schedule(input, &multiples, late_s)) >= 0.95 && !is_off;
    // A loop that pauses after one row in twenty, each time as long, has lost nothing.
    let pauses = share(most_frequent_pause(&multiples)) >= 0.05;
    if single == steps.len() || own_rows || !is_regular || share(single) < 0.5 || pauses {
        return None;
    }
    // A record that only writes changes repeats nothing, and changes over two periods by as much as over one.
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
    let lost = multiples.iter().map(|multiple| whole((multiple - 1.0).max(0.0)));
    Some((period_s, lost.collect()))
}

/// The period, and how many of it each step is. The median of late polls is too long where rows were lost: over a long hole it
/// misses by a whole row. The mean of steps of up to three periods does not.
fn schedule(steps: &[f64]) -> (f64, Vec<f64>) {
    let rounded = |period_s: f64| steps.iter().map(move |step| (step / period_s).round());
    let mut period_s = median(steps);
    let short = steps.iter().zip(rounded(period_s));
    let short = short.filter(|(_, multiple)| (1.0..=3.0).contains(multiple));
    let (length_s, rows) =
        short.fold((0.0, 0.0), |sum, (step, multiple)| (sum.0 + step, sum.1 + multiple));
    if rows > 0.0 {
        period_s = length_s / rows;
    }
    (period_s, rounded(period_s).collect())
}

/// The resolution of the stamps, s, where it is a good part of the period; `None` where it is fine, or the period itself.
fn coarse_resolution_s(steps: &[f64], period_s: f64) -> Option<f64> {
    // The greatest common divisor of all times between rows, by Euclid's algorithm down to the scatter of the last digit.
    let divisor = |mut a: f64, mut b: f64| {
        while b > 1e-3 * period_s {
            (a, b) = (b, (a - (a / b).round() * b).abs());
        }
        a
    };
    let resolution_s = steps.iter().copied().fold(0.0, divisor);
    let coarse_s = OFF_THE_GRID * period_s..(1.0 - OFF_THE_GRID) * period_s;
    coarse_s.contains(&resolution_s).then_some(resolution_s)
}

/// Whether the mean error of the holes of up to ten periods exceeds five standard deviations of what rounding makes of it:
/// `resolution / sqrt(6)` for each time between two rounded stamps.
fn holes_are_off((steps, multiples): (&[f64], &[f64]), period_s: f64, rounded_s: f64) -> bool {
    let holes = steps.iter().zip(multiples);
    let holes = holes.filter(|(_, multiple)| (2.0..=10.0).contains(*multiple));
    let off: Vec<f64> = holes.map(|(step, multiple)| step - multiple * period_s).collect();
    mean(&off).abs() > 5.0 * rounded_s / (6.0 * off.len() as f64).sqrt()
}

/// Number of the longer times between rows that are of one length of several periods, where they are more than all others
/// together: rows are lost one by one more often than so many together, and a loop with an occasional task takes so long each
/// time.
fn most_frequent_pause(multiples: &[f64]) -> usize {
    let longer = multiples.iter().filter(|multiple| **multiple > 1.0);
    let mut pauses: Vec<usize> = longer.map(|multiple| whole(*multiple)).collect();
    pauses.sort_unstable();
    let same = pauses.chunk_by(|a, b| a == b);
    let most = same.max_by_key(|same| same.len()).unwrap_or_default();
    let is_one_length = most.first().is_some_and(|periods| *periods > 2);
    if is_one_length && 2 * most.len() > pauses.len() { most.len() } else { 0 }
}

/// Rows that keep to the places of a schedule within `within_s`; `multiples` are the places between one row and the next.
fn on_schedule(input: &[(f64, f64)], multiples: &[f64], within_s: f64) -> usize {
    let mut place = 0.0;
    let mut rows = vec![(0.0, input[0].0)];
    for (row, multiple) in input[1..].iter().zip(multiples) {
        place += multiple;
        rows.push((place, row.0));
    }
    let count = rows.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| rows.iter().map(of).sum::<f64>() / count;
    let (mean_place, mean_s) = (mean(|row| row.0), mean(|row| row.1));
    let (mut products, mut squares) = (0.0, 0.0);
    for (place, time_s) in &rows {
        products += (place - mean_place) * (time_s - mean_s);
        squares += (place - mean_place).powi(2);
    }
    let period_s = products / squares;
    let late = |row: &&(f64, f64)| {
        let late_s = row.1 - mean_s - period_s * (row.0 - mean_place);
        late_s.abs() <= within_s
    };
    rows.iter().filter(late).count()
}

/// Whether most values occur once: they are not left out for being the same.
fn mostly_distinct(input: &[(f64, f64)]) -> bool {
    let mut values: Vec<f64> = input.iter().map(|row| row.1).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    2 * values.len() > input.len()
}

/// The likeliest course of the input between two rows: a line, or where those beside a few rows lead to one, a corner.
struct Shape {
    from: (f64, f64),
    to: (f64, f64),
    corner: Option<(f64, f64)>,
    drawn: Drawn,
}

/// What a course was drawn from.
#[derive(Clone, Copy)]
enum Drawn {
    /// The two rows alone.
    Blind,
    /// Rows beside them that lead to no corner, such as do, and a line in spite of them.
    Line,
    Corner,
    Through,
}

impl Shape {
    const fn line(from: (f64, f64), to: (f64, f64), drawn: Drawn) -> Self {
        Self { from, to, corner: None, drawn }
    }

    fn at(&self, time_s: f64) -> f64 {
        let (from, to) = match self.corner {
            Some(corner) if time_s < corner.0 => (self.from, corner),
            Some(corner) => (corner, self.to),
            None => (self.from, self.to),
        };
        from.1 + (to.1 - from.1) * (time_s - from.0) / (to.0 - from.0)
    }

    /// Mean over the lost rows, which are held from `from_s` to `to_s`, and what each of a few differs from it by.
    fn rows(&self, from_s: f64, to_s: f64, rows: usize) -> (f64, [f64; FEW]) {
        let mut beside = [0.0; FEW];
        if rows > FEW {
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

/// Differences of two values that come from the rounding of decimals.
fn rounding(before: f64, after: f64) -> f64 {
    1e-6 * (before.abs() + after.abs())
}

/// Mean squares of the errors of an estimate of lost rows: of their mean, and of each of them beside it.
#[derive(Clone, Copy, Default)]
struct Miss {
    of_mean: f64,
    bent: f64,
    /// Of the mean by the current; none where it was not measured.
    by_current: Option<f64>,
}

impl Miss {
    fn whole(&self) -> f64 {
        self.of_mean + self.bent
    }
}

/// Places as long as a hole where the record is complete: the change from one side to the other, by which they are sorted, and
/// the errors of the estimate there.
#[derive(Default)]
struct Examples(Vec<(f64, Miss)>);

impl Examples {
    /// Mean squares of the errors where the input changed by about as much; without examples those of one edge somewhere.
    fn misses(&self, change: f64, rows: usize) -> Miss {
        let places = &self.0;
        if places.len() < NEIGHBOURS {
            let n = rows as f64;
            return Miss { of_mean: change.powi(2) * (n + 2.0) / (12.0 * n), ..Miss::default() };
        }
        let near = places.partition_point(|place| place.0 < change);
        let same = places.partition_point(|place| place.0 <= change);
        // Changes that are the same to the bit are their own best examples.
        let about = if same - near >= NEIGHBOURS {
            &places[near..same]
        } else {
            let begin = near.saturating_sub(NEIGHBOURS / 2);
            &places[begin..same.max(begin + NEIGHBOURS).min(places.len())]
        };
        let mean_of = |of: fn(&Miss) -> f64| {
            about.iter().map(|place| of(&place.1)).sum::<f64>() / about.len() as f64
        };
        let by_current = about.iter().filter_map(|place| place.1.by_current);
        let by_current: Vec<f64> = by_current.collect();
        Miss {
            of_mean: mean_of(|miss| miss.of_mean),
            bent: mean_of(|miss| miss.bent),
            by_current: (2 * by_current.len() >= about.len()).then(|| mean(&by_current)),
        }
    }
}

/// The record as its own examples: the errors of estimates between two rows where the rows between them are there.
struct Excursions<'a> {
    input: &'a [(f64, f64)],
    measured: &'a [[f64; 2]],
    winding: Option<Winding>,
    period_s: f64,
    /// Integral of the held input up to each row, holes filled by the middle of their neighbours.
    integral: Vec<f64>,
    holes: Vec<(usize, usize)>,
}

impl<'a> Excursions<'a> {
    fn of(record: &Rows<'a>, lost: &[usize], period_s: f64) -> Self {
        let input = record.input;
        let mut integral = vec![0.0];
        let mut sum = 0.0;
        for (pair, &rows) in input.windows(2).zip(lost) {
            let length_s = pair[1].0 - pair[0].0;
            let held_s = if rows > 0 { period_s } else { length_s };
            let known_s = held_s.min(length_s);
            sum += pair[0].1 * known_s + 0.5 * (pair[0].1 + pair[1].1) * (length_s - known_s);
            integral.push(sum);
        }
        let holes = lost.iter().copied().enumerate();
        let holes = holes.filter(|(_, rows)| *rows > 0);
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
        let winding = self.winding.as_ref()?;
        winding.voltage(measured, self.input[row].1, beside)
    }

    /// The course between two rows that have `rows` lost ones between them.
    fn shape(&self, row: usize, end: usize, rows: usize) -> Shape {
        let (from, to) = (self.input[row], self.input[end]);
        let rise = |at: usize| {
            let (&(begin_s, first), &(end_s, last)) =
                (self.input.get(at)?, self.input.get(at + 1)?);
            // Neighbours are less than one period and a half apart.
            (end_s - begin_s < 1.5 * self.period_s).then(|| (last - first) / (end_s - begin_s))
        };
        let sides = (row.checked_sub(1).and_then(rise), rise(end));
        let (true, (Some(before), Some(behind))) = (rows <= FEW, sides) else {
            return Shape::line(from, to, Drawn::Blind);
        };
        let length_s = to.0 - from.0;
        let after_s = (to.1 - from.1 - behind * length_s) / (before - behind);
        let value = from.1 + before * after_s;
        // On a line any place is a corner, and at its ends none is.
        let beside = value - from.1 - (to.1 - from.1) * after_s / length_s;
        if after_s > 0.0 && after_s < length_s && beside.abs() > rounding(from.1, to.1) {
            return Shape {
                corner: Some((from.0 + after_s, value)),
                ..Shape::line(from, to, Drawn::Corner)
            };
        }
        Shape::line(from, to, Drawn::Line)
    }

    /// Examples as long as a hole of `rows`, as [`Drawn`] numbers them, without such as hold a hole of that size themselves.
    fn over(&self, rows: usize) -> [Examples; 4] {
        let mut found: [Examples; 4] = Default::default();
        let length_s = (rows + 1) as f64 * self.period_s;
        // 4,000 places are enough.
        let stride = self.input.len().div_ceil(4000).max(1);
        for row in (0..self.input.len().saturating_sub(1)).step_by(stride) {
            let (begin_s, before) = self.input[row];
            let end_s = begin_s + length_s;
            let close = 0.5 * self.period_s;
            let end = self.input.partition_point(|at| at.0 < end_s - close);
            let Some(&(to_s, after)) = self.input.get(end).filter(|at| at.0 < end_s + close) else {
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
            let missed = |shape: &Shape| {
                let (drawn, beside) = shape.rows(from_s, to_s, rows);
                let by_current =
                    (rows <= FEW).then(|| self.by_current([row, end], &beside[..rows]));
                let mut bent = 0.0;
                if rows > 1 && rows <= FEW {
                    let between = &self.input[row + 1..end];
                    let miss = |at: &(f64, f64)| at.1 - shape.at(at.0) - mean + drawn;
                    let squares = between.iter().map(miss).map(|miss| miss * miss);
                    bent = squares.sum::<f64>() / between.len().max(1) as f64;
                }
                Miss {
                    of_mean: exact((mean - drawn).powi(2)),
                    bent: exact(bent),
                    by_current: by_current.flatten().map(|found| (mean - found).powi(2)),
                }
            };
            let change = (after - before).abs();
            let shape = self.shape(row, end, rows);
            let blind = Shape::line(shape.from, shape.to, Drawn::Blind);
            let mut add = |drawn: Drawn, miss: Miss| found[drawn as usize].0.push((change, miss));
            let straight = missed(&blind);
            add(Drawn::Blind, straight);
            if shape.corner.is_some() {
                add(Drawn::Through, straight);
            }
            if !matches!(shape.drawn, Drawn::Blind) {
                add(shape.drawn, missed(&shape));
            }
        }
        for examples in &mut found {
            examples.0.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        found
    }
}

/// The current one period on, `i' = f i + g u + h (w + w')/2`, by least squares over the whole intervals of the record: good
/// enough to infer a voltage, not to identify.
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
        let possible = f > 0.0 && f < 1.0 && g > 0.0 && h.is_finite();
        possible.then_some(Self { f, g, h })
    }

    /// Mean voltage over the lost rows between two measured ones, of which the first held `before_v` for a period; `beside_v`
    /// are the deviations of the rows from it.
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
    /// Holes of a record of one value a millisecond without the rows that were lost; current and speed follow from
    /// `i' = 0.9 i + 0.1 u` where `measured`.
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
        let mut differ = slow.iter().filter(|hole| !equal(hole));
        assert!(differ.all(|hole| off(hole, 25.0) < 1.0));
    }

    #[test]
    fn ramps_and_their_corners_are_known_through_lost_rows() {
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
                    let there = values[whole(from_s * 1e3 + 0.5)];
                    assert!((value - there).abs() < 1e-6, "{name}: {value}, not {there} V");
                }
            }
        }
    }

    #[test]
    fn the_current_tells_the_voltage_of_a_lost_row() {
        let values = switched(10);
        for (measured, most_v) in [(true, 0.1), (false, 5.1)] {
            let found = holes(&values, measured, |row| row % 13 == 6);
            let miss = |hole: &UnknownInput| hole.mean - values[whole(hole.from_s * 1e3 + 0.5)];
            let worst = largest(found.iter().map(miss));
            assert!(worst < most_v && (measured || worst > 4.9), "{worst}");
        }
    }

    #[test]
    fn a_long_hole_needs_a_restart_unless_the_input_stands_still() {
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
        let irregular = kept.map(|row| (stamps(row), values[row]));
        assert_eq!(holes_of(irregular, 9e-3), []);
        // Commands on rows of their own.
        let fast = switched(1);
        let kept = (0..3000).filter(|row| row % 10 != 3);
        let commands = kept.map(|row| (0.01 * row as f64, fast[row]));
        assert_eq!(holes_of(commands, 1e-3), []);
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

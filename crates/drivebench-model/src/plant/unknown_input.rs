//! Unknown input of a record: rows that were lost between two that tell it, and what is known all the same.
//!
//! ```text
//! rows     u0    u1    (lost) (lost) u4        a held input: u1 holds for one period, u4 from its own stamp on
//! known    |-----|-----|             |-----
//! lost                 |------|------|         on the line from u1 to u4, with the variance that the record itself has between such
//!                                              rows; of a few lost rows also what the current did meanwhile
//! ```
//!
//! Nothing is taken for lost in a record that writes no row while its command stands still, nor in one whose rows come
//! irregularly, nor where commands stand on rows of their own: there the value before holds until the next.

use nalgebra::{SMatrix, SVector};

use crate::numerics::count::whole;
use crate::numerics::statistics::median;

/// An interval over which no row tells the input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnknownInput {
    pub from_s: f64,
    pub to_s: f64,
    pub lost_rows: usize,
    /// Mean of the input over the interval, as far as it is known: what a simulation takes.
    pub mean: f64,
    /// What the estimate of each of a few lost rows differs from it by.
    pub beside: [f64; FEW],
    /// Mean square of its error; zero where the record never does anything else between two such rows: the same value on
    /// both sides where it does not change and come back so soon, a ramp that goes on.
    pub variance: f64,
    /// Where so much is not known that a simulation has to begin again: the measured current and speed at `to_s`, not a
    /// number where missing.
    pub restart: Option<[f64; 2]>,
}

/// Rows of a record that tell the input, as the search for lost ones needs them.
pub(super) struct Told<'a> {
    /// `(time, value)`.
    pub(super) input: &'a [(f64, f64)],
    /// Current and speed in the same rows, NaN where missing.
    pub(super) measured: &'a [[f64; 2]],
    /// Median time between the samples, s.
    pub(super) sample_period_s: f64,
}

/// Share of a period by which the time between rows may miss a multiple of it, and the share of rows that keep to it.
const OFF_THE_GRID: f64 = 0.1;
const NEARLY_ALL: f64 = 0.95;
/// Rows up to which a step tells the period.
const SHORT: f64 = 3.0;
/// The same where rows are polled on a schedule, each a little late: share of a period by which a row may miss its place.
const OFF_THE_SCHEDULE: f64 = 0.25;
/// Share of a period by which stamps of one resolution scatter: the last figure of a binary number.
const SCATTER: f64 = 1e-3;
/// Share of the resolution by which rounding moves a stamp of a clock, and a little.
const ROUNDED: f64 = 0.55;
/// Periods of a hole over which an error of the period does not count, and standard deviations of the mean of what two rounded
/// stamps miss a time by, `resolution / sqrt(6)` each.
const SHORT_HOLE: f64 = 10.0;
const CERTAIN: f64 = 5.0;
/// Share of the rows behind which a loop pauses, each time as long.
const PAUSES: f64 = 0.05;
/// Share of rows that follow one period after the last one, at least.
const MOST: f64 = 0.5;
/// Share of rows that repeat the value before from which a record writes rows without a change.
const REPEATS: f64 = 0.005;
/// A change over a hole that is so many times that over a period took place in several rows.
const GROWS: f64 = 1.5;
/// Lost rows up to which the current before and after tells the voltage between, and up to which no restart is needed.
const FEW: usize = 3;
/// Neighbours, in the size of the change, that a variance is taken from, and places that are looked at.
const NEIGHBOURS: usize = 50;
const PLACES: usize = 4000;
/// Deviation of the mean, as a share of the largest input, that needs no restart.
const NEARLY_KNOWN: f64 = 0.002;
/// Rows below which no current is predicted.
const FEWEST_ROWS: usize = 100;

/// Periods that two rows may lie apart and still follow each other.
const NEXT: f64 = 1.5;

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

/// The holes of a record, in order.
pub(super) fn find(told: &Told<'_>) -> Vec<UnknownInput> {
    let Some((period_s, lost)) = lost_rows(told) else {
        return Vec::new();
    };
    let input = told.input;
    let sizes = input.iter().map(|row| row.1.abs());
    let largest = sizes.fold(0.0, f64::max);
    let excursions = Excursions::of(told, &lost, period_s);
    let mut by_length: Vec<(usize, [Examples; 4])> = Vec::new();
    let mut holes = Vec::new();
    for (row, &rows) in lost.iter().enumerate().filter(|(_, rows)| **rows > 0) {
        let ((begin_s, before), (to_s, after)) = (input[row], input[row + 1]);
        let place = by_length.iter().position(|(length, _)| *length == rows);
        let place = place.unwrap_or_else(|| {
            by_length.push((rows, excursions.over(rows)));
            by_length.len() - 1
        });
        let examples = &by_length[place].1;
        let missed = |drawn: Drawn| examples[drawn as usize].misses((after - before).abs(), rows);
        let mut shape = excursions.shape(row, row + 1, rows);
        let mut miss = missed(shape.drawn);
        // A course of which there is nothing to learn from says less than a line; so does a corner where a line misses less.
        let instead = if examples[shape.drawn as usize].0.len() < NEIGHBOURS {
            Some(Drawn::Blind)
        } else {
            let through = missed(Drawn::Through);
            let is_worse = shape.corner.is_some() && miss.whole() >= through.whole();
            is_worse.then_some(Drawn::Through)
        };
        if let Some(drawn) = instead {
            shape = Shape::line(shape.from, shape.to, drawn);
            miss = missed(drawn);
        }
        let from_s = begin_s + period_s;
        let (mut mean, beside) = shape.rows(from_s, to_s, rows);
        let mut variance = miss.of_mean;
        if variance > 0.0
            && let Some(error) = miss.of_seen
            && let Some(seen) = excursions.seen([row, row + 1], &beside[..rows])
        {
            let share = variance / (variance + error);
            mean += share * (seen - mean);
            variance *= 1.0 - share;
        }
        variance += miss.bent;
        if rows > FEW {
            // The machine forgets: what counts at the end of a long hole is not its mean but the input in its last part,
            // which may have been that of either side.
            variance += 0.25 * (after - before).powi(2);
        }
        let needs_restart = rows > FEW && variance.sqrt() > NEARLY_KNOWN * largest;
        holes.push(UnknownInput {
            from_s,
            to_s,
            lost_rows: rows,
            mean,
            beside,
            variance,
            restart: needs_restart.then_some(told.measured[row + 1]),
        });
    }
    holes
}

/// The period, and how many rows were lost after each row; `None` where the record is whole, or does not tell.
fn lost_rows(told: &Told<'_>) -> Option<(f64, Vec<usize>)> {
    let input = told.input;
    let steps: Vec<f64> = input.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    if steps.len() < FEWEST_ROWS {
        return None;
    }
    let (period_s, multiples) = schedule(&steps);
    let share = |count: usize| count as f64 / steps.len() as f64;
    let on_the_grid = (steps.iter().zip(&multiples))
        .filter(|(step, multiple)| (*step / period_s - *multiple).abs() <= OFF_THE_GRID)
        .count();
    let single = multiples
        .iter()
        .filter(|multiple| **multiple <= 1.0)
        .count();
    let own_rows = (told.sample_period_s / period_s - 1.0).abs() > OFF_THE_GRID;
    // Of whole milliseconds, each loop of some keeps to a grid; a clock keeps to its schedule, but for the rounding.
    let rounded_s = coarse_resolution_s(&steps, period_s);
    let late_s = rounded_s.map_or(OFF_THE_SCHEDULE * period_s, |rounded_s| ROUNDED * rounded_s);
    let is_off =
        rounded_s.is_some_and(|rounded_s| holes_are_off((&steps, &multiples), period_s, rounded_s));
    let is_regular = share(on_the_grid) >= NEARLY_ALL && rounded_s.is_none()
        || share(on_schedule(input, &multiples, late_s)) >= NEARLY_ALL && !is_off;
    let pauses = share(most_frequent_pause(&multiples)) >= PAUSES;
    if single == steps.len() || own_rows || !is_regular || share(single) < MOST || pauses {
        return None;
    }
    // A record that only writes what changes repeats nothing, and changes over two periods by as much as over one.
    let changes = |alone: bool| -> Vec<f64> {
        (input.windows(2).zip(&multiples))
            .filter(|(_, multiple)| (**multiple <= 1.0) == alone)
            .map(|(pair, _)| (pair[1].1 - pair[0].1).abs())
            .collect()
    };
    let (alone, over_holes) = (changes(true), changes(false));
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let repeats = alone.iter().filter(|change| **change <= 0.0).count();
    let writes_repeats = repeats as f64 > REPEATS * alone.len() as f64;
    if !writes_repeats && mean(&over_holes) < GROWS * mean(&alone) && !mostly_distinct(input) {
        return None;
    }
    let lost = multiples
        .iter()
        .map(|multiple| whole((multiple - 1.0).max(0.0)));
    Some((period_s, lost.collect()))
}

/// The period, and how many of it each step is. The median of polls that come late is that of steps a little too long, where
/// some rows were lost: over a long hole it misses by a whole row. The mean of short steps does not.
fn schedule(steps: &[f64]) -> (f64, Vec<f64>) {
    let mut period_s = median(steps);
    let rounded = |period_s: f64| -> Vec<f64> {
        let multiple = |step: &f64| (step / period_s).round();
        steps.iter().map(multiple).collect()
    };
    let multiples = rounded(period_s);
    let short = steps.iter().zip(&multiples);
    let short = short.filter(|(_, multiple)| (1.0..=SHORT).contains(*multiple));
    let (length_s, rows) = short.fold((0.0, 0.0), |sum, (step, multiple)| {
        (sum.0 + step, sum.1 + multiple)
    });
    if rows > 0.0 {
        period_s = length_s / rows;
    }
    (period_s, rounded(period_s))
}

/// The resolution of the stamps, s, where it is a good part of the period; `None` where it is fine, or the period itself.
fn coarse_resolution_s(steps: &[f64], period_s: f64) -> Option<f64> {
    // What divides all times between rows.
    let divisor = |mut a: f64, mut b: f64| {
        while b > SCATTER * period_s {
            (a, b) = (b, (a - (a / b).round() * b).abs());
        }
        a
    };
    let resolution_s = steps.iter().copied().fold(0.0, divisor);
    let coarse_s = OFF_THE_GRID * period_s..(1.0 - OFF_THE_GRID) * period_s;
    coarse_s.contains(&resolution_s).then_some(resolution_s)
}

/// Whether the short holes are longer than whole periods, or shorter, by more than rounding makes them in the mean.
fn holes_are_off((steps, multiples): (&[f64], &[f64]), period_s: f64, rounded_s: f64) -> bool {
    let holes = steps.iter().zip(multiples);
    let holes = holes.filter(|(_, multiple)| (2.0..=SHORT_HOLE).contains(*multiple));
    let off: Vec<f64> = holes
        .map(|(step, multiple)| step - multiple * period_s)
        .collect();
    let count = off.len().max(1) as f64;
    let mean_s = off.iter().sum::<f64>() / count;
    mean_s.abs() > CERTAIN * rounded_s / (6.0 * count).sqrt()
}

/// How often the longer times between rows are of one length, of several periods, that is more frequent than all others
/// together: rows are lost one by one more often than so many together, and a loop that does something else now and then
/// takes so long each time.
fn most_frequent_pause(multiples: &[f64]) -> usize {
    let mut pauses: Vec<usize> = multiples
        .iter()
        .filter(|multiple| **multiple > 1.0)
        .map(|multiple| whole(*multiple))
        .collect();
    pauses.sort_unstable();
    let same = pauses.chunk_by(|a, b| a == b);
    let most = same.max_by_key(|same| same.len()).unwrap_or_default();
    if most.first().is_some_and(|periods| *periods > 2) && 2 * most.len() > pauses.len() {
        most.len()
    } else {
        0
    }
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

/// Values that hardly ever come again would not be left out for being the same.
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
        Self {
            from,
            to,
            corner: None,
            drawn,
        }
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

/// What sums of decimals leave between two values is nothing.
fn rounding(before: f64, after: f64) -> f64 {
    1e-6 * (before.abs() + after.abs())
}

/// What an estimate of lost rows misses, mean squares: their mean, each of them beside that.
#[derive(Clone, Copy, Default)]
struct Miss {
    of_mean: f64,
    bent: f64,
    /// Of the mean that the current tells; none where it was not measured.
    of_seen: Option<f64>,
}

impl Miss {
    fn whole(&self) -> f64 {
        self.of_mean + self.bent
    }
}

/// Places as long as a hole, of which the record tells what was between: the change from one side to the other, by which
/// they are sorted, and what was missed.
#[derive(Default)]
struct Examples(Vec<(f64, Miss)>);

impl Examples {
    /// Mean squares of the misses where the input changed by about as much; without examples those of one edge somewhere.
    fn misses(&self, change: f64, rows: usize) -> Miss {
        let places = &self.0;
        if places.len() < NEIGHBOURS {
            let n = rows as f64;
            return Miss {
                of_mean: change.powi(2) * (n + 2.0) / (12.0 * n),
                ..Miss::default()
            };
        }
        let near = places.partition_point(|place| place.0 < change);
        let same = places.partition_point(|place| place.0 <= change);
        let begin = near.saturating_sub(NEIGHBOURS / 2);
        let end = same.max(begin + NEIGHBOURS).min(places.len());
        // Changes that are the same to the bit are their own best examples.
        let about = if same - near >= NEIGHBOURS {
            &places[near..same]
        } else {
            &places[begin..end]
        };
        let mean = |of: fn(&Miss) -> f64| {
            about.iter().map(|place| of(&place.1)).sum::<f64>() / about.len() as f64
        };
        let seen: Vec<f64> = about.iter().filter_map(|place| place.1.of_seen).collect();
        Miss {
            of_mean: mean(|miss| miss.of_mean),
            bent: mean(|miss| miss.bent),
            of_seen: (2 * seen.len() >= about.len())
                .then(|| seen.iter().sum::<f64>() / seen.len() as f64),
        }
    }
}

/// By how much what is drawn between two rows misses those between them, where the record tells it.
struct Excursions<'a> {
    input: &'a [(f64, f64)],
    measured: &'a [[f64; 2]],
    winding: Option<Winding>,
    period_s: f64,
    /// Integral of the held input up to each row, holes filled by the middle of their neighbours.
    integral: Vec<f64>,
    /// Each hole's row and rows lost.
    holes: Vec<(usize, usize)>,
}

impl<'a> Excursions<'a> {
    fn of(told: &Told<'a>, lost: &[usize], period_s: f64) -> Self {
        let input = told.input;
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
            measured: told.measured,
            winding: Winding::of(told, lost),
            period_s,
            integral,
            holes: holes.collect(),
        }
    }

    /// Mean over the lost rows between two, that the current tells where `beside` is what each of them differs from it by.
    fn seen(&self, [row, end]: [usize; 2], beside: &[f64]) -> Option<f64> {
        let measured = [self.measured[row], self.measured[end]];
        let winding = self.winding.as_ref()?;
        winding.voltage(measured, self.input[row].1, beside)
    }

    /// What is drawn between two rows that have `rows` lost ones between them.
    fn shape(&self, row: usize, end: usize, rows: usize) -> Shape {
        let (from, to) = (self.input[row], self.input[end]);
        let rise = |at: usize| {
            let (&(begin_s, first), &(end_s, last)) =
                (self.input.get(at)?, self.input.get(at + 1)?);
            (end_s - begin_s < NEXT * self.period_s).then(|| (last - first) / (end_s - begin_s))
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
        let stride = self.input.len().div_ceil(PLACES).max(1);
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
                let seen = (rows <= FEW).then(|| self.seen([row, end], &beside[..rows]));
                let bent = if rows > 1 && rows <= FEW {
                    let between = &self.input[row + 1..end];
                    let misses = between.iter();
                    let misses =
                        misses.map(|(time_s, value)| value - shape.at(*time_s) - mean + drawn);
                    misses.map(|miss| miss * miss).sum::<f64>() / between.len().max(1) as f64
                } else {
                    0.0
                };
                Miss {
                    of_mean: exact((mean - drawn).powi(2)),
                    bent: exact(bent),
                    of_seen: seen.flatten().map(|seen| (mean - seen).powi(2)),
                }
            };
            let change = (after - before).abs();
            let shape = self.shape(row, end, rows);
            let blind = Shape::line(shape.from, shape.to, Drawn::Blind);
            found[Drawn::Blind as usize]
                .0
                .push((change, missed(&blind)));
            if shape.corner.is_some() {
                let through = missed(&blind);
                found[Drawn::Through as usize].0.push((change, through));
            }
            if !matches!(shape.drawn, Drawn::Blind) {
                found[shape.drawn as usize].0.push((change, missed(&shape)));
            }
        }
        for examples in &mut found {
            examples.0.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        found
    }
}

/// The current one period on, `i' = f i + g u + h (w + w')/2`, as the whole intervals of the record have it: good enough
/// to tell a voltage from it, not to identify.
struct Winding {
    f: f64,
    g: f64,
    h: f64,
}

impl Winding {
    fn of(told: &Told<'_>, lost: &[usize]) -> Option<Self> {
        let rows: Vec<(SVector<f64, 3>, f64)> = (0..lost.len())
            .filter(|row| lost[*row] == 0)
            .filter_map(|row| {
                let ([i, w], [next_i, next_w]) = (told.measured[row], told.measured[row + 1]);
                let x = SVector::<f64, 3>::new(i, told.input[row].1, 0.5 * (w + next_w));
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

    /// Mean voltage over the lost rows between two measured ones, of which the first held `before_v` for a period;
    /// `beside_v` is what each row differs from it by.
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
        let mut rows = Vec::new();
        for (row, value) in values.iter().enumerate() {
            if !lost(row) {
                let seen = if measured {
                    [current, 0.1 * (row as f64).sin()]
                } else {
                    [f64::NAN; 2]
                };
                rows.push(((1e-3 * row as f64, *value), seen));
            }
            current = 0.9 * current + 0.1 * value;
        }
        let (input, measured): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
        find(&Told {
            input: &input,
            measured: &measured,
            sample_period_s: 1e-3,
        })
    }

    /// The same of these rows, of which nothing was measured.
    fn holes_of(
        input: impl Iterator<Item = (f64, f64)>,
        sample_period_s: f64,
    ) -> Vec<UnknownInput> {
        let input: Vec<(f64, f64)> = input.collect();
        find(&Told {
            measured: &vec![[f64::NAN; 2]; input.len()],
            input: &input,
            sample_period_s,
        })
    }

    /// That the estimate of every lost row of these holes is its value, to `within`.
    #[track_caller]
    fn assert_known<'a>(
        holes: impl IntoIterator<Item = &'a UnknownInput>,
        values: &[f64],
        within: f64,
    ) {
        for hole in holes {
            for (from_s, value) in hole.steps() {
                let there = values[whole(from_s * 1e3 + 0.5)];
                assert!((value - there).abs() < within, "{value}, not {there} V");
            }
            assert!(hole.variance < 1e-9, "{hole:?}");
        }
    }

    /// Plus or minus five, held for `rows` at least.
    fn switched(rows: usize, count: usize) -> Vec<f64> {
        let mut state = 7_u32;
        let chips = (0..count.div_ceil(rows)).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if state >> 31 == 0 { -5.0 } else { 5.0 }
        });
        let chips: Vec<f64> = chips.collect();
        (0..count).map(|row| chips[row / rows]).collect()
    }

    #[test]
    fn equal_neighbours_prove_the_value_between_only_where_the_input_is_slower_than_the_hole() {
        let one_row = |row: usize| row % 13 == 6;
        let slow = holes(&switched(10, 3000), false, one_row);
        let fast = holes(&switched(1, 3000), false, one_row);
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
    fn a_ramp_goes_on_through_several_lost_rows_and_each_of_them_is_known() {
        let ramp: Vec<f64> = (0..900)
            .map(|row| (f64::from(row) - 50.0).max(0.0) * 3.5)
            .collect();
        let found = holes(&ramp, false, |row| matches!(row % 40, 20..23));
        let late: Vec<&UnknownInput> = found.iter().filter(|hole| hole.from_s > 0.055).collect();
        assert!(late.len() > 15);
        assert!(late.iter().all(|hole| hole.steps().count() == 3));
        assert_known(late, &ramp, 1e-6);
    }

    #[test]
    fn a_ramp_that_ends_among_lost_rows_leads_to_the_corner_that_it_ends_in() {
        let ramps: Vec<f64> = (0..3000)
            .map(|row| 3.5 * f64::from((row % 100 - 50_i32).abs().clamp(10, 40)))
            .collect();
        // Two rows at the end of each third ramp, which is at 10, 40, 60 or 90 of a hundred.
        let lost = |row: usize| matches!(row % 300, 39 | 40 | 159 | 160);
        let found = holes(&ramps, false, lost);
        assert_eq!(found.len(), 20);
        assert_known(&found, &ramps, 1e-6);
    }

    #[test]
    fn a_ramp_goes_on_through_a_lost_row_and_is_known() {
        let ramp: Vec<f64> = (0..600)
            .map(|row| (f64::from(row) - 50.0).max(0.0) * 0.25)
            .collect();
        let found = holes(&ramp, false, |row| row % 40 == 20);
        let late: Vec<&UnknownInput> = found.iter().filter(|hole| hole.from_s > 0.055).collect();
        assert!(late.len() > 10);
        assert!(late.iter().all(|hole| hole.variance < 1e-12));
        assert_known(late, &ramp, 1e-9);
    }

    #[test]
    fn the_current_tells_the_voltage_of_a_lost_row() {
        let values = switched(10, 3000);
        let lost = |row: usize| row % 13 == 6;
        for (measured, most_v) in [(true, 0.1), (false, 5.1)] {
            let found = holes(&values, measured, lost);
            let miss =
                |hole: &UnknownInput| (hole.mean - values[whole(hole.from_s * 1e3 + 0.5)]).abs();
            let worst = found.iter().map(miss).fold(0.0, f64::max);
            assert!(worst < most_v && (measured || worst > 4.9), "{worst}");
        }
    }

    #[test]
    fn a_long_hole_asks_for_a_restart_unless_nothing_happens_in_such_a_time() {
        let found = holes(&switched(10, 3000), true, |row| (1000..1400).contains(&row));
        assert_eq!(found.len(), 1);
        assert_eq!(
            (found[0].lost_rows, found[0].restart.is_some()),
            (400, true)
        );
        assert!((found[0].from_s - 1.0).abs() < 1e-9 && (found[0].to_s - 1.4).abs() < 1e-9);
        assert!(found[0].variance > 0.5);
        let still = vec![3.0; 3000];
        let still = holes(&still, true, |row| (1000..1400).contains(&row));
        assert!(still[0].variance < 1e-12 && still[0].restart.is_none());
    }

    #[test]
    fn rows_lost_from_polls_that_come_a_little_late_are_found() {
        let values = switched(1, 3000);
        let late = |row: usize| 1e-2 * (row as f64 + 0.3 * (0.5 + 0.5 * (1.7 * row as f64).sin()));
        let lost = |row: usize| row > 0 && (row * 7919) % 100 < 10;
        let kept = (0..3000).filter(|row| !lost(*row));
        let found = holes_of(kept.clone().map(|row| (late(row), values[row])), 1e-2);
        let rows: usize = found.iter().map(|hole| hole.lost_rows).sum();
        assert_eq!(rows, 3000 - kept.count());
    }

    #[test]
    fn a_long_hole_among_late_polls_is_counted_to_the_row() {
        let late = |row: usize| 1e-2 * (row as f64 + 0.3 * ((row * 7919) % 1000) as f64 / 1000.0);
        let lost = |row: &usize| (row * 2741) % 97 < 10 || (500..541).contains(row);
        let kept: Vec<usize> = (0..1200).filter(|row| !lost(row)).collect();
        let steps = kept.windows(2).map(|pair| late(pair[1]) - late(pair[0]));
        let (_, multiples) = schedule(&steps.collect::<Vec<f64>>());
        for (pair, multiple) in kept.windows(2).zip(multiples) {
            assert_eq!(pair[1] - pair[0], whole(multiple), "row {}", pair[0]);
        }
    }

    #[test]
    fn a_whole_record_one_of_changes_only_and_one_without_a_beat_have_lost_nothing() {
        let same = |a: f64, b: f64| a.to_bits() == b.to_bits();
        let values = switched(10, 3000);
        assert_eq!(holes(&values, true, |_| false), []);
        // A row for each change: every time between them is a multiple of the chips'.
        let changes = |row: usize| row > 0 && same(values[row], values[row - 1]);
        assert_eq!(holes(&values, true, changes), []);
        // A staircase of commands that a recorder wrote in the rows of its samples, where it changed.
        let chirp: Vec<f64> = (0..3000)
            .map(|row| (5.0 * (2e-6 * f64::from(row).powi(2)).sin()).round())
            .collect();
        let repeats = |row: usize| row > 0 && same(chirp[row], chirp[row - 1]);
        assert_eq!(holes(&chirp, true, repeats), []);
        let stamps = |row: usize| (row as f64 + 0.4 * (1.7 * row as f64).sin()) * 9e-3;
        let kept = (0..3000).filter(|row| row % 10 != 0);
        assert_eq!(
            holes_of(kept.map(|row| (stamps(row), values[row])), 9e-3),
            []
        );
    }

    #[test]
    fn an_irregular_loop_of_whole_milliseconds_has_lost_nothing_and_a_rounded_clock_has() {
        let values = switched(1, 3000);
        // Times between rows in ms, and how often of a hundred.
        for steps in [
            &[(2, 89), (12, 10), (3, 1)][..],
            &[(2, 89), (12, 11)],
            &[(3, 96), (13, 4)],
            &[(2, 80), (3, 10), (4, 6), (7, 4)],
        ] {
            let mut sequence: Vec<usize> = (0..3000).map(|row| row * 7919 % 100).collect();
            for place in &mut sequence {
                let mut left = *place;
                let step = steps.iter().find(|(_, share)| {
                    let is_here = left < *share;
                    left = left.saturating_sub(*share);
                    is_here
                });
                *place = step.unwrap().0;
            }
            let mut at_ms = 0;
            let rows = sequence.iter().zip(&values).map(|(step, value)| {
                at_ms += step;
                (1e-3 * at_ms as f64, *value)
            });
            let rows: Vec<(f64, f64)> = rows.collect();
            let spans: Vec<f64> = rows.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
            assert_eq!(holes_of(rows.into_iter(), median(&spans)), [], "{steps:?}");
        }
        // 300 Hz in whole milliseconds, one row in thirteen lost.
        let stamp = |row: usize| (row as f64 / 0.3).round() * 1e-3;
        let kept = (0..3000).filter(|row| row % 13 != 6);
        let found = holes_of(kept.map(|row| (stamp(row), values[row])), 1.0 / 300.0);
        let rows: usize = found.iter().map(|hole| hole.lost_rows).sum();
        assert_eq!(rows, 231);
    }

    #[test]
    fn commands_on_rows_of_their_own_hold_until_the_next() {
        let values = switched(1, 3000);
        let kept = (0..3000).filter(|row| row % 10 != 3);
        let commands = kept.map(|row| (0.01 * row as f64, values[row]));
        assert_eq!(holes_of(commands, 1e-3), []);
    }
}

//! Noise levels of a run by maximum marginal likelihood (empirical Bayes), with every effect in under its slab. The likelihood is
//! that of the innovations of a Kalman filter (Schweppe, IEEE Trans. Information Theory 11, 1965).

use nalgebra::{DMatrix, DMatrixView, DVector};
use rayon::prelude::*;

use super::columns::{Linear, LinearisedRun};
use super::follow::{Noise, P, Passage, corrected, jump_of, predicted, stop};
use super::select::Reduced;
use super::tangent::{Deviations, LANES, Lane, Step};
use super::whitened::{Whitened, add_upper, turned};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::propagator::Propagator;
use drivebench_model::plant::Input;

/// Interval over which samples are averaged, s: the disturbance is slower.
const BLOCK_S: f64 = 6e-3;
/// Blocks whose innovations are multiplied at once.
const AT_ONCE: usize = 128;

/// One run in averages, whatever noise it was whitened with.
struct Averaged {
    passages: Vec<(Passage, bool)>,
    /// Samples that were averaged: current, speed.
    counts: Vec<[f64; 2]>,
    /// Sums of the variances that their stamps give them.
    vague: Vec<[f64; 2]>,
    /// Block by block the currents, then the speeds, of all columns, the residual last; padded to whole lanes.
    values: Vec<f64>,
    /// Columns with their padding.
    width: usize,
}

/// Columns that stand for all: the motor's, and each candidate's likeliest form.
fn representatives(linear: &Linear, likeliest: &[usize]) -> Vec<usize> {
    let mut columns: Vec<usize> = (0..linear.nuisances.len()).collect();
    for (candidate, variant) in linear.candidates.iter().zip(likeliest) {
        columns.extend(candidate.variants[*variant].numbers());
    }
    columns
}

fn averaged(
    run: &LinearisedRun<'_>,
    whitened: &Whitened,
    present: &DVector<f64>,
    columns: &[usize],
) -> Averaged {
    let n = run.scenario.samples();
    let period_s = run.scenario.mean_period_s();
    let size = whole((BLOCK_S / period_s).floor()).max(1);
    let blocks = n.div_ceil(size);
    let (mut counts, mut vague) = (vec![[0.0; 2]; blocks], vec![[0.0; 2]; blocks]);
    for (sample, update) in run.follower.updates.iter().enumerate() {
        for (signal, gains) in [&update.current, &update.speed].into_iter().enumerate() {
            counts[sample / size][signal] += f64::from(u8::from(gains[4] > 0.0));
            vague[sample / size][signal] += run.followed.vague[sample][signal];
        }
    }
    let passages = (0..blocks)
        .map(|block| passage_of(run, block * size..((block + 1) * size).min(n), size))
        .collect();
    let mut residual = whitened * present;
    for (sum, white) in residual.iter_mut().zip(run.followed.white.iter().flatten()) {
        *sum += white;
    }
    let width = (columns.len() + 1).next_multiple_of(LANES);
    let mut values = vec![0.0; 2 * blocks * width];
    let groups: Vec<Vec<[Lane; 2]>> = (0..width / LANES)
        .into_par_iter()
        .map(|group| {
            let value = |column: usize, row: usize| match columns.get(column) {
                Some(number) => whitened.at(*number, row),
                None if column == columns.len() => residual[row],
                None => 0.0,
            };
            let mut sums = vec![[[0.0; LANES]; 2]; blocks];
            let mut track = Deviations::default();
            for (sample, (step, update)) in run.steps.iter().zip(&run.follower.updates).enumerate()
            {
                track.drift(step);
                let mut white = [[0.0; LANES]; 2];
                for lane in 0..LANES {
                    for (signal, white) in white.iter_mut().enumerate() {
                        white[lane] = value(group * LANES + lane, 2 * sample + signal);
                    }
                }
                let readings = track.colour(update, &white);
                let sums = sums[sample / size].iter_mut().flatten();
                for (sum, reading) in sums.zip(readings.iter().flatten()) {
                    *sum += reading;
                }
            }
            sums
        })
        .collect();
    for (group, sums) in groups.iter().enumerate() {
        for (block, (sum, count)) in sums.iter().zip(&counts).enumerate() {
            for signal in 0..2 {
                let from = (2 * block + signal) * width + group * LANES;
                for (value, sum) in values[from..from + LANES].iter_mut().zip(&sum[signal]) {
                    *value = sum / count[signal].max(1.0);
                }
            }
        }
    }
    Averaged {
        passages,
        counts,
        vague,
        values,
        width,
    }
}

/// The passage over all samples of a block of this size, and whether the speed becomes uncertain within.
fn passage_of(
    run: &LinearisedRun<'_>,
    samples: std::ops::Range<usize>,
    size: usize,
) -> (Passage, bool) {
    let mut kept = 1.0;
    let mut form = [0.0; 3];
    let mut interval_s = 0.0;
    let mut jumps = false;
    let mut direction = 0.0;
    let mut fresh = [0.0; 2];
    let mut unobserved = [0.0; 2];
    let mut together = 0.0;
    let mut begins_again = false;
    for sample in samples {
        let passage = &run.follower.passages[sample];
        kept *= passage.kept;
        for (sum, part) in form.iter_mut().zip(passage.form) {
            *sum += part / size as f64;
        }
        // What was not known before the model was taken over is no longer there.
        if passage.begins_again {
            begins_again = true;
            fresh = [0.0; 2];
            unobserved = [0.0; 2];
            together = 0.0;
        }
        together += passage.together;
        for (sum, part) in fresh.iter_mut().zip(passage.fresh) {
            *sum += part;
        }
        for (sum, part) in unobserved.iter_mut().zip(passage.unobserved) {
            *sum += part;
        }
        interval_s += passage.interval_s;
        let last = sample
            .checked_sub(1)
            .map(|last| run.followed.direction[last]);
        let turns = last.is_some_and(|last| passage.direction * last <= 0.0);
        jumps |= turns && passage.direction != 0.0;
        direction = passage.direction;
    }
    let (input_keeps, input_share) = run.dynamics.mean_input(interval_s, size as f64);
    let passage = Passage {
        unobserved,
        together,
        propagator: if begins_again {
            Propagator::default()
        } else {
            run.dynamics.over(interval_s, direction == 0.0)
        },
        fresh,
        begins_again,
        interval_s,
        direction,
        kept,
        form,
        input_keeps,
        input_share,
    };
    (passage, jumps)
}

impl Averaged {
    /// The normal matrix (residual last, then the padding) and the sum of the logarithms of the variances.
    fn filter(&self, run: &LinearisedRun<'_>, noise: &Noise) -> (DMatrix<f64>, f64) {
        let width = self.width;
        let jump = jump_of(run.scenario);
        let mut states = vec![Deviations::default(); width / LANES];
        let mut p: P = [[0.0; 4]; 4];
        p[2][2] = noise.disturbance_n_m.powi(2);
        p[3][3] = noise.input.powi(2);
        let mut log = 0.0;
        let mut sums = DMatrix::zeros(width, width);
        let mut buffer: Vec<f64> = Vec::with_capacity(2 * AT_ONCE * width);
        for (block, (passage, jumps)) in self.passages.iter().enumerate() {
            let forget = (-passage.interval_s / noise.correlation_s).exp();
            p = predicted(&p, passage, &run.dynamics, noise, forget);
            if *jumps {
                p[1][1] += jump;
            }
            if passage.direction == 0.0 {
                stop(&mut p);
            }
            let step = Step::of(passage, forget, &run.dynamics);
            for state in &mut states {
                state.drift(&step);
            }
            for (signal, count) in self.counts[block].into_iter().enumerate() {
                if count == 0.0 {
                    continue;
                }
                let sigma = [noise.current_a, noise.speed_rad_s][signal];
                let vague = self.vague[block][signal];
                let s = p[signal][signal] + (sigma * sigma + vague / count) / count;
                let gain = [0, 1, 2, 3].map(|row| p[row][signal] / s);
                p = corrected(&p, &gain, signal);
                log += s.ln();
                let gains = [gain[0], gain[1], gain[2], gain[3], 1.0 / s.sqrt()];
                let values = &self.values[(2 * block + signal) * width..][..width];
                for (state, values) in states.iter_mut().zip(values.chunks_exact(LANES)) {
                    buffer.extend(state.measure(signal, values, &gains));
                }
            }
            if buffer.len() >= 2 * AT_ONCE * width || block + 1 == self.passages.len() {
                let rows = buffer.len() / width;
                let side_by_side = DMatrixView::from_slice(&buffer, width, rows);
                add_upper(&mut sums, &turned(&buffer, width).as_view(), &side_by_side);
                buffer.clear();
            }
        }
        sums.fill_lower_triangle_with_upper_triangle();
        (sums, log)
    }
}

/// The noise that makes the runs likeliest, from `start` on; `floor` is what the sensors show at rest. What the runs do not
/// tell from what `start` has stays as it is.
pub(super) fn likeliest(
    runs: &[LinearisedRun<'_>],
    reduced: &Reduced,
    forms: &[usize],
    floor: &Noise,
    start: Noise,
) -> Noise {
    let linear = &reduced.linear;
    let columns = representatives(linear, forms);
    let course = Course::of(runs[0].scenario.input);
    let m = linear.nuisances.len();
    let data: Vec<Averaged> = runs
        .iter()
        .zip(&linear.columns)
        .map(|(run, w)| averaged(run, w, &linear.present, &columns))
        .collect();
    let k = columns.len();
    let log_likelihood = |noise: &Noise| -> f64 {
        let parts: Vec<(DMatrix<f64>, f64)> = runs
            .par_iter()
            .zip(&data)
            .map(|(run, data)| data.filter(run, noise))
            .collect();
        let zero = (DMatrix::zeros(data[0].width, data[0].width), 0.0);
        let (sums, log) = parts
            .into_iter()
            .fold(zero, |sum, part| (sum.0 + part.0, sum.1 + part.1));
        let mut a = sums.view((0, 0), (k, k)).into_owned();
        for (d, column) in columns.iter().enumerate() {
            a[(d, d)] += linear.precision(*column);
        }
        let mut b = sums.view((0, k), (k, 1)).column(0).into_owned();
        for (b, column) in b.iter_mut().zip(&columns) {
            if *column >= m {
                *b += reduced.prior[*column - m];
            }
        }
        let Some(factor) = a.cholesky() else {
            return f64::NEG_INFINITY;
        };
        let explained = b.dot(&factor.solve(&b));
        let det: f64 = factor.l().diagonal().iter().map(|d| d.ln()).sum();
        -0.5 * (sums[(k, k)] - explained) - det - 0.5 * log + log_prior(noise, floor, course)
    };
    let unknowns: Vec<Unknown> = UNKNOWNS
        .into_iter()
        .filter(|unknown| unknown.log(floor).is_finite())
        .collect();
    let found = climb(start, &unknowns, floor, course, &log_likelihood);
    // The error of form of what rings has a spectrum like a disturbance's: there each is taken as it is found.
    let mut candidates = linear.candidates.iter();
    if candidates.any(|own| own.in_model && own.is_whole()) {
        return found;
    }
    unless_told(found, start, log_likelihood)
}

/// Gain of another disturbance, or another error of the input, below which the runs do not tell it from the one before, nats.
const TOLD_NATS: f64 = 0.5;

/// What was found, with what it began with where that is as likely: a change that no run shows is none. A disturbance that
/// turns out to be less is taken at once, since what it no longer explains an effect may.
fn unless_told(found: Noise, start: Noise, log_likelihood: impl Fn(&Noise) -> f64) -> Noise {
    let best = log_likelihood(&found);
    let is_as_likely = |noise: &Noise| log_likelihood(noise) >= best - TOLD_NATS;
    let mut now = found;
    if found.disturbance_n_m > start.disturbance_n_m {
        let same = Noise {
            disturbance_n_m: start.disturbance_n_m,
            ..now
        };
        now = if is_as_likely(&same) { same } else { now };
    }
    let same = Noise {
        input: start.input,
        ..now
    };
    if is_as_likely(&same) { same } else { now }
}

/// How the correlation time is searched. Under a voltage, current and speed tell the spectrum above its corner, and the
/// climb follows what they leave open; under a torque the speed alone does, beside drags that look like a slow load: there
/// the time stays nearer to what is usual, and each unknown is climbed by itself.
#[derive(Clone, Copy, PartialEq)]
enum Course {
    Ridge,
    Axes,
}

impl Course {
    fn of(input: Input) -> Self {
        if input == Input::Voltage {
            Self::Ridge
        } else {
            Self::Axes
        }
    }

    /// How far the correlation time may be from half a second, as a logarithm.
    const fn correlation(self) -> f64 {
        match self {
            Self::Ridge => 1.2,
            Self::Axes => 0.8,
        }
    }
}

const USUAL_CORRELATION_S: f64 = 0.5;

fn log_prior(noise: &Noise, floor: &Noise, course: Course) -> f64 {
    let surprises = [
        (noise.current_a / floor.current_a).ln() / floor.sensors,
        (noise.speed_rad_s / floor.speed_rad_s).ln() / floor.sensors,
        (noise.correlation_s / USUAL_CORRELATION_S).ln() / course.correlation(),
    ];
    // A signal whose noise is not known is not looked at.
    let known = surprises.iter().filter(|surprise| surprise.is_finite());
    -0.5 * known.map(|surprise| surprise * surprise).sum::<f64>()
}

/// A logarithm that is searched.
#[derive(Clone, Copy, PartialEq)]
enum Unknown {
    Disturbance,
    Input,
    Correlation,
    Current,
    Speed,
}

const UNKNOWNS: [Unknown; 5] = [
    Unknown::Disturbance,
    Unknown::Input,
    Unknown::Correlation,
    Unknown::Current,
    Unknown::Speed,
];

impl Unknown {
    fn of(self, noise: &mut Noise) -> &mut f64 {
        match self {
            Self::Disturbance => &mut noise.disturbance_n_m,
            Self::Input => &mut noise.input,
            Self::Correlation => &mut noise.correlation_s,
            Self::Current => &mut noise.current_a,
            Self::Speed => &mut noise.speed_rad_s,
        }
    }

    fn log(self, noise: &Noise) -> f64 {
        self.of(&mut noise.clone()).ln()
    }

    /// The noise with this logarithm, as far as it may go. Another correlation time leaves the disturbance's spectrum as
    /// it is above the corner, where it is known best: its variance over that time stays, and the climb follows the ridge.
    fn set(self, noise: &Noise, floor: &Noise, course: Course, log: f64) -> Noise {
        let sensors = floor.sensors.exp();
        let (least, most) = match self {
            Self::Disturbance => (1e-6 * floor.disturbance_n_m, f64::MAX),
            Self::Input => (f64::min(1e-6, 0.01 * floor.input), f64::MAX),
            Self::Correlation => (0.02, 3.0),
            Self::Current => (floor.current_a / sensors, floor.current_a * sensors),
            Self::Speed => (floor.speed_rad_s / sensors, floor.speed_rad_s * sensors),
        };
        let mut next = *noise;
        *self.of(&mut next) = log.exp().clamp(least, most);
        if course == Course::Ridge {
            next.disturbance_n_m *= (next.correlation_s / noise.correlation_s).sqrt();
        }
        next
    }

    /// First step: of sensors as well as they are known, the rest hardly is.
    const fn step(self, floor: &Noise) -> f64 {
        match self {
            Self::Current | Self::Speed => 0.5 * floor.sensors,
            _ => 0.8,
        }
    }
}

/// Gain below which a step is not worth its filter run, and that of a round below which no other is made, nats.
const LEAST_GAIN_NATS: f64 = 0.05;
const LEAST_ROUND_NATS: f64 = 0.5;
const MOST_ROUNDS: usize = 6;

/// Climbs one unknown after the other: outwards while it rises, then to the top of the parabola through the last three.
fn climb(
    start: Noise,
    unknowns: &[Unknown],
    floor: &Noise,
    course: Course,
    log_likelihood: &impl Fn(&Noise) -> f64,
) -> Noise {
    let mut now = start;
    let mut best = log_likelihood(&now);
    for _ in 0..MOST_ROUNDS {
        let before = best;
        for unknown in unknowns {
            // Known points of this line: logarithm and likelihood.
            let mut known = vec![(unknown.log(&now), best)];
            for sign in [1.0, -1.0] {
                let mut stride = sign * unknown.step(floor);
                loop {
                    let next = unknown.set(&now, floor, course, unknown.log(&now) + stride);
                    if next == now {
                        break;
                    }
                    let log = log_likelihood(&next);
                    known.push((unknown.log(&next), log));
                    if log <= best + LEAST_GAIN_NATS {
                        break;
                    }
                    (best, now) = (log, next);
                    stride *= 1.6;
                }
                // Who rises on one side comes from lower on the other.
                if known.len() > 2 {
                    break;
                }
            }
            if let Some((log, gain)) = top(&mut known)
                && gain > LEAST_GAIN_NATS
            {
                let next = unknown.set(&now, floor, course, log);
                let log = log_likelihood(&next);
                if log > best {
                    (best, now) = (log, next);
                }
            }
        }
        if best - before < LEAST_ROUND_NATS {
            break;
        }
    }
    now
}

/// The top of the parabola through the best of the points and its neighbours, and how far it is above.
fn top(known: &mut [(f64, f64)]) -> Option<(f64, f64)> {
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let at = (0..known.len()).max_by(|a, b| known[*a].1.total_cmp(&known[*b].1))?;
    let (left, middle, right) = (
        known.get(at.checked_sub(1)?)?,
        known[at],
        known.get(at + 1)?,
    );
    let (back, ahead) = (middle.0 - left.0, right.0 - middle.0);
    let (fall, rise) = ((middle.1 - left.1) / back, (right.1 - middle.1) / ahead);
    let bend = (fall - rise) / (back + ahead);
    let slope = (fall * ahead + rise * back) / (back + ahead);
    (bend > 0.0 && bend.is_finite())
        .then(|| (middle.0 + 0.5 * slope / bend, 0.25 * slope * slope / bend))
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::joint::follow::{DISTURBED, QUIET, hole};
    use crate::kit::nameplate;
    use drivebench_model::plant::State;
    use drivebench_model::plant::testing::record;

    #[test]
    fn the_climb_follows_the_ridge_of_a_spectrum_that_is_known_above_its_corner_only() {
        let floor = Noise {
            input: 0.0,
            ..DISTURBED
        };
        let likelihood = |noise: &Noise| {
            let corner = (noise.correlation_s / 0.05).ln();
            let above = (noise.disturbance_n_m.powi(2) / noise.correlation_s / 6e-3).ln();
            -500.0 * above * above - 8.0 * corner * corner
        };
        let unknowns = [Unknown::Disturbance, Unknown::Correlation];
        let found = climb(floor, &unknowns, &floor, Course::Ridge, &likelihood);
        assert!(likelihood(&found) > -0.5, "{found:?}");
    }

    #[test]
    fn the_climb_reaches_the_top_in_few_runs_of_the_filter() {
        let floor = Noise {
            input: 0.01,
            ..DISTURBED
        };
        let count = Cell::new(0);
        let likelihood = |noise: &Noise| {
            count.set(count.get() + 1);
            let [d, t, v] = [
                noise.disturbance_n_m / 3e-4,
                noise.correlation_s / 0.2,
                noise.input / 0.05,
            ]
            .map(f64::ln);
            let above = d - 0.5 * t;
            -6.0 * above * above
                - 2.0 * above * t
                - 2.0 * t * t
                - 5.0 * v * v
                - ((noise.current_a / 0.031).ln() / 0.01).powi(2)
        };
        let found = climb(floor, &UNKNOWNS, &floor, Course::Ridge, &likelihood);
        assert!(likelihood(&found) > -0.5, "{found:?}");
        assert!(count.get() < 60, "{}", count.get());
        // Nothing to gain: one look to either side of each.
        count.set(0);
        climb(found, &UNKNOWNS, &floor, Course::Ridge, &likelihood);
        assert!(count.get() < 16, "{}", count.get());
    }

    #[test]
    fn more_of_a_disturbance_and_another_error_of_the_input_count_only_where_they_are_told() {
        let start = Noise {
            disturbance_n_m: 2e-5,
            input: 0.01,
            ..QUIET
        };
        let found = |disturbance_n_m| Noise {
            disturbance_n_m,
            input: 0.001,
            ..QUIET
        };
        // Nats lost by another disturbance, and by another input, than the one that was found.
        let left = |disturbance_n_m: f64, loses: [f64; 2]| {
            let top = found(disturbance_n_m);
            let likelihood = |noise: &Noise| {
                let is_other = |a: f64, b: f64| f64::from(u8::from(a.to_bits() != b.to_bits()));
                -loses[0] * is_other(noise.disturbance_n_m, top.disturbance_n_m)
                    - loses[1] * is_other(noise.input, top.input)
            };
            let left = unless_told(top, start, likelihood);
            [left.disturbance_n_m, left.input].map(f64::to_bits)
        };
        let of = |noise: Noise| [noise.disturbance_n_m, noise.input].map(f64::to_bits);
        let of_input = Noise {
            input: 0.01,
            ..found(4e-5)
        };
        for (disturbance_n_m, loses, expected) in [
            (4e-5, [0.1, 0.1], start),
            (4e-5, [2.0, 2.0], found(4e-5)),
            (4e-5, [2.0, 0.1], of_input),
            // Less of it is taken at once.
            (1e-5, [0.1, 2.0], found(1e-5)),
        ] {
            assert_eq!(left(disturbance_n_m, loses), of(expected), "{loses:?}");
        }
    }

    #[test]
    fn a_block_knows_that_one_voltage_moves_current_and_speed() {
        let model = nameplate();
        let mut scenario = record(&model, vec![(0.0, 20.0), (0.5, 25.0)], 1e-3, 1.0, 3);
        scenario.unknown_input = vec![hole(0.7, 0.71, 9.0)];
        let run = LinearisedRun::new(&model, &scenario, State::default(), QUIET).unwrap();
        let n = scenario.samples();
        let block = passage_of(&run, 0..n, n).0;
        let each = run.follower.passages.iter();
        for signal in 0..2 {
            let sum: f64 = each.clone().map(|passage| passage.unobserved[signal]).sum();
            assert!(sum > 0.0 && (block.unobserved[signal] / sum - 1.0).abs() < 1e-12);
            assert!(block.fresh[signal] >= block.unobserved[signal]);
        }
    }
}

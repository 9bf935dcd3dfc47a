//! Noise parameters by maximum marginal likelihood (empirical Bayes) with every effect included at slab width: likelihood of the
//! innovations of a Kalman filter (Schweppe, IEEE Trans. Information Theory 11, 1965) over block averages, maximised by cyclic
//! coordinate search with quadratic interpolation.

use nalgebra::{DMatrix, DMatrixView, DVector};
use rayon::prelude::*;

use super::kalman::{
    Noise, Transition, fix_speed, predicted_covariance, reversal_variance, stationary,
    updated_covariance,
};
use super::process_noise::constants;
use super::regression::half_log_det;
use super::run::LinearisedRun;
use super::select::Reduced;
use super::tangent::{Deviations, LANES, Lane, Step};
use super::whitened::{Whitened, add_upper, turned};
use drivebench_identify::noise::{FloorSource, NoiseFloor, noise_in_motion, rounding};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{Input, Model, RunScales, Scenario};

/// Starting values: known sensor noise, a disturbance of 0.004 of the largest torque.
pub(super) fn initial_noise(floor: &NoiseFloor, model: &Model, run: &Scenario) -> Noise {
    let largest_input = largest(run.events.iter().map(|event| event.1));
    let current = match run.input {
        Input::Voltage => largest(&run.current_a),
        _ => largest_input,
    };
    let torque = constants(model, run).torque_n_m_per_a * current;
    let mut noise = Noise {
        current_a: floor.current_a,
        speed_rad_s: floor.speed_rad_s,
        disturbance_n_m: (0.004 * torque).max(f64::MIN_POSITIVE),
        correlation_s: usual_correlation_s(&run.scales),
        input: (1e-4 * largest_input).max(f64::MIN_POSITIVE),
        // What they show at rest.
        sensors: 0.1,
        stamps: 1.0,
        rounding: [&run.current_a, &run.speed_rad_s].map(|values| rounding(values)),
    };
    if run.input != Input::Voltage {
        noise.current_a = f64::INFINITY;
        // White noise first: from a start without it the search ends at a large disturbance.
        let torques: Vec<f64> = run.events.iter().map(|event| event.1).collect();
        let white = constants(model, run).torque_n_m_per_a * noise_in_motion(&torques);
        noise.input = white.max(1e-3 * torque).max(f64::MIN_POSITIVE);
        // In a run without a voltage the noise in motion may differ from that at rest.
        noise.sensors = 2.0;
        if floor.source == FloorSource::None {
            noise.speed_rad_s = noise_in_motion(&run.speed_rad_s).max(f64::MIN_POSITIVE);
        }
    }
    noise
}

/// Block averages of one run, unwhitened, so that any noise parameters can be tried.
struct BlockAverages {
    transitions: Vec<(Transition, bool)>,
    /// Samples in each block: current, speed.
    counts: Vec<[f64; 2]>,
    /// Sums of the variances by errors of the time stamps.
    stamp_variance: Vec<[f64; 2]>,
    /// The same by rounding.
    rounding_variance: Vec<[f64; 2]>,
    /// Block by block the currents, then the speeds, of all columns, the residual last; padded to whole lanes.
    values: Vec<f64>,
    /// Columns with their padding.
    width: usize,
}

fn block_averages(
    run: &LinearisedRun<'_>,
    whitened: &Whitened,
    present: &DVector<f64>,
    columns: &[usize],
) -> BlockAverages {
    let n = run.scenario.samples();
    // Averages over 0.15 times of response: the disturbance is slower.
    let block_s = run.scenario.scales.responses(0.15);
    let size = whole((block_s / run.scenario.mean_period_s()).floor()).max(1);
    let blocks = n.div_ceil(size);
    let (mut counts, mut stamp_variance) = (vec![[0.0; 2]; blocks], vec![[0.0; 2]; blocks]);
    let mut rounding_variance = vec![[0.0; 2]; blocks];
    for (sample, update) in run.gains.updates.iter().enumerate() {
        for (signal, gains) in [&update.current, &update.speed].into_iter().enumerate() {
            counts[sample / size][signal] += f64::from(u8::from(gains[4] > 0.0));
            stamp_variance[sample / size][signal] += run.filtered.stamp_variance[sample][signal];
            let rounding = &run.filtered.rounding_variance[signal];
            rounding_variance[sample / size][signal] += rounding.get(sample).unwrap_or(&0.0);
        }
    }
    let transitions = (0..blocks)
        .map(|block| transition_of(run, block * size..((block + 1) * size).min(n), size))
        .collect();
    let mut residual = whitened * present;
    for (sum, white) in residual.iter_mut().zip(run.filtered.white.iter().flatten()) {
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
            for (sample, (step, update)) in run.steps.iter().zip(&run.gains.updates).enumerate() {
                track.advance_unforced(step);
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
    BlockAverages { transitions, counts, stamp_variance, rounding_variance, values, width }
}

/// The passage over all samples of a block of this size, and whether the speed becomes uncertain within.
fn transition_of(
    run: &LinearisedRun<'_>,
    samples: std::ops::Range<usize>,
    size: usize,
) -> (Transition, bool) {
    let mut block = Transition { speed_factor: 1.0, ..Transition::default() };
    let mut jumps = false;
    for sample in samples {
        let transition = &run.gains.transitions[sample];
        block.speed_factor *= transition.speed_factor;
        for (sum, part) in block.form.iter_mut().zip(transition.form) {
            *sum += part / size as f64;
        }
        // A reset to the measurement replaces all earlier variance.
        if transition.restarts {
            block.restarts = true;
            (block.added_variance, block.unobserved, block.covariance) = ([0.0; 2], [0.0; 2], 0.0);
            block.edges = [0.0; 2];
        }
        block.covariance += transition.covariance;
        for signal in 0..2 {
            block.added_variance[signal] += transition.added_variance[signal];
            block.unobserved[signal] += transition.unobserved[signal];
            block.edges[signal] += transition.edges[signal];
        }
        block.interval_s += transition.interval_s;
        let last = sample.checked_sub(1).map(|last| run.filtered.direction[last]);
        let turns = last.is_some_and(|last| transition.direction * last <= 0.0);
        jumps |= turns && transition.direction != 0.0;
        // Rows of a balance that are not used do not end a block.
        if run.dynamics.balanced_kg_m2.is_none() {
            block.direction = transition.direction;
        } else if transition.direction != 0.0 {
            (block.direction, jumps) = (transition.direction, false);
        }
    }
    let mean_input = run.dynamics.mean_input(block.interval_s, size as f64);
    (block.input_keeps, block.input_share) = mean_input;
    if !block.restarts {
        block.propagator = run.dynamics.over(block.interval_s, block.direction == 0.0);
    }
    (block, jumps)
}

impl BlockAverages {
    /// The normal matrix (residual last, then the padding) and the sum of the logarithms of the variances.
    fn filter(&self, run: &LinearisedRun<'_>, noise: &Noise) -> (DMatrix<f64>, f64) {
        let width = self.width;
        let jump = reversal_variance(run.scenario);
        let mut states = vec![Deviations::default(); width / LANES];
        let mut p = stationary(noise);
        let mut log = 0.0;
        let mut sums = DMatrix::zeros(width, width);
        // Innovations of 128 blocks are multiplied at once.
        let mut buffer: Vec<f64> = Vec::with_capacity(256 * width);
        for (block, (transition, jumps)) in self.transitions.iter().enumerate() {
            let decay = (-transition.interval_s / noise.correlation_s).exp();
            p = predicted_covariance(&p, transition, &run.dynamics, noise, decay);
            if *jumps {
                p[1][1] += jump;
            }
            if transition.direction == 0.0 {
                fix_speed(&mut p);
            }
            let step = Step::of(transition, decay, &run.dynamics);
            for state in &mut states {
                state.advance_unforced(&step);
            }
            for (signal, count) in self.counts[block].into_iter().enumerate() {
                if count == 0.0 {
                    continue;
                }
                let sigma = run.dynamics.measurement_noise(noise)[signal];
                let stamp_variance = noise.stamps.powi(2) * self.stamp_variance[block][signal];
                let variance = stamp_variance + self.rounding_variance[block][signal];
                let s = p[signal][signal] + (sigma * sigma + variance / count) / count;
                let gain = [0, 1, 2, 3].map(|row| p[row][signal] / s);
                p = updated_covariance(&p, &gain, signal);
                log += s.ln();
                let gains = [gain[0], gain[1], gain[2], gain[3], 1.0 / s.sqrt()];
                let values = &self.values[(2 * block + signal) * width..][..width];
                for (state, values) in states.iter_mut().zip(values.chunks_exact(LANES)) {
                    buffer.extend(state.innovation(signal, values, &gains));
                }
            }
            if buffer.len() >= 256 * width || block + 1 == self.transitions.len() {
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

/// The noise of maximum marginal likelihood, searched from `start`; `floor`: noise at rest. Effects are included in these `forms`.
/// Parameters that the runs do not determine stay as in `start`.
pub(super) fn maximum_likelihood(
    runs: &[LinearisedRun<'_>],
    reduced: &Reduced,
    forms: &[usize],
    floor: &Noise,
    start: Noise,
) -> Noise {
    let linear = &reduced.linear;
    let m = linear.nuisances.len();
    let candidates = linear.candidates.iter().zip(forms);
    let representatives = candidates.flat_map(|(own, form)| own.variants[*form].numbers());
    let columns: Vec<usize> = (0..m).chain(representatives).collect();
    let by_voltage = runs[0].scenario.input == Input::Voltage;
    let data: Vec<BlockAverages> = runs
        .iter()
        .zip(&linear.columns)
        .map(|(run, w)| block_averages(run, w, &linear.present, &columns))
        .collect();
    let k = columns.len();
    let log_likelihood = |noise: &Noise| -> f64 {
        let parts: Vec<(DMatrix<f64>, f64)> =
            runs.par_iter().zip(&data).map(|(run, data)| data.filter(run, noise)).collect();
        let zero = (DMatrix::zeros(data[0].width, data[0].width), 0.0);
        let (sums, log) =
            parts.into_iter().fold(zero, |sum, part| (sum.0 + part.0, sum.1 + part.1));
        let mut a = sums.view((0, 0), (k, k)).into_owned();
        let mut b = sums.view((0, k), (k, 1)).column(0).into_owned();
        for (d, column) in columns.iter().enumerate() {
            a[(d, d)] += linear.precision(*column);
            if *column >= m {
                b[d] += reduced.prior[*column - m];
            }
        }
        let Some(factor) = a.cholesky() else {
            return f64::NEG_INFINITY;
        };
        let explained = b.dot(&factor.solve(&b));
        let det = half_log_det(&factor);
        -0.5 * (sums[(k, k)] - explained) - det - 0.5 * log + log_prior(noise, floor, by_voltage)
    };
    let mut unknowns = NOISE_PARAMETERS.to_vec();
    unknowns.retain(|unknown| unknown.log(floor).is_finite());
    if runs.iter().all(|run| run.scenario.typical_half_width_s().is_none()) {
        unknowns.retain(|unknown| *unknown != NoiseParameter::Stamps);
    }
    let found = coordinate_search(start, &unknowns, floor, by_voltage, &log_likelihood);
    // With a coupling in the model the error of its form has the spectrum of a disturbance: no test of significance.
    let mut candidates = linear.candidates.iter();
    if candidates.any(|own| own.in_model && own.has_fixed_size()) {
        return found;
    }
    where_significant(found, start, log_likelihood)
}

/// The estimate, each parameter set back to its starting value where that costs less than half a nat: no significant change. A
/// smaller disturbance is always taken, because effects may explain the rest.
fn where_significant(found: Noise, start: Noise, log_likelihood: impl Fn(&Noise) -> f64) -> Noise {
    let best = log_likelihood(&found);
    let unless_as_likely = |now: Noise, same: Noise| {
        if log_likelihood(&same) >= best - 0.5 { same } else { now }
    };
    let mut now = found;
    if found.disturbance_n_m > start.disturbance_n_m {
        let disturbance_n_m = start.disturbance_n_m;
        now = unless_as_likely(now, Noise { disturbance_n_m, ..now });
    }
    let input = start.input;
    unless_as_likely(now, Noise { input, ..now })
}

/// Prior median of the correlation time of a disturbance: twelve times of response, and short against the run.
fn usual_correlation_s(scales: &RunScales) -> f64 {
    scales.responses(12.5).min(scales.length_s / 16.0)
}

fn log_prior(noise: &Noise, floor: &Noise, by_voltage: bool) -> f64 {
    let surprises = [
        (noise.current_a / floor.current_a).ln() / floor.sensors,
        (noise.speed_rad_s / floor.speed_rad_s).ln() / floor.sensors,
        // With a torque input the speed alone determines it, and a drag looks like a slow load: a narrower prior.
        (noise.correlation_s / floor.correlation_s).ln() / if by_voltage { 1.2 } else { 0.8 },
    ];
    // A signal of unknown noise (infinite) is not used.
    let known = surprises.iter().filter(|surprise| surprise.is_finite());
    -0.5 * known.map(|surprise| surprise * surprise).sum::<f64>()
}

/// A noise parameter, searched as its logarithm.
#[derive(Clone, Copy, PartialEq)]
enum NoiseParameter {
    Disturbance,
    Input,
    Correlation,
    Current,
    Speed,
    Stamps,
}

const NOISE_PARAMETERS: [NoiseParameter; 6] = [
    NoiseParameter::Disturbance,
    NoiseParameter::Input,
    NoiseParameter::Correlation,
    NoiseParameter::Current,
    NoiseParameter::Speed,
    NoiseParameter::Stamps,
];

impl NoiseParameter {
    fn of(self, noise: &mut Noise) -> &mut f64 {
        match self {
            Self::Disturbance => &mut noise.disturbance_n_m,
            Self::Input => &mut noise.input,
            Self::Correlation => &mut noise.correlation_s,
            Self::Current => &mut noise.current_a,
            Self::Speed => &mut noise.speed_rad_s,
            Self::Stamps => &mut noise.stamps,
        }
    }

    fn log(self, noise: &Noise) -> f64 {
        self.of(&mut noise.clone()).ln()
    }

    /// The noise with this logarithm, within bounds. With a voltage input the spectrum of the disturbance above its corner is well
    /// determined: a new correlation time keeps variance over correlation time, so that the search follows the ridge.
    fn set(self, noise: &Noise, floor: &Noise, by_voltage: bool, log: f64) -> Noise {
        let sensors = floor.sensors.exp();
        let (least, most) = match self {
            Self::Disturbance => (1e-6 * floor.disturbance_n_m, f64::MAX),
            Self::Input => (1e-4 * floor.input, f64::MAX),
            Self::Correlation => (0.04 * floor.correlation_s, 6.0 * floor.correlation_s),
            Self::Current => (floor.current_a / sensors, floor.current_a * sensors),
            Self::Speed => (floor.speed_rad_s / sensors, floor.speed_rad_s * sensors),
            // A smaller random error of stamps is not distinguished from the noise of the sensors.
            Self::Stamps => (0.03, 1.0),
        };
        let mut next = *noise;
        *self.of(&mut next) = log.exp().clamp(least, most);
        if by_voltage {
            next.disturbance_n_m *= (next.correlation_s / noise.correlation_s).sqrt();
        }
        next
    }
}

/// Cyclic coordinate search: along each parameter outwards while the likelihood rises, then to the maximum of the parabola through
/// three points.
fn coordinate_search(
    start: Noise,
    unknowns: &[NoiseParameter],
    floor: &Noise,
    by_voltage: bool,
    log_likelihood: &impl Fn(&Noise) -> f64,
) -> Noise {
    // Smaller gains end the search along a line.
    let least_gain_nats = 0.05;
    let mut now = start;
    let mut best = log_likelihood(&now);
    // Six rounds at most, and no other behind one that gains less than half a nat.
    for _ in 0..6 {
        let before = best;
        for unknown in unknowns {
            // Evaluated points of this line: logarithm and likelihood.
            let mut known = vec![(unknown.log(&now), best)];
            for sign in [1.0, -1.0] {
                let mut stride = sign
                    * match unknown {
                        NoiseParameter::Current | NoiseParameter::Speed => 0.5 * floor.sensors,
                        _ => 0.8,
                    };
                loop {
                    let next = unknown.set(&now, floor, by_voltage, unknown.log(&now) + stride);
                    if next == now {
                        break;
                    }
                    let log = log_likelihood(&next);
                    known.push((unknown.log(&next), log));
                    if log <= best + least_gain_nats {
                        break;
                    }
                    (best, now) = (log, next);
                    stride *= 1.6;
                }
                // A rise on one side is a fall on the other.
                if known.len() > 2 {
                    break;
                }
            }
            if let Some((log, gain)) = parabola_maximum(&mut known)
                && gain > least_gain_nats
            {
                let next = unknown.set(&now, floor, by_voltage, log);
                let log = log_likelihood(&next);
                if log > best {
                    (best, now) = (log, next);
                }
            }
        }
        if best - before < 0.5 {
            break;
        }
    }
    now
}

/// Maximum of the parabola through the best point and its neighbours, and its height above that point.
fn parabola_maximum(known: &mut [(f64, f64)]) -> Option<(f64, f64)> {
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let at = (0..known.len()).max_by(|a, b| known[*a].1.total_cmp(&known[*b].1))?;
    let (left, middle) = (known.get(at.checked_sub(1)?)?, known[at]);
    let right = known.get(at + 1)?;
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
    use crate::joint::columns::linearise;
    use crate::joint::events::Hypothesis;
    use crate::joint::kalman::{DISTURBED, QUIET, hole};
    use crate::kit::nameplate;
    use drivebench_model::plant::State;
    use drivebench_model::plant::testing::record;

    #[test]
    fn the_search_follows_the_ridge_of_a_spectrum() {
        let floor = Noise { input: 0.0, ..DISTURBED };
        let likelihood = |noise: &Noise| {
            let corner = (noise.correlation_s / 0.05).ln();
            let above = (noise.disturbance_n_m.powi(2) / noise.correlation_s / 6e-3).ln();
            -500.0 * above * above - 8.0 * corner * corner
        };
        let unknowns = [NoiseParameter::Disturbance, NoiseParameter::Correlation];
        let found = coordinate_search(floor, &unknowns, &floor, true, &likelihood);
        assert!(likelihood(&found) > -0.5, "{found:?}");
    }

    #[test]
    fn the_search_reaches_the_maximum_in_few_runs_of_the_filter() {
        let floor = Noise { input: 0.01, ..DISTURBED };
        let count = Cell::new(0);
        let likelihood = |noise: &Noise| {
            count.set(count.get() + 1);
            let d = (noise.disturbance_n_m / 3e-4).ln();
            let (t, v) = ((noise.correlation_s / 0.2).ln(), (noise.input / 0.05).ln());
            let current = (noise.current_a / 0.031).ln() / 0.01;
            let above = d - 0.5 * t;
            let quadratic = 6.0 * above * above + 2.0 * above * t + 2.0 * t * t + 5.0 * v * v;
            -quadratic - current.powi(2)
        };
        let found = coordinate_search(floor, &NOISE_PARAMETERS, &floor, true, &likelihood);
        assert!(likelihood(&found) > -0.5, "{found:?}");
        assert!(count.get() < 60, "{}", count.get());
        // Nothing to gain: one look to either side of each.
        count.set(0);
        coordinate_search(found, &NOISE_PARAMETERS, &floor, true, &likelihood);
        assert!(count.get() < 16, "{}", count.get());
    }

    #[test]
    fn stamps_err_less_than_their_half_widths_allow_where_a_line_delays_alike() {
        let model = nameplate();
        let events = vec![(0.0, 20.0), (0.4, 60.0), (0.8, 30.0), (1.2, 70.0), (1.6, 20.0)];
        let mut scenario = record(&model, events, 1e-2, 2.0, 3);
        scenario.time_half_width_s = vec![2e-3; scenario.samples()];
        let noise = Noise { input: 1e-3, disturbance_n_m: 1e-4, ..QUIET };
        let runs = [LinearisedRun::new(&model, &scenario, State::default(), noise).unwrap()];
        let linear = linearise(&Hypothesis::of(&model), &[], &runs, false).unwrap();
        let reduced = Reduced::new(linear, 1.0, true).unwrap();
        let found = maximum_likelihood(&runs, &reduced, &[], &noise, noise);
        assert!(found.stamps < 0.3, "{found:?}");
        // Stamps of the drive have no such error.
        scenario.time_half_width_s.clear();
        let runs = [LinearisedRun::new(&model, &scenario, State::default(), noise).unwrap()];
        let found = maximum_likelihood(&runs, &reduced, &[], &noise, noise);
        assert_eq!(found.stamps.to_bits(), noise.stamps.to_bits());
    }

    #[test]
    fn more_disturbance_and_another_input_need_a_gain() {
        let (start, more, less) = ([2e-5, 0.01], 4e-5, 1e-5);
        let noise = |disturbance_n_m, input| Noise { disturbance_n_m, input, ..QUIET };
        // Nats lost by another disturbance, and by another input, than the one that was found.
        for (disturbance_n_m, loses, expected) in [
            (more, [0.1, 0.1], start),
            (more, [2.0, 2.0], [more, 0.001]),
            (more, [2.0, 0.1], [more, start[1]]),
            // Less of it is taken at once.
            (less, [0.1, 2.0], [less, 0.001]),
        ] {
            let likelihood = |noise: &Noise| {
                let is_other = |a: f64, b: f64| f64::from(u8::from(a.to_bits() != b.to_bits()));
                -loses[0] * is_other(noise.disturbance_n_m, disturbance_n_m)
                    - loses[1] * is_other(noise.input, 0.001)
            };
            let found = noise(disturbance_n_m, 0.001);
            let left = where_significant(found, noise(start[0], start[1]), likelihood);
            assert_eq!(left, noise(expected[0], expected[1]), "{loses:?}");
        }
    }

    #[test]
    fn a_block_sums_what_one_voltage_makes_of_both_signals() {
        let model = nameplate();
        let mut scenario = record(&model, vec![(0.0, 20.0), (0.5, 25.0)], 1e-3, 1.0, 3);
        scenario.unknown_input = vec![hole(0.7, 0.71, 9.0)];
        let run = LinearisedRun::new(&model, &scenario, State::default(), QUIET).unwrap();
        let n = scenario.samples();
        let block = transition_of(&run, 0..n, n).0;
        for signal in 0..2 {
            let each = run.gains.transitions.iter();
            let sum: f64 = each.map(|transition| transition.unobserved[signal]).sum();
            assert!(sum > 0.0 && (block.unobserved[signal] / sum - 1.0).abs() < 1e-12);
            assert!(block.added_variance[signal] >= block.unobserved[signal]);
        }
    }
}

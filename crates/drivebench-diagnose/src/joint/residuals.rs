//! Residuals of a set at its linear solution: their excess over white noise, by the long-run variance and by the cluster-robust
//! sandwich estimator (Liang & Zeger, Biometrika 73, 1986), and the share of unknown functions.

use nalgebra::DVector;

use super::free_run::excess;
use super::regression::Linear;
use super::run::LinearisedRun;
use super::select::{Reduced, Set};
use super::tangent::{Deviations, Lane};
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::Input;

/// Posterior mean of a set in all columns, the nuisance parameters first.
fn solution(reduced: &Reduced, set: &Set) -> Option<DVector<f64>> {
    let linear = &reduced.linear;
    let m = linear.nuisances.len();
    let estimate = reduced.estimate(set)?;
    let mut solution = DVector::zeros(linear.gram.nrows());
    for (column, mean) in estimate.columns.iter().zip(estimate.mean.iter()) {
        solution[*column] = *mean;
    }
    let explained = &linear.gram * &solution;
    let right = linear.right.rows(0, m) - explained.rows(0, m);
    let nuisances = linear.factor(&(0..m).collect::<Vec<_>>())?.solve(&right);
    solution.rows_mut(0, m).copy_from(&nuisances);
    Some(solution)
}

/// Outputs of columns of standardised innovations, the inverse of whitening: per sample current and speed of each column, in
/// standard deviations of the sensors.
fn coloured<const N: usize>(
    run: &LinearisedRun<'_>,
    white: impl Fn(usize) -> [[f64; 2]; N],
) -> impl Iterator<Item = [[f64; N]; 2]> {
    let mut track = Deviations::default();
    (0..run.scenario.samples()).map(move |sample| {
        track.advance_unforced(&run.steps[sample]);
        let columns = white(sample);
        let mut lanes = [Lane::default(); 2];
        for (signal, lane) in lanes.iter_mut().enumerate() {
            lane[..N].copy_from_slice(&columns.map(|column| column[signal]));
        }
        let [current, speed] = track.colour(&run.gains.updates[sample], &lanes);
        let [current_sd, second_sd] = run.dynamics.measurement_noise(&run.noise);
        let over = |lane: Lane, sd: f64| std::array::from_fn(|k| lane[k] / sd);
        [over(current, current_sd), over(speed, second_sd)]
    })
}

/// Share of the squared output error that each unknown function of a set explains: alone, or beyond what the rest of the set
/// explains without it. A memory alone explains nothing of a torque that also has a part without memory.
pub(super) fn unknown_shares(
    reduced: &Reduced,
    set: &Set,
    runs: &[LinearisedRun<'_>],
) -> Option<Vec<f64>> {
    let linear = &reduced.linear;
    let all = solution(reduced, set)?;
    let share = |variant: usize, candidate: usize| {
        let mut rest_of_set = set.clone();
        rest_of_set[candidate] = None;
        let rest = solution(reduced, &rest_of_set)?;
        let (mut squares, mut floor) = ([0.0; 4], 0.0);
        for (run, columns) in runs.iter().zip(&linear.columns) {
            let mut own = DVector::zeros(all.len());
            for column in linear.candidates[candidate].variants[variant].numbers() {
                own[column] = all[column];
            }
            let shift = columns * &linear.present;
            let taken = [&own, &rest, &all].map(|sizes| columns * sizes);
            let left = coloured(run, |sample| {
                let white = run.filtered.white[sample];
                let whole = [0, 1].map(|signal| white[signal] + shift[2 * sample + signal]);
                let [own, rest, all] = [0, 1, 2].map(|of: usize| {
                    [0, 1].map(|signal| whole[signal] - taken[of][2 * sample + signal])
                });
                [whole, own, rest, all]
            });
            for left in left.flatten() {
                for (sum, left) in squares.iter_mut().zip(left) {
                    *sum += left * left;
                }
            }
            floor += run.gains.rows as f64;
        }
        let [before, own, rest, all] = squares;
        let taken = (before - own).max(rest - all) / (before - floor);
        Some(if before > floor { taken.clamp(0.0, 1.0) } else { 0.0 })
    };
    let candidates = linear.candidates.iter().zip(set).enumerate();
    let shares = candidates.map(|(k, (candidate, chosen))| match chosen {
        Some(variant) if candidate.is_unknown() => share(*variant, k),
        _ => Some(0.0),
    });
    shares.collect()
}

/// Ratio of the variance of an effect's size by the scatter between 20 blocks of the runs to that by white noise, for the worst
/// of the set (cluster-robust variance: Liang and Zeger, Biometrika 73, 1986): what a torque leaves of a real machine is the same
/// over a whole motion.
fn cluster_robust_ratio(
    linear: &Linear,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    explained: &[DVector<f64>],
) -> f64 {
    let m = linear.nuisances.len();
    let (mut all, mut named): (Vec<usize>, Vec<usize>) = ((0..m).collect(), Vec::new());
    for (candidate, form) in linear.candidates.iter().zip(set) {
        let Some(form) = form else { continue };
        let variant = &candidate.variants[*form];
        all.extend(variant.numbers());
        let sizes = variant.columns.iter().filter(|own| own.unit > 0.0);
        named.extend(sizes.filter(|_| !candidate.is_unknown()).map(|own| own.at));
    }
    let samples: usize = runs.iter().map(|run| run.scenario.samples()).sum();
    let length = whole((samples as f64 / 20.0).ceil()).max(1);
    let mut worst: f64 = 1.0;
    for own in &named {
        let others: Vec<usize> = all.iter().copied().filter(|k| k != own).collect();
        let cross = DVector::from_fn(others.len(), |r, _| linear.gram[(others[r], *own)]);
        let Some(factor) = linear.factor(&others) else {
            continue;
        };
        let mut weights = DVector::zeros(linear.gram.nrows());
        weights[*own] = 1.0;
        for (column, share) in others.iter().zip(factor.solve(&cross).iter()) {
            weights[*column] = -share;
        }
        let (mut scatter, mut expected) = (0.0, 0.0);
        for ((run, columns), explained) in runs.iter().zip(&linear.columns).zip(explained) {
            let column = columns * &weights;
            let rows = run.filtered.white.iter().flatten().enumerate();
            let products: Vec<f64> =
                rows.map(|(row, white)| column[row] * (white - explained[row])).collect();
            let blocks = products.chunks(2 * length);
            let sums = blocks.map(|block| block.iter().sum::<f64>());
            scatter += sums.map(|sum| sum * sum).sum::<f64>();
            expected += column.norm_squared();
        }
        if expected > 0.0 {
            worst = worst.max(scatter / expected);
        }
    }
    worst
}

/// Excess of the residuals of a set: the larger of long-run variance and cluster-robust ratio.
pub(super) fn excess_of(reduced: &Reduced, set: &Set, runs: &[LinearisedRun<'_>]) -> f64 {
    let linear = &reduced.linear;
    let Some(solution) = solution(reduced, set) else {
        return 1.0;
    };
    let change = &solution - &linear.present;
    let explained: Vec<DVector<f64>> = linear.columns.iter().map(|w| w * &change).collect();
    let by_blocks = if runs[0].scenario.input == Input::Voltage {
        1.0
    } else {
        cluster_robust_ratio(linear, set, runs, &explained)
    };
    let left = runs.iter().zip(&explained).map(|(run, explained)| {
        let pairs = run.filtered.white.iter().zip(explained.as_slice().chunks(2));
        let left = pairs.map(|(white, explained)| [0, 1].map(|k| white[k] - explained[k]));
        (run, left.collect())
    });
    excess(&left.collect::<Vec<_>>()).max(by_blocks)
}

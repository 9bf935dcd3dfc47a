//! Excess of what is left over white noise: what intervals must be widened by where a model misses something.

use super::columns::Around;

/// Lags over which what is left may be alike.
const LAGS: usize = 40;
/// Standard deviations of chance that a correlation must exceed to count.
const BY_CHANCE: f64 = 2.0;

/// How many times as large as white noise's the variance of sums of what is left of the innovations of `runs` is, in the
/// worse of the two signals; at least one.
pub(super) fn excess(runs: &[(&Around<'_>, Vec<[f64; 2]>)]) -> f64 {
    let mut worst: f64 = 1.0;
    for signal in 0..2 {
        let mut sums = [0.0; LAGS + 1];
        let mut count = 0.0;
        for (run, left) in runs {
            let is_measured = |sample: &usize| {
                let update = &run.follower.updates[*sample];
                [update.current, update.speed][signal][4] > 0.0
            };
            let left: Vec<f64> = (0..left.len())
                .filter(is_measured)
                .map(|sample| left[sample][signal])
                .collect();
            count += left.len() as f64;
            for (lag, sum) in sums.iter_mut().enumerate().take(left.len()) {
                let products = left.iter().zip(&left[lag..]);
                *sum += products.map(|(a, b)| a * b).sum::<f64>();
            }
        }
        if count > 0.0 {
            let chance = BY_CHANCE * sums[0] / f64::sqrt(count);
            let alike = sums[1..].iter().take_while(|sum| **sum > chance);
            worst = worst.max((sums[0] + 2.0 * alike.sum::<f64>()) / count);
        }
    }
    worst
}

//! Small statistics: moments, order statistics, correlation in time.

use std::borrow::Borrow;

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Arithmetic mean; NaN for no values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Largest magnitude of the finite values; zero where there are none.
pub fn largest<V: Borrow<f64>>(values: impl IntoIterator<Item = V>) -> f64 {
    let magnitudes = values.into_iter().map(|value| value.borrow().abs());
    magnitudes.filter(|magnitude| magnitude.is_finite()).fold(0.0, f64::max)
}

/// Minimum and maximum; plus and minus infinity for no values.
pub fn extent<V: Borrow<f64>>(values: impl IntoIterator<Item = V>) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    values
        .into_iter()
        .fold(none, |(least, most), value| (least.min(*value.borrow()), most.max(*value.borrow())))
}

/// Mean distance between instants, of which there are two or more.
pub fn mean_step(times: &[f64]) -> f64 {
    (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64
}

/// Variance with `n - 1`; NaN for fewer than two values.
pub fn variance(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return f64::NAN;
    }
    let centre = mean(values);
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    squares / (values.len() - 1) as f64
}

/// Median of the finite values; NaN where there are none.
pub fn median(values: &[f64]) -> f64 {
    let mut values = finite(values);
    let count = values.len();
    if count == 0 {
        return f64::NAN;
    }
    let (below, &mut middle, _) = values.select_nth_unstable_by(count / 2, f64::total_cmp);
    if !count.is_multiple_of(2) {
        return middle;
    }
    let before = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    0.5 * (before + middle)
}

/// Median distance between instants; NaN for fewer than two.
pub fn median_step(times: &[f64]) -> f64 {
    let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    median(&steps)
}

pub fn finite(values: &[f64]) -> Vec<f64> {
    values.iter().copied().filter(|v| v.is_finite()).collect()
}

/// The 99.5 % quantile of the magnitudes: a single bad cell must not set the scale.
pub fn largest_but_outliers(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = finite(values).into_iter().map(f64::abs).collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    sizes.get(sizes.len() / 200).copied().unwrap_or(0.0)
}

/// Median absolute deviation times 1.4826, which is the standard deviation of normal values without their outliers (Hampel,
/// *J. Am. Stat. Assoc.* 69, 1974).
pub fn robust_deviation(values: &[f64]) -> f64 {
    let centre = median(values);
    let distances: Vec<f64> = values.iter().map(|value| (value - centre).abs()).collect();
    1.4826 * median(&distances)
}

/// Autocorrelation at lags `1..=most`; empty where the values do not vary or are too few.
pub fn autocorrelation(values: &[f64], most: usize) -> Vec<f64> {
    let centre = mean(values);
    let power: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    if values.len() <= most || !(power.is_finite() && power > 0.0) {
        return Vec::new();
    }
    let product = |(later, earlier): (&f64, &f64)| (later - centre) * (earlier - centre);
    let at = |lag: usize| values[lag..].iter().zip(values).map(product).sum::<f64>() / power;
    (1..=most).map(at).collect()
}

pub const WHITENESS_LAGS: usize = 25;
/// Half-width of the 99 % band of a correlation, times the root of the number of samples.
pub const BAND_99: f64 = 2.58;
/// Share of lags outside that band that chance explains: more than three of 25 in one run of 10,000.
pub const OUTSIDE_BY_CHANCE: f64 = 0.12;

/// Significance of the Ljung-Box test: the same as that of the count of lags above.
pub const COLOURED_BY_CHANCE: f64 = 1e-4;

/// Whether the values are autocorrelated beyond chance; false also where there are too few for a test. The number of lags
/// outside their band detects weak correlation at many lags, the Ljung-Box statistic strong correlation at one.
pub fn is_coloured(values: &[f64]) -> bool {
    if values.len() < 4 * WHITENESS_LAGS {
        return false;
    }
    let band = BAND_99 / (values.len() as f64).sqrt();
    let correlations = autocorrelation(values, WHITENESS_LAGS);
    let outside = correlations.iter().filter(|rho| rho.abs() > band).count() as f64;
    outside > OUTSIDE_BY_CHANCE * WHITENESS_LAGS as f64
        || ljung_box_statistic(&correlations, values.len())
            > ljung_box_limit(WHITENESS_LAGS, COLOURED_BY_CHANCE)
}

/// Ljung-Box statistic of the correlations at lags 1, 2, ... of so many values (Ljung and Box 1978).
pub fn ljung_box_statistic(correlations: &[f64], values: usize) -> f64 {
    let n = values as f64;
    let terms = correlations.iter().zip(1..).map(|(rho, lag)| rho * rho / (n - f64::from(lag)));
    n * (n + 2.0) * terms.sum::<f64>()
}

/// The statistic over `lags` that white values exceed with this probability.
pub fn ljung_box_limit(lags: usize, probability: f64) -> f64 {
    ChiSquared::new(lags as f64).map_or(f64::INFINITY, |chi| chi.inverse_cdf(1.0 - probability))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng as _, SeedableRng as _};
    use rand_distr::StandardNormal;

    fn noise(seed: u64, rows: usize) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        (0..rows).map(|_| rng.sample(StandardNormal)).collect()
    }

    #[test]
    fn moments_and_order_statistics() {
        let values = [4.0, 1.0, 3.0, 2.0];
        for (name, found, expected) in [
            ("mean", mean(&values), 2.5),
            ("variance", variance(&values), 5.0 / 3.0),
            ("median", median(&values), 2.5),
            ("odd median", median(&[9.0, 1.0, f64::NAN, 2.0]), 2.0),
            ("step", median_step(&[0.0, 1.0, 5.0, 7.0]), 2.0),
            ("largest", largest([1.0, f64::NAN, -3.0]), 3.0),
            ("largest of none", largest::<f64>([]), 0.0),
        ] {
            assert!((found - expected).abs() < 1e-15, "{name}: {found}");
        }
        assert!(median(&[]).is_nan() && variance(&[1.0]).is_nan());
        let mut values = noise(3, 2000);
        values[..200].fill(1e6);
        assert!((robust_deviation(&values) - 1.0).abs() < 0.2);
    }

    #[test]
    fn white_noise_passes_the_ljung_box_test_a_moving_mean_fails() {
        let statistic =
            |values: &[f64]| ljung_box_statistic(&autocorrelation(values, 25), values.len());
        let white = noise(1, 2000);
        assert!(statistic(&white) < ljung_box_limit(25, 0.01));
        let filtered: Vec<f64> = white.windows(3).map(|w| w.iter().sum()).collect();
        let rho = autocorrelation(&filtered, 3);
        for (found, expected) in rho.iter().zip([2.0 / 3.0, 1.0 / 3.0, 0.0]) {
            assert!((found - expected).abs() < 0.08, "{rho:?}");
        }
        assert!(statistic(&filtered) > ljung_box_limit(25, 1e-6));
        assert!(autocorrelation(&[1.0; 100], 25).is_empty());
    }

    #[test]
    fn one_strong_lag_is_colour_and_white_noise_is_hardly_ever() {
        let echoed = |seed: u64| -> Vec<f64> {
            let white = noise(seed, 5000);
            let echo = |k: usize| if k >= 5 { 0.14 * white[k - 5] } else { 0.0 };
            (0..5000).map(|k| white[k] + echo(k)).collect()
        };
        let detected = (0..50).filter(|seed| is_coloured(&echoed(*seed))).count();
        assert!(detected >= 48, "{detected} of 50");
        let correlations = autocorrelation(&echoed(1), WHITENESS_LAGS);
        let is_outside = |rho: &&f64| rho.abs() > BAND_99 / 5000_f64.sqrt();
        let outside = correlations.iter().filter(is_outside).count() as f64;
        let by_count = outside > OUTSIDE_BY_CHANCE * WHITENESS_LAGS as f64;
        assert!(!by_count, "the number of lags alone does not detect it");
        for rows in [100, 500, 4000] {
            let is_alarm = |seed: &u64| is_coloured(&noise(10_000 + seed, rows));
            let alarms = (0..2000).filter(is_alarm).count();
            // Two rare alarms of 1e-4 each: more than four in 2,000 happens to them in one case of a thousand.
            assert!(alarms <= 4, "{alarms} of 2000 with {rows} rows");
        }
    }
}

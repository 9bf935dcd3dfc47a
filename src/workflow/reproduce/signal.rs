//! Excitation, noise and spread over seeds: everything random here comes from a stated seed.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use serde::Serialize;

use crate::numerics::count::whole;
use crate::numerics::statistics::variance;

/// A signal-to-noise ratio and what it is a ratio of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SignalToNoise {
    pub value: f64,
    pub of: RatioOf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RatioOf {
    /// Variances.
    Power,
    /// Standard deviations.
    Amplitude,
}

impl SignalToNoise {
    pub(super) const fn power(value: f64) -> Self {
        Self {
            value,
            of: RatioOf::Power,
        }
    }

    pub(super) const fn amplitude(value: f64) -> Self {
        Self {
            value,
            of: RatioOf::Amplitude,
        }
    }

    /// Standard deviation of the noise beside this signal (its mean does not count).
    pub(super) fn noise_beside(self, signal: &[f64]) -> f64 {
        let deviation = variance(signal).sqrt();
        match self.of {
            RatioOf::Power => deviation / self.value.sqrt(),
            RatioOf::Amplitude => deviation / self.value,
        }
    }

    /// As it is printed: `10 (power)`.
    pub fn text(self) -> String {
        format!("{} ({})", self.value, self.of.name())
    }
}

impl RatioOf {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Power => "power",
            Self::Amplitude => "amplitude",
        }
    }
}

/// Random numbers of one purpose; other purposes of the same seed are independent of it.
pub(super) fn random(seed: u64, purpose: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(purpose);
    random
}

/// Two voltages in turn, each held for a random whole number of periods in `hold`.
pub(super) fn random_binary(
    random: &mut ChaCha8Rng,
    levels_v: [f64; 2],
    hold: std::ops::RangeInclusive<usize>,
    samples: usize,
) -> Vec<f64> {
    let mut out = Vec::with_capacity(samples);
    let mut high = false;
    while out.len() < samples {
        high = !high;
        let length = random.random_range(hold.clone()).min(samples - out.len());
        out.extend(std::iter::repeat_n(levels_v[usize::from(high)], length));
    }
    out
}

/// White Gaussian noise of variance one.
pub(super) fn white(random: &mut ChaCha8Rng, samples: usize) -> Vec<f64> {
    (0..samples)
        .map(|_| StandardNormal.sample(random))
        .collect()
}

/// `signal + deviation * noise`.
pub(super) fn with_noise(signal: &[f64], noise: &[f64], deviation: f64) -> Vec<f64> {
    let both = signal.iter().zip(noise);
    both.map(|(signal, noise)| signal + deviation * noise)
        .collect()
}

/// How estimates of one quantity lie over time and seeds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    pub set_value: f64,
    /// 5 %, 50 % and 95 % quantile of the estimates that there are; NaN where there is none.
    pub low: f64,
    pub median: f64,
    pub high: f64,
    /// Of the median, per cent of the set value.
    pub error_percent: f64,
    /// Share of the estimates that exist (positive, physical), per cent.
    pub told_percent: f64,
}

impl Spread {
    /// Of values that may be NaN where the scheme gave none.
    pub(super) fn of(set_value: f64, estimates: impl IntoIterator<Item = f64>) -> Self {
        let all: Vec<f64> = estimates.into_iter().collect();
        let mut told: Vec<f64> = all.iter().copied().filter(|v| v.is_finite()).collect();
        told.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            let last = told.len().checked_sub(1)?;
            told.get(whole((share * last as f64).round())).copied()
        };
        let [low, median, high] =
            [0.05, 0.5, 0.95].map(|share| quantile(share).unwrap_or(f64::NAN));
        Self {
            set_value,
            low,
            median,
            high,
            error_percent: 100.0 * (median / set_value - 1.0),
            told_percent: 100.0 * told.len() as f64 / all.len().max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_asked_ratio_to_the_signal() {
        let signal: Vec<f64> = (0..4000)
            .map(|k| 50.0 + (0.1 * f64::from(k)).sin())
            .collect();
        let noise = white(&mut random(1, 1), 4000);
        for (ratio, power) in [
            (SignalToNoise::power(10.0), 10.0),
            (SignalToNoise::amplitude(10.0), 100.0),
        ] {
            let noisy = with_noise(&signal, &noise, ratio.noise_beside(&signal));
            let rest: Vec<f64> = noisy.iter().zip(&signal).map(|(a, b)| a - b).collect();
            let found = variance(&signal) / variance(&rest);
            assert!((found / power - 1.0).abs() < 0.1, "{found}");
        }
    }

    #[test]
    fn quantiles_leave_out_what_was_not_told() {
        let spread = Spread::of(2.0, (0..=100).map(f64::from).chain([f64::NAN]));
        assert!((spread.low - 5.0).abs() < 1e-12 && (spread.median - 50.0).abs() < 1e-12);
        assert!((spread.error_percent - 2400.0).abs() < 1e-9);
        assert!(spread.told_percent < 99.1);
        assert!(Spread::of(1.0, []).median.is_nan());
    }
}

//! Residual lights: is there anything left in the error but noise?

use serde::Serialize;

/// Lags that are looked at.
const LAGS: usize = 25;
/// Samples below which an autocorrelation says nothing.
const FEWEST_SAMPLES: usize = 4 * LAGS;

/// Whiteness of the residual; the 99 % band is `2.58 / sqrt(n)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ResidualLights {
    /// False also where there are too few samples to say.
    pub white: bool,
    /// Whether every signal has samples enough for the verdict.
    pub enough_samples: bool,
    /// Share of the lags 1..25 whose autocorrelation lies outside the 99 % band, the worse of the signals.
    pub autocorrelation_outside_99_percent: f64,
}

impl ResidualLights {
    /// From the residuals of every signal, in order of time.
    pub fn of(signals: &[Vec<f64>]) -> Self {
        // A signal that the run does not have says nothing either way.
        let measured = || signals.iter().filter(|residual| !residual.is_empty());
        let worst = measured()
            .map(|residual| share_outside(residual))
            .fold(0.0, f64::max);
        let enough_samples = measured().next().is_some()
            && measured().all(|residual| residual.len() >= FEWEST_SAMPLES);
        // By chance a lag lies outside in one case of a hundred: more than three of 25 in one run of 8,000.
        Self {
            white: enough_samples && worst <= 0.12,
            enough_samples,
            autocorrelation_outside_99_percent: worst,
        }
    }
}

fn share_outside(residual: &[f64]) -> f64 {
    let n = residual.len();
    if n < FEWEST_SAMPLES {
        return 0.0;
    }
    let mean = residual.iter().sum::<f64>() / n as f64;
    let centred: Vec<f64> = residual.iter().map(|value| value - mean).collect();
    let power: f64 = centred.iter().map(|value| value * value).sum();
    if power <= 0.0 {
        return 0.0;
    }
    let band = 2.58 / (n as f64).sqrt();
    let outside = (1..=LAGS).filter(|lag| {
        let product: f64 = centred[*lag..]
            .iter()
            .zip(&centred)
            .map(|(late, early)| late * early)
            .sum();
        (product / power).abs() > band
    });
    outside.count() as f64 / LAGS as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn noise_is_white_and_a_slow_wave_is_not() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let noise: Vec<f64> = (0..5000).map(|_| rng.random::<f64>() - 0.5).collect();
        assert!(ResidualLights::of(std::slice::from_ref(&noise)).white);
        let wave: Vec<f64> = noise
            .iter()
            .enumerate()
            .map(|(k, n)| n + 0.3 * (k as f64 / 50.0).sin())
            .collect();
        let lights = ResidualLights::of(&[noise, wave]);
        assert!(
            !ResidualLights::of(&[vec![0.0; 40]]).white,
            "too few to say"
        );
        assert!(!lights.white && lights.autocorrelation_outside_99_percent > 0.5);
    }
}

//! How well a model's free run meets a run, in SI and in units of the noise.

use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::{self, FitError};
use crate::numerics::count::whole;
use crate::plant::{Model, Scenario};

/// Free-run figures of one signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalScore {
    /// `100 (1 - |e| / |y - mean y|)`, not clipped.
    pub fit_percent: f64,
    pub rmse: f64,
    pub samples: usize,
}

/// Residuals of a free run over the scored samples.
#[derive(Clone, Debug)]
pub struct Score {
    pub current: Option<SignalScore>,
    pub speed: Option<SignalScore>,
    /// Root of the mean over the signals of `(rmse / noise)^2`.
    pub nrms: f64,
    /// `(time, residual)` of current in A, NaN where missing.
    time_s: Vec<f64>,
    current_a: Vec<f64>,
    speed_rad_s: Vec<f64>,
    noise: NoiseFloor,
}

impl Score {
    /// Simulates a complete model over the scenario; only the initial state is fitted, where the run starts in motion.
    pub fn of(model: &Model, scenario: &Scenario, noise: &NoiseFloor) -> Result<Self, FitError> {
        let trajectory = output_error::predict(model, scenario, noise)?.trajectory;
        let residual = |simulated: &[f64], measured: &[f64], level: f64| -> Vec<f64> {
            if level.is_infinite() {
                return vec![f64::NAN; scenario.scored.len()];
            }
            scenario
                .scored
                .clone()
                .map(|sample| simulated[sample] - measured[sample])
                .collect()
        };
        let current_a = residual(&trajectory.current_a, &scenario.current_a, noise.current_a);
        let speed_rad_s = residual(
            &trajectory.speed_rad_s,
            &scenario.speed_rad_s,
            noise.speed_rad_s,
        );
        let current = signal_score(&current_a, &scenario.current_a[scenario.scored.clone()]);
        let speed = signal_score(&speed_rad_s, &scenario.speed_rad_s[scenario.scored.clone()]);
        let ratios: Vec<f64> = [(current, noise.current_a), (speed, noise.speed_rad_s)]
            .into_iter()
            .filter_map(|(signal, level)| Some((signal?.rmse / level).powi(2)))
            .collect();
        let nrms = (ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).sqrt();
        Ok(Self {
            current,
            speed,
            nrms,
            time_s: scenario.sample_time_s[scenario.scored.clone()].to_vec(),
            current_a,
            speed_rad_s,
            noise: *noise,
        })
    }

    /// `(time, residual)` of the current, A.
    pub fn current_residual(&self) -> Vec<(f64, f64)> {
        finite_points(&self.time_s, &self.current_a)
    }

    /// `(time, residual)` of the speed, rad/s.
    pub fn speed_residual(&self) -> Vec<(f64, f64)> {
        finite_points(&self.time_s, &self.speed_rad_s)
    }

    /// Sum of the squared weighted residuals in blocks of `block_s`. Every signal counts with its number of samples.
    pub fn blocks(&self, block_s: f64) -> Vec<f64> {
        let blocks = self.counted_blocks(block_s);
        blocks.into_iter().map(|(squares, _)| squares).collect()
    }

    /// The same with the number of residuals in each block.
    pub(super) fn counted_blocks(&self, block_s: f64) -> Vec<(f64, usize)> {
        let Some(&begin_s) = self.time_s.first() else {
            return Vec::new();
        };
        let end_s = self.time_s[self.time_s.len() - 1];
        let mut blocks = vec![(0.0, 0); whole((end_s - begin_s) / block_s) + 1];
        for (row, time_s) in self.time_s.iter().enumerate() {
            let (block, count) = &mut blocks[whole((time_s - begin_s) / block_s)];
            for (value, level) in [
                (self.current_a[row], self.noise.current_a),
                (self.speed_rad_s[row], self.noise.speed_rad_s),
            ] {
                if value.is_finite() {
                    *block += (value / level).powi(2);
                    *count += 1;
                }
            }
        }
        blocks
    }

    /// The floor that the residuals are scaled by.
    pub(super) const fn noise(&self) -> &NoiseFloor {
        &self.noise
    }

    pub fn duration_s(&self) -> f64 {
        self.time_s.last().copied().unwrap_or(0.0) - self.time_s.first().copied().unwrap_or(0.0)
    }
}

fn signal_score(residual: &[f64], measured: &[f64]) -> Option<SignalScore> {
    let pairs: Vec<(f64, f64)> = residual
        .iter()
        .copied()
        .zip(measured.iter().copied())
        .filter(|(error, value)| error.is_finite() && value.is_finite())
        .collect();
    if pairs.is_empty() {
        return None;
    }
    let samples = pairs.len();
    let mean = pairs.iter().map(|pair| pair.1).sum::<f64>() / samples as f64;
    let spread: f64 = pairs.iter().map(|pair| (pair.1 - mean).powi(2)).sum();
    let squares: f64 = pairs.iter().map(|pair| pair.0 * pair.0).sum();
    let fit_percent = 100.0 * (1.0 - (squares / spread.max(f64::MIN_POSITIVE)).sqrt());
    Some(SignalScore {
        fit_percent,
        rmse: (squares / samples as f64).sqrt(),
        samples,
    })
}

fn finite_points(time_s: &[f64], values: &[f64]) -> Vec<(f64, f64)> {
    time_s
        .iter()
        .copied()
        .zip(values.iter().copied())
        .filter(|(_, value)| value.is_finite())
        .collect()
}

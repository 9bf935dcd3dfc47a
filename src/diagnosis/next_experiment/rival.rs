//! A fitted model and how much its errors count.

use crate::diagnosis::Evidence;
use crate::identification::output_error::{FitError, FreeRun};
use crate::numerics::levenberg_marquardt::Problem;
use crate::numerics::statistics::autocorrelation;
use crate::plant::Model;

/// Lags beyond which a correlation of the residual is not followed.
const MOST_LAGS: usize = 200;

/// A rival of a pair.
pub(super) struct Rival<'a> {
    pub(super) model: &'a Model,
    /// Factor by which the residual's squares count less than those of white noise at the floor, at least one.
    pub(super) inflation: f64,
}

impl<'a> Rival<'a> {
    /// `model` as fitted to the training run.
    pub(super) fn new(model: &'a Model, evidence: &Evidence) -> Result<Self, FitError> {
        let mut problem = FreeRun::new(model, &evidence.training, evidence.noise)?;
        let x = problem.start();
        let mut residual = vec![0.0; problem.residual_len()];
        if !problem.residual(&x, &mut residual) {
            return Err(FitError::CannotSimulate {
                run: evidence.training.name.clone(),
            });
        }
        Ok(Self {
            model,
            inflation: inflation(&residual, problem.rows()),
        })
    }
}

/// `max(1, chi2/n (1 + 2 sum rho))`, the correlation followed in each signal to its first lag within chance (Bartlett).
fn inflation(residual: &[f64], rows: &[(usize, bool)]) -> f64 {
    let mut sum = 0.0;
    for speed in [false, true] {
        let signal: Vec<f64> = residual
            .iter()
            .zip(rows)
            .filter(|(_, row)| row.1 == speed)
            .map(|(value, _)| *value)
            .collect();
        let chance = 2.0 / (signal.len() as f64).sqrt();
        let correlated: f64 = autocorrelation(&signal, MOST_LAGS)
            .into_iter()
            .take_while(|rho| *rho > chance)
            .sum();
        let squares: f64 = signal.iter().map(|value| value * value).sum();
        sum += squares * (1.0 + 2.0 * correlated);
    }
    (sum / residual.len().max(1) as f64).max(1.0)
}

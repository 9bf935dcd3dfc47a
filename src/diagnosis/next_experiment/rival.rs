//! A fitted model and how firmly the present data hold its parameters.

use nalgebra::{DMatrix, DVector};

use crate::diagnosis::Evidence;
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::{self, FitError, FreeRun};
use crate::numerics::levenberg_marquardt::{Problem, jacobian_at};
use crate::numerics::statistics::autocorrelation;
use crate::plant::{Model, ParameterRole, Scenario, Slot};

/// Lags beyond which a correlation of the residual is not followed.
const MOST_LAGS: usize = 200;

/// A rival of a pair.
#[derive(Clone)]
pub(super) struct Rival<'a> {
    pub(super) model: &'a Model,
    /// `J'J` of the present data over the free parameters, the start of the run and the times of its events eliminated:
    /// another run has its own.
    information: DMatrix<f64>,
    /// d(parameter)/dx of the coordinates of `information`.
    slopes: Vec<f64>,
    /// Factor by which the residual's squares count less than those of white noise at the floor, at least one.
    pub(super) inflation: f64,
}

impl<'a> Rival<'a> {
    /// `model` as fitted to the training run.
    pub(super) fn new(model: &'a Model, evidence: &Evidence) -> Result<Self, FitError> {
        let problem = FreeRun::new(model, &evidence.training, evidence.noise)?;
        let x = problem.start();
        let mut residual = vec![0.0; problem.residual_len()];
        if !problem.residual(&x, &mut residual) {
            return Err(FitError::CannotSimulate {
                run: evidence.training.name.clone(),
            });
        }
        let jacobian = jacobian_at(&problem, &x, &residual);
        let normal = jacobian.tr_mul(&jacobian);
        let free = problem.free_slots();
        let passing: Vec<usize> = (0..x.len())
            .filter(|&index| free.get(index).is_none_or(is_event))
            .collect();
        let inflation = inflation(&residual, problem.rows());
        Ok(Self {
            model,
            information: eliminated(&normal, &passing, free.len()),
            slopes: problem.slopes(&x),
            inflation,
        })
    }

    /// Its model with the events where they are in `run`, which has its own; `None` for a model without events.
    pub(super) fn placed(&self, run: &Scenario, noise: NoiseFloor) -> Option<Model> {
        self.model.free_slots().iter().find(|slot| is_event(slot))?;
        let mut placed = output_error::predict(self.model, run, &noise).ok()?.model;
        placed.fixed.clone_from(&self.model.fixed);
        Some(placed)
    }

    /// The same rival with its events elsewhere.
    pub(super) fn with<'b>(&self, model: &'b Model) -> Rival<'b> {
        Rival {
            model,
            information: self.information.clone(),
            slopes: self.slopes.clone(),
            inflation: self.inflation,
        }
    }

    /// The information in the coordinates of another run's problem, whose units may differ.
    pub(super) fn information_in(&self, problem: &FreeRun<'_>, x: &[f64]) -> DMatrix<f64> {
        let free = problem.free_slots().len();
        let scale: Vec<f64> = problem
            .slopes(x)
            .iter()
            .zip(&self.slopes)
            .take(free)
            .map(|(there, here)| if *here == 0.0 { 0.0 } else { there / here })
            .collect();
        DMatrix::from_fn(x.len(), x.len(), |row, column| {
            if row < free && column < free {
                self.information[(row, column)] * scale[row] * scale[column]
            } else {
                0.0
            }
        })
    }
}

fn is_event(slot: &Slot) -> bool {
    slot.has_role(ParameterRole::EventTime)
}

/// The normal matrix over the first `kept` unknowns when those in `passing` may be anything (Schur complement); the rows
/// of a passing unknown that is among the first are zero.
fn eliminated(normal: &DMatrix<f64>, passing: &[usize], kept: usize) -> DMatrix<f64> {
    let mut left = normal.clone();
    for &index in passing {
        let pivot = left[(index, index)];
        if pivot > 0.0 {
            let column: DVector<f64> = left.column(index).into_owned();
            left.ger(-1.0 / pivot, &column, &column, 1.0);
        }
        left.row_mut(index).fill(0.0);
        left.column_mut(index).fill(0.0);
    }
    left.view((0, 0), (kept, kept)).into_owned()
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

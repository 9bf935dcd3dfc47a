//! Separation of rivals by a planned run: how far one stays from the truth after it was fitted to the old data and the new.
//!
//! `D(A|B) = min over dx of |d + S dx|^2 + dx'F dx`, `d = (y_A - y_B)/sigma` in the new run, `S` the Jacobian of B there,
//! `F` its information from the old data: how firmly they hold its parameters.

use nalgebra::{DMatrix, DVector};

use super::plan::SHORTEST_PERIOD_S;
use crate::evidence::Evidence;
use crate::score::cannot_simulate;
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::{self, FitError, FreeRun};
use drivebench_model::numerics::levenberg_marquardt::{Options, Problem, jacobian_at, minimise};
use drivebench_model::numerics::statistics::autocorrelation;
use drivebench_model::plant::{Model, ParameterRole, Scenario, Slot};

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
            return Err(cannot_simulate(&evidence.training));
        }
        let jacobian = jacobian_at(&problem, &x, &residual);
        let normal = jacobian.tr_mul(&jacobian);
        let free = problem.free_slots();
        let passing: Vec<usize> =
            (0..x.len()).filter(|&index| free.get(index).is_none_or(is_event)).collect();
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
        let correlated: f64 =
            autocorrelation(&signal, MOST_LAGS).into_iter().take_while(|rho| *rho > chance).sum();
        let squares: f64 = signal.iter().map(|value| value * value).sum();
        sum += squares * (1.0 + 2.0 * correlated);
    }
    (sum / residual.len().max(1) as f64).max(1.0)
}

/// `D` for a linear rival; `run` holds what the truth would show. `None` where the rival cannot be simulated.
pub(super) fn linear(run: &Scenario, rival: &Rival<'_>, noise: NoiseFloor) -> Option<f64> {
    let (response, difference) = Response::of(rival, run, noise)?;
    Some(response.separation(&difference))
}

fn planned_run<'a>(rival: &Rival<'_>, run: &'a Scenario, noise: NoiseFloor) -> Option<FreeRun<'a>> {
    let run = FreeRun::new(rival.model, run, noise).ok()?;
    Some(run.coarse(SHORTEST_PERIOD_S))
}

/// The rival's difference to the run, in units of the noise.
fn difference(problem: &FreeRun<'_>, x: &[f64]) -> Option<DVector<f64>> {
    let mut out = vec![0.0; problem.residual_len()];
    problem.residual(x, &mut out).then(|| DVector::from_vec(out))
}

/// How a rival can change in a run.
pub(super) struct Response {
    jacobian: DMatrix<f64>,
    information: DMatrix<f64>,
}

impl Response {
    /// Of this rival in `run`, with its difference to what the run holds.
    pub(super) fn of(
        rival: &Rival<'_>,
        run: &Scenario,
        noise: NoiseFloor,
    ) -> Option<(Self, DVector<f64>)> {
        let problem = planned_run(rival, run, noise)?;
        let x = problem.start();
        let difference = difference(&problem, &x)?;
        let response = Self {
            jacobian: jacobian_at(&problem, &x, difference.as_slice()),
            information: rival.information_in(&problem, &x),
        };
        Some((response, difference))
    }

    /// `D` for another truth in the same run.
    pub(super) fn separation_from(
        &self,
        run: &Scenario,
        rival: &Rival<'_>,
        noise: NoiseFloor,
    ) -> Option<f64> {
        let problem = planned_run(rival, run, noise)?;
        let x = problem.start();
        if x.len() != self.information.nrows() {
            // An offset does not look like rest: its start is one more unknown.
            return linear(run, rival, noise);
        }
        Some(self.separation(&difference(&problem, &x)?))
    }

    /// The same where nothing holds the rival but the run itself.
    pub(super) fn without_memory(mut self) -> Self {
        self.information.fill(0.0);
        self
    }

    /// What is left of `difference` when the rival has moved as far as the old data allow.
    pub(super) fn separation(&self, difference: &DVector<f64>) -> f64 {
        self.step(difference).map_or_else(
            || difference.norm_squared(),
            |step| {
                let left = difference + &self.jacobian * &step;
                left.norm_squared() + step.dot(&(&self.information * &step))
            },
        )
    }

    /// The rival's best move against `difference`.
    fn step(&self, difference: &DVector<f64>) -> Option<DVector<f64>> {
        let normal = self.jacobian.tr_mul(&self.jacobian) + &self.information;
        let gradient = self.jacobian.tr_mul(difference);
        // Scaled to a unit diagonal, with a ridge for directions that nothing determines.
        let scale: Vec<f64> = (0..normal.nrows())
            .map(|k| 1.0 / normal[(k, k)].max(f64::MIN_POSITIVE).sqrt())
            .collect();
        let scaled = DMatrix::from_fn(normal.nrows(), normal.ncols(), |row, column| {
            let ridge = if row == column { 1e-10 } else { 0.0 };
            normal[(row, column)] * scale[row] * scale[column] + ridge
        });
        let right = DVector::from_fn(gradient.len(), |k, _| gradient[k] * scale[k]);
        let solved = scaled.cholesky()?.solve(&right);
        Some(DVector::from_fn(solved.len(), |k, _| -solved[k] * scale[k]))
    }
}

/// The same with the rival fitted in full, so that one that bends does not pass for one that cannot.
pub(super) fn refitted(run: &Scenario, rival: &Rival<'_>, noise: NoiseFloor) -> Option<f64> {
    let placed = rival.placed(run, noise);
    let rival = &placed.as_ref().map_or_else(|| rival.clone(), |model| rival.with(model));
    let problem = planned_run(rival, run, noise)?;
    let start = problem.start();
    let (response, difference) = Response::of(rival, run, noise)?;
    // Most of the way is linear.
    let mut begin = start.clone();
    if let Some(step) = response.step(&difference) {
        for (x, step) in begin.iter_mut().zip(step.iter()) {
            *x += step.clamp(-LONGEST_STEP, LONGEST_STEP);
        }
        problem.clamp(&mut begin);
    }
    let mut out = vec![0.0; problem.residual_len()];
    if !problem.residual(&begin, &mut out) {
        begin.clone_from(&start);
    }
    let held = HeldByOldData { root: root(&response.information), start, run: problem };
    let options = Options {
        most_iterations: 12,
        relative_cost: 1e-2,
        longest_step: LONGEST_STEP,
        ..Options::thrifty()
    };
    Some(minimise(&held, &begin, options)?.cost)
}

/// Longest step of a scaled parameter.
const LONGEST_STEP: f64 = 1.5;

/// A free run with the old data as a spring to where they hold the parameters.
struct HeldByOldData<'a> {
    run: FreeRun<'a>,
    /// `root' root` is the information.
    root: DMatrix<f64>,
    start: Vec<f64>,
}

impl Problem for HeldByOldData<'_> {
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
        let rows = self.run.residual_len();
        let moved = DVector::from_iterator(
            x.len(),
            x.iter().zip(&self.start).map(|(here, start)| here - start),
        );
        out[rows..].copy_from_slice((&self.root * moved).as_slice());
        self.run.residual(x, &mut out[..rows])
    }

    fn residual_len(&self) -> usize {
        self.run.residual_len() + self.root.nrows()
    }

    fn difference_step(&self, index: usize) -> f64 {
        self.run.difference_step(index)
    }

    fn clamp(&self, x: &mut [f64]) {
        self.run.clamp(x);
    }
}

/// A square root of a matrix that may be singular: scaled eigenvalues, the negative ones of rounding left out.
fn root(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    let scale: Vec<f64> = (0..n)
        .map(|k| matrix[(k, k)])
        .map(|value| if value > 0.0 { value.sqrt() } else { 1.0 })
        .collect();
    let scaled =
        DMatrix::from_fn(n, n, |row, column| matrix[(row, column)] / (scale[row] * scale[column]));
    let eigen = scaled.symmetric_eigen();
    DMatrix::from_fn(n, n, |row, column| {
        eigen.eigenvalues[row].max(0.0).sqrt() * eigen.eigenvectors[(column, row)] * scale[column]
    })
}

//! Separation of rivals by a planned run: the error of one of them after a fit to the old data and the new (T-optimality).
//!
//! `D(A|B) = min over dx of |d + S dx|^2 + dx'F dx`, `d = (y_A - y_B)/sigma` in the new run, `S` the Jacobian of B there,
//! `F` its information matrix from the old data.

use nalgebra::{DMatrix, DVector};

use super::plan::SHORTEST_PERIOD_S;
use crate::evidence::Evidence;
use crate::score::cannot_simulate;
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::{self, FitError, FreeRun};
use drivebench_model::numerics::levenberg_marquardt::{Options, Problem, jacobian_at, minimise};
use drivebench_model::numerics::statistics::autocorrelation;
use drivebench_model::plant::{Model, ParameterRole, Scenario, Slot};

/// Largest lag of the residual's autocorrelation.
const MOST_LAGS: usize = 200;

/// A rival of a pair.
#[derive(Clone)]
pub(super) struct Rival<'a> {
    pub(super) model: &'a Model,
    /// `J'J` of the present data over the free parameters, the initial state and the times of events eliminated:
    /// another run has its own.
    information: DMatrix<f64>,
    /// d(parameter)/dx of the coordinates of `information`.
    slopes: Vec<f64>,
    /// Variance inflation (c-hat) of the residual against white noise at the floor, at least one.
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
        let nuisance: Vec<usize> =
            (0..x.len()).filter(|&index| free.get(index).is_none_or(is_event)).collect();
        let inflation = inflation(&residual, problem.rows());
        Ok(Self {
            model,
            information: eliminated(&normal, &nuisance, free.len()),
            slopes: problem.slopes(&x),
            inflation,
        })
    }

    /// Its model with the times of events estimated from `run`; `None` for a model without events.
    pub(super) fn placed(&self, run: &Scenario, noise: NoiseFloor) -> Option<Model> {
        self.model.free_slots().iter().find(|slot| is_event(slot))?;
        let mut placed = output_error::predict(self.model, run, &noise).ok()?.model;
        placed.fixed.clone_from(&self.model.fixed);
        Some(placed)
    }

    /// The same rival with other times of events.
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

/// The normal matrix over the first `kept` unknowns with those in `nuisance` eliminated (Schur complement); the rows
/// of a nuisance parameter that is among the first are zero.
fn eliminated(normal: &DMatrix<f64>, nuisance: &[usize], kept: usize) -> DMatrix<f64> {
    let mut left = normal.clone();
    for &index in nuisance {
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

/// `max(1, chi2/n (1 + 2 sum rho))`, summed in each signal to its first lag within chance (Bartlett).
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

/// `D` for a linear rival; `run` is simulated with the truth. `None` where the rival cannot be simulated.
pub(super) fn linear(run: &Scenario, rival: &Rival<'_>, noise: NoiseFloor) -> Option<f64> {
    let (response, difference) = Response::of(rival, run, noise)?;
    Some(response.separation(&difference))
}

fn planned_run<'a>(rival: &Rival<'_>, run: &'a Scenario, noise: NoiseFloor) -> Option<FreeRun<'a>> {
    Some(FreeRun::new(rival.model, run, noise).ok()?.coarse(SHORTEST_PERIOD_S))
}

/// The rival's difference to the run, in units of the noise.
fn difference(problem: &FreeRun<'_>, x: &[f64]) -> Option<DVector<f64>> {
    let mut out = vec![0.0; problem.residual_len()];
    problem.residual(x, &mut out).then(|| DVector::from_vec(out))
}

/// Linear response of a rival in a run to its parameters.
pub(super) struct Response {
    jacobian: DMatrix<f64>,
    pub(super) information: DMatrix<f64>,
}

impl Response {
    /// Of this rival in `run`, with its difference to the run.
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
            // With an offset the run does not begin at rest: its initial state is one more unknown.
            return linear(run, rival, noise);
        }
        Some(self.separation(&difference(&problem, &x)?))
    }

    /// Minimum of the penalised squared difference over the rival's parameters.
    pub(super) fn separation(&self, difference: &DVector<f64>) -> f64 {
        self.step(difference).map_or_else(
            || difference.norm_squared(),
            |step| {
                let left = difference + &self.jacobian * &step;
                left.norm_squared() + step.dot(&(&self.information * &step))
            },
        )
    }

    /// The Gauss-Newton step of the rival's parameters against `difference`.
    fn step(&self, difference: &DVector<f64>) -> Option<DVector<f64>> {
        let normal = self.jacobian.tr_mul(&self.jacobian) + &self.information;
        let gradient = self.jacobian.tr_mul(difference);
        // Scaled to a unit diagonal, with a ridge for undetermined directions.
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

/// The same with a nonlinear fit of the rival.
pub(super) fn refitted(run: &Scenario, rival: &Rival<'_>, noise: NoiseFloor) -> Option<f64> {
    let placed = rival.placed(run, noise);
    let rival = &placed.as_ref().map_or_else(|| rival.clone(), |model| rival.with(model));
    let problem = planned_run(rival, run, noise)?;
    let start = problem.start();
    let (response, difference) = Response::of(rival, run, noise)?;
    // The linear step is the initial point.
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
    let penalised = PenalisedRun { root: root(&response.information), start, run: problem };
    let options = Options {
        most_iterations: 12,
        relative_cost: 1e-2,
        longest_step: LONGEST_STEP,
        ..Options::thrifty()
    };
    Some(minimise(&penalised, &begin, options)?.cost)
}

/// Longest step of a scaled parameter.
const LONGEST_STEP: f64 = 1.5;

/// A free run with the old data as a quadratic penalty on the parameters.
struct PenalisedRun<'a> {
    run: FreeRun<'a>,
    /// `root' root` is the information.
    root: DMatrix<f64>,
    start: Vec<f64>,
}

impl Problem for PenalisedRun<'_> {
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

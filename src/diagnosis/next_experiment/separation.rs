//! How far a rival stays from the truth in a planned run after it has been fitted to the old data and the new.
//!
//! `D(A|B) = min over dx of |d + S dx|^2 + dx'F dx`, `d = (y_A - y_B)/sigma` in the new run, `S` the Jacobian of B there,
//! `F` its information from the old data (DISCOVERY.md 2.11).

use nalgebra::{DMatrix, DVector};

use super::planned::SHORTEST_PERIOD_S;
use super::rival::Rival;
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::FreeRun;
use crate::numerics::levenberg_marquardt::{Options, Problem, jacobian_at, minimise};
use crate::plant::Scenario;

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
    problem
        .residual(x, &mut out)
        .then(|| DVector::from_vec(out))
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
        // Scaled to a unit diagonal, with a hair for directions that nothing determines.
        let scale: Vec<f64> = (0..normal.nrows())
            .map(|k| 1.0 / normal[(k, k)].max(f64::MIN_POSITIVE).sqrt())
            .collect();
        let scaled = DMatrix::from_fn(normal.nrows(), normal.ncols(), |row, column| {
            let hair = if row == column { 1e-10 } else { 0.0 };
            normal[(row, column)] * scale[row] * scale[column] + hair
        });
        let right = DVector::from_fn(gradient.len(), |k, _| gradient[k] * scale[k]);
        let solved = scaled.cholesky()?.solve(&right);
        Some(DVector::from_fn(solved.len(), |k, _| -solved[k] * scale[k]))
    }
}

/// The same with the rival fitted in full, so that one that bends does not pass for one that cannot.
pub(super) fn refitted(run: &Scenario, rival: &Rival<'_>, noise: NoiseFloor) -> Option<f64> {
    let placed = rival.placed(run, noise);
    let rival = &placed
        .as_ref()
        .map_or_else(|| rival.clone(), |model| rival.with(model));
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
    let held = Held {
        root: root(&response.information),
        start,
        run: problem,
    };
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
struct Held<'a> {
    run: FreeRun<'a>,
    /// `root' root` is the information.
    root: DMatrix<f64>,
    start: Vec<f64>,
}

impl Problem for Held<'_> {
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
    let scaled = DMatrix::from_fn(n, n, |row, column| {
        matrix[(row, column)] / (scale[row] * scale[column])
    });
    let eigen = scaled.symmetric_eigen();
    DMatrix::from_fn(n, n, |row, column| {
        eigen.eigenvalues[row].max(0.0).sqrt() * eigen.eigenvectors[(column, row)] * scale[column]
    })
}

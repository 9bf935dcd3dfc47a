//! How far a rival stays from the truth in a planned run after it has been fitted to that run.
//!
//! `D(A|B) = min over dx of |d + S dx|^2`, `d = (y_A - y_B)/sigma` in the new run, `S` the Jacobian of B there. DISCOVERY.md
//! 2.11 adds `dx'F dx`, what the old data hold against the step: a diagnosis judges the new run by itself, so it is left
//! out, and fitting old and new together separates at least as well.

use nalgebra::{DMatrix, DVector};

use super::rival::Rival;
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::FreeRun;
use crate::numerics::levenberg_marquardt::{Options, Problem, jacobian_at, minimise};
use crate::plant::{Model, ParameterRole, Scenario, Slot};

/// The rival's difference to the run, in units of the noise.
fn difference(problem: &mut FreeRun<'_>, x: &[f64]) -> Option<DVector<f64>> {
    let mut out = vec![0.0; problem.residual_len()];
    problem
        .residual(x, &mut out)
        .then(|| DVector::from_vec(out))
}

/// How a rival can change in a run.
pub(super) struct Response {
    jacobian: DMatrix<f64>,
}

impl Response {
    /// Of this rival in `run`, with its difference to what the run holds. `None` where it cannot be simulated.
    pub(super) fn of(
        model: &Model,
        run: &Scenario,
        noise: NoiseFloor,
    ) -> Option<(Self, DVector<f64>)> {
        let mut problem = FreeRun::new(model, run, noise).ok()?;
        let x = problem.start();
        let difference = difference(&mut problem, &x)?;
        let jacobian = jacobian_at(&mut problem, &x, difference.as_slice());
        Some((Self { jacobian }, difference))
    }

    /// `D` for a linear rival and another truth in the same run.
    pub(super) fn separation_from(
        &self,
        run: &Scenario,
        model: &Model,
        noise: NoiseFloor,
    ) -> Option<f64> {
        let mut problem = FreeRun::new(model, run, noise).ok()?;
        let x = problem.start();
        if x.len() != self.jacobian.ncols() {
            // An offset does not look like rest: its start is one more unknown.
            let (there, difference) = Self::of(model, run, noise)?;
            return Some(there.separation(&difference));
        }
        Some(self.separation(&difference(&mut problem, &x)?))
    }

    /// What is left of `difference` when the rival has moved as it likes.
    pub(super) fn separation(&self, difference: &DVector<f64>) -> f64 {
        self.step(difference).map_or_else(
            || difference.norm_squared(),
            |step| (difference + &self.jacobian * &step).norm_squared(),
        )
    }

    /// The rival's best move against `difference`.
    fn step(&self, difference: &DVector<f64>) -> Option<DVector<f64>> {
        let normal = self.jacobian.tr_mul(&self.jacobian);
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

/// Longest step of a scaled parameter.
const LONGEST_STEP: f64 = 1.5;
/// Places of an event from which a rival is refitted.
const BEST_PLACES: usize = 2;

/// The same with the rival fitted in full, so that one that bends does not pass for one that cannot.
pub(super) fn refitted(run: &Scenario, rival: &Rival<'_>, noise: NoiseFloor) -> Option<f64> {
    // An event of the runs in hand stands anywhere in this one, and may have the other sign there.
    let mut placed: Vec<(f64, Model)> = places(rival.model, run)
        .into_iter()
        .filter_map(|model| {
            let (response, difference) = Response::of(&model, run, noise)?;
            Some((response.separation(&difference), model))
        })
        .collect();
    placed.sort_by(|a, b| a.0.total_cmp(&b.0));
    placed
        .iter()
        .take(BEST_PLACES)
        .filter_map(|(_, model)| refitted_from(run, model, noise))
        .min_by(f64::total_cmp)
}

fn refitted_from(run: &Scenario, model: &Model, noise: NoiseFloor) -> Option<f64> {
    let mut problem = FreeRun::new(model, run, noise).ok()?;
    let start = problem.start();
    let (response, difference) = Response::of(model, run, noise)?;
    // Most of the way is linear.
    let mut begin = start.clone();
    if let Some(step) = response.step(&difference) {
        for (x, step) in begin.iter_mut().zip(step.iter()) {
            *x += step.clamp(-LONGEST_STEP, LONGEST_STEP);
        }
        problem.clamp(&mut begin);
    }
    let mut out = vec![0.0; problem.residual_len()];
    let begins_well = problem.residual(&begin, &mut out)
        && out.iter().map(|value| value * value).sum::<f64>() <= difference.norm_squared();
    let options = Options {
        most_iterations: 12,
        relative_cost: 1e-2,
        longest_step: LONGEST_STEP,
        ..Options::thrifty()
    };
    let from = if begins_well { &begin } else { &start };
    Some(minimise(&mut problem, from, options)?.cost)
}

/// The model with its events at every place of their grids; the model alone where it has none.
fn places(model: &Model, run: &Scenario) -> Vec<Model> {
    let length_s = run.sample_time_s.last().copied().unwrap_or(0.0) - run.begin_s();
    let mut places = vec![model.clone()];
    for slot in model.free_slots() {
        if !slot.has_role(ParameterRole::EventTime) {
            continue;
        }
        let Slot::Effect { spec, .. } = &slot else {
            continue;
        };
        places = places
            .iter()
            .flat_map(|place| {
                spec.shapes.iter().map(|share| {
                    let mut there = place.clone();
                    there.set(&slot, share * length_s);
                    there
                })
            })
            .collect();
    }
    places
}

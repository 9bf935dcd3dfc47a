//! Levenberg-Marquardt (Marquardt 1963) for a least-squares problem whose residual is a simulation: forward differences where
//! no column of the Jacobian is given, Marquardt scaling, clipped steps, and optional rank-one updates of the Jacobian
//! (Broyden 1965; Dennis and Schnabel 1983, section 8.1).

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// A residual vector as a function of a few parameters, each scaled so that a step of one is large.
pub trait Problem: Sync {
    /// Writes the residual at `x`; returns false where it cannot be evaluated. Called from several threads.
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool;
    fn residual_len(&self) -> usize;
    fn difference_step(&self, index: usize) -> f64;
    fn clamp(&self, x: &mut [f64]);
    /// For each parameter its column of the Jacobian at `x`, where the problem computes it without differences.
    fn slopes(&self, x: &[f64]) -> Vec<Option<Vec<f64>>> {
        vec![None; x.len()]
    }
    /// Whether the search has to end here, converged or not: its budget is used up.
    fn is_spent(&self) -> bool {
        false
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub most_iterations: usize,
    /// Stops when the cost falls by less than this share.
    pub relative_cost: f64,
    pub longest_step: f64,
    /// Updates the Jacobian by Broyden's rank-one corrections and computes differences again only where a step gains little.
    /// Saves most of the simulations; the Jacobian at the end is then approximate.
    pub carry_jacobian: bool,
    /// Several searches run in parallel: computes the differences of a residual longer than 200,000 one after the other, so
    /// that the Jacobians of all searches are not in memory at the same time.
    pub one_of_many: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            most_iterations: 25,
            relative_cost: 1e-7,
            longest_step: 1.5,
            carry_jacobian: false,
            one_of_many: false,
        }
    }
}

impl Options {
    /// For the comparison of many candidates: a relative cost of 1e-4 does not change their order.
    pub const fn thrifty() -> Self {
        Self {
            most_iterations: 15,
            relative_cost: 1e-4,
            longest_step: 1.5,
            carry_jacobian: true,
            one_of_many: true,
        }
    }
}

#[derive(Clone, Debug)]
pub struct Minimum {
    pub x: Vec<f64>,
    pub cost: f64,
    pub residual: Vec<f64>,
    /// Residual by parameter, `n x k`, at `x`; zero without iterations.
    pub jacobian: DMatrix<f64>,
    pub iterations: usize,
    pub converged: bool,
}

/// Minimises the sum of squares from `start`; `None` when the residual cannot be evaluated there.
pub fn minimise(problem: &impl Problem, start: &[f64], options: Options) -> Option<Minimum> {
    let mut search = Search::at(problem, start)?;
    let (mut iterations, mut converged) = (0, start.is_empty());
    let in_parallel = !options.one_of_many || problem.residual_len() <= 200_000;
    if options.most_iterations > 0 {
        search.jacobian = differences(problem, &search.x, &search.residual, in_parallel);
    }
    // Whether the Jacobian is that of differences at the present point.
    let mut exact = true;
    while iterations < options.most_iterations && !converged && !problem.is_spent() {
        iterations += 1;
        let before = search.cost;
        let normal = search.jacobian.tr_mul(&search.jacobian);
        let gradient = search.jacobian.tr_mul(&DVector::from_column_slice(&search.residual));
        // Where even a linear problem would gain nothing, no step is tried.
        let can_gain = predicted(&normal, &gradient) > 0.3 * options.relative_cost * before;
        let trials = if exact { 8 } else { 2 };
        let step =
            can_gain.then(|| search.step(problem, options, (&normal, &gradient), trials)).flatten();
        let gained = before - search.cost;
        let small = gained <= options.relative_cost * before;
        if small && !exact {
            // With an updated Jacobian a small gain may come from its own error.
            search.jacobian = differences(problem, &search.x, &search.residual, in_parallel);
            exact = true;
            continue;
        }
        let Some(step) = step else {
            // Where the predicted reduction is large and no step reaches it, the Jacobian is wrong or the residual is not smooth: no
            // minimum. A gain of a quarter of a mean square moves no parameter by more than half of its standard deviation and is
            // negligible: with stick-slip a fit usually ends a tenth of a standard deviation from its minimum.
            let within = search.predicted_within_bounds(problem, &normal, &gradient);
            let negligible = 0.25 / search.residual.len().max(1) as f64;
            converged = within <= options.relative_cost.max(negligible) * before;
            break;
        };
        converged = small;
        let worthwhile = gained > 0.3 * before;
        if options.carry_jacobian && (converged || worthwhile) {
            search.correct(&step);
            exact = false;
        } else {
            search.jacobian = differences(problem, &search.x, &search.residual, in_parallel);
            exact = true;
        }
    }
    Some(Minimum {
        x: search.x,
        cost: search.cost,
        residual: search.residual,
        jacobian: search.jacobian,
        iterations,
        converged,
    })
}

/// Predicted reduction: of the cost by a Gauss-Newton step if the residual were linear; infinite where the normal matrix has no
/// inverse.
fn predicted(normal: &DMatrix<f64>, gradient: &DVector<f64>) -> f64 {
    let mut damped = normal.clone();
    for index in 0..gradient.len() {
        damped[(index, index)] += 1e-9 * normal[(index, index)] + 1e-300;
    }
    damped.cholesky().map_or(f64::INFINITY, |factor| gradient.dot(&factor.solve(gradient)))
}

/// The change of a step and the residual before it.
struct Step {
    change: Vec<f64>,
    residual_before: Vec<f64>,
}

struct Search {
    x: Vec<f64>,
    residual: Vec<f64>,
    cost: f64,
    jacobian: DMatrix<f64>,
    damping: f64,
    trial: Vec<f64>,
    trial_residual: Vec<f64>,
}

impl Search {
    fn at(problem: &impl Problem, start: &[f64]) -> Option<Self> {
        let mut x = start.to_vec();
        problem.clamp(&mut x);
        let mut residual = vec![0.0; problem.residual_len()];
        if !problem.residual(&x, &mut residual) {
            return None;
        }
        Some(Self {
            cost: sum_of_squares(&residual),
            jacobian: DMatrix::zeros(residual.len(), x.len()),
            damping: 1e-3,
            trial: x.clone(),
            trial_residual: vec![0.0; residual.len()],
            x,
            residual,
        })
    }

    /// One step downhill, with more damping at each of `trials`; `None` where none was found.
    fn step(
        &mut self,
        problem: &impl Problem,
        options: Options,
        (normal, gradient): (&DMatrix<f64>, &DVector<f64>),
        trials: usize,
    ) -> Option<Step> {
        for _ in 0..trials {
            let mut damped = normal.clone();
            for index in 0..self.x.len() {
                // A parameter without any influence keeps its value instead of making the matrix singular.
                damped[(index, index)] +=
                    self.damping * normal[(index, index)] + 1e-12 * normal.trace().max(1e-300);
            }
            if let Some(factor) = damped.cholesky() {
                let step = factor.solve(gradient);
                for (index, value) in self.trial.iter_mut().enumerate() {
                    *value = self.x[index]
                        - step[index].clamp(-options.longest_step, options.longest_step);
                }
                problem.clamp(&mut self.trial);
                if problem.residual(&self.trial, &mut self.trial_residual) {
                    let cost = sum_of_squares(&self.trial_residual);
                    if cost < self.cost {
                        self.cost = cost;
                        std::mem::swap(&mut self.x, &mut self.trial);
                        std::mem::swap(&mut self.residual, &mut self.trial_residual);
                        self.damping = (self.damping * 0.1).max(1e-9);
                        // After the swaps the trial vectors are the earlier point and residual.
                        return Some(Step {
                            change: self.x.iter().zip(&self.trial).map(|(x, y)| x - y).collect(),
                            residual_before: self.trial_residual.clone(),
                        });
                    }
                }
            }
            self.damping = (self.damping * 10.0).min(1e9);
        }
        None
    }

    /// The predicted reduction by those parameters that are not at a bound which the gradient points to.
    fn predicted_within_bounds(
        &self,
        problem: &impl Problem,
        normal: &DMatrix<f64>,
        gradient: &DVector<f64>,
    ) -> f64 {
        let is_free = |index: &usize| {
            let mut moved = self.x.clone();
            moved[*index] -= problem.difference_step(*index).copysign(gradient[*index]);
            let unclamped = moved[*index];
            problem.clamp(&mut moved);
            (moved[*index] - unclamped).abs() < 1e-12
        };
        let free: Vec<usize> = (0..self.x.len()).filter(is_free).collect();
        predicted(&normal.select_rows(&free).select_columns(&free), &gradient.select_rows(&free))
    }

    /// Broyden's update: the smallest change of the Jacobian that predicts the last change of the residual, by the secant
    /// equation `J dx = dr`.
    fn correct(&mut self, step: &Step) {
        let change = DVector::from_column_slice(&step.change);
        let square: f64 = step.change.iter().map(|dx| dx * dx).sum();
        if square <= 0.0 {
            return;
        }
        let predicted = &self.jacobian * &change;
        let error = DVector::from_fn(self.residual.len(), |row, _| {
            (self.residual[row] - step.residual_before[row] - predicted[row]) / square
        });
        self.jacobian.ger(1.0, &error, &change, 1.0);
    }
}

/// The Jacobian, by forward differences where the problem does not give a column; a difference that cannot be evaluated forwards
/// is taken backwards, else the column is zero. The result is the same for any number of threads.
pub fn jacobian_at(problem: &impl Problem, x: &[f64], residual: &[f64]) -> DMatrix<f64> {
    differences(problem, x, residual, true)
}

fn differences(
    problem: &impl Problem,
    x: &[f64],
    residual: &[f64],
    in_parallel: bool,
) -> DMatrix<f64> {
    let mut jacobian = DMatrix::zeros(residual.len(), x.len());
    if residual.is_empty() {
        return jacobian;
    }
    let given = problem.slopes(x);
    let fill = |(index, column): (usize, &mut [f64])| match &given[index] {
        Some(slope) => column.copy_from_slice(slope),
        None => difference(problem, x, residual, index, column),
    };
    let (cells, rows) = (jacobian.as_mut_slice(), residual.len());
    if in_parallel {
        cells.par_chunks_mut(rows).enumerate().for_each(fill);
    } else {
        cells.chunks_mut(rows).enumerate().for_each(fill);
    }
    jacobian
}

/// One column of the Jacobian into `column`, which is zero.
fn difference(
    problem: &impl Problem,
    x: &[f64],
    residual: &[f64],
    index: usize,
    column: &mut [f64],
) {
    let mut moved = x.to_vec();
    let size = problem.difference_step(index);
    for step in [size, -size] {
        moved[index] = x[index] + step;
        let mut clamped = moved.clone();
        problem.clamp(&mut clamped);
        let inside = (clamped[index] - moved[index]).abs() < 1e-12;
        if inside && problem.residual(&moved, column) {
            for (value, before) in column.iter_mut().zip(residual) {
                *value = (*value - before) / step;
            }
            return;
        }
    }
    column.fill(0.0);
}

fn sum_of_squares(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Decaying exponential with gain and rate.
    struct Decay {
        data: Vec<f64>,
        can_evaluate: bool,
        has_wrong_slopes: bool,
    }

    impl Problem for Decay {
        fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
            for (k, cell) in out.iter_mut().enumerate() {
                *cell = x[0] * (-x[1].exp() * k as f64).exp() - self.data[k];
            }
            self.can_evaluate && out.iter().all(|value| value.is_finite())
        }

        fn residual_len(&self) -> usize {
            self.data.len()
        }

        fn difference_step(&self, _index: usize) -> f64 {
            1e-6
        }

        fn clamp(&self, x: &mut [f64]) {
            x[0] = x[0].clamp(0.0, 10.0);
        }

        fn slopes(&self, x: &[f64]) -> Vec<Option<Vec<f64>>> {
            let uphill = |slope: f64| self.has_wrong_slopes.then(|| vec![slope; self.data.len()]);
            [-1.0, 0.0].map(uphill)[..x.len()].to_vec()
        }
    }

    fn decay(gain: f64) -> Decay {
        let data = (0..30).map(|k| gain * (-0.2 * f64::from(k)).exp());
        Decay { data: data.collect(), can_evaluate: true, has_wrong_slopes: false }
    }

    #[test]
    fn gain_and_rate_are_found_also_with_a_carried_jacobian() {
        let mut thrifty = Options::thrifty();
        thrifty.relative_cost = 1e-9;
        for (start, options, within) in
            [([0.3, 0.5f64.ln()], Options::default(), 1e-6), ([2.0, 0.25f64.ln()], thrifty, 1e-4)]
        {
            let minimum = minimise(&decay(3.0), &start, options).unwrap();
            let off = [minimum.x[0] - 3.0, minimum.x[1].exp() - 0.2];
            assert!(off.iter().all(|off| off.abs() < within), "{minimum:?}");
            assert!(minimum.cost < within, "{minimum:?}");
            assert!(minimum.converged || options.carry_jacobian, "{minimum:?}");
        }
    }

    #[test]
    fn a_search_stays_within_bounds_and_reports_where_it_fails() {
        let options = Options { most_iterations: 1000, ..Options::default() };
        let minimum = minimise(&decay(30.0), &[1.0, -3.0], options).unwrap();
        assert!(minimum.x[0] <= 10.0 && minimum.converged, "{minimum:?}");
        let mut problem = decay(3.0);
        problem.has_wrong_slopes = true;
        let minimum = minimise(&problem, &[0.3, 0.2f64.ln()], Options::default()).unwrap();
        assert!(!minimum.converged && minimum.cost > 1.0, "{minimum:?}");
        problem.can_evaluate = false;
        assert!(minimise(&problem, &[1.0, -3.0], Options::default()).is_none());
    }
}

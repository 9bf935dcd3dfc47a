//! Levenberg-Marquardt for a least-squares problem whose residual is a simulation: forward differences, Marquardt
//! scaling, and a step that is clipped so that one bad direction cannot throw the simulation out of its range.

use nalgebra::{DMatrix, DVector};

/// A residual vector as a function of a few parameters, each scaled so that a step of one is large.
pub trait Problem {
    /// Writes the residual at `x`; returns false where it cannot be evaluated.
    fn residual(&mut self, x: &[f64], out: &mut [f64]) -> bool;
    fn residual_len(&self) -> usize;
    /// Forward-difference step of parameter `index`.
    fn difference_step(&self, index: usize) -> f64;
    /// Keeps `x` within its bounds.
    fn clamp(&self, x: &mut [f64]);
}

#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub most_iterations: usize,
    /// Stops when the cost falls by less than this share.
    pub relative_cost: f64,
    /// Longest step of one parameter.
    pub longest_step: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            most_iterations: 25,
            relative_cost: 1e-7,
            longest_step: 1.5,
        }
    }
}

/// Where the search ended.
#[derive(Clone, Debug)]
pub struct Minimum {
    pub x: Vec<f64>,
    /// Sum of squares of the residual.
    pub cost: f64,
    pub residual: Vec<f64>,
    /// Residual by parameter, `n x k`, at `x`.
    pub jacobian: DMatrix<f64>,
    pub iterations: usize,
    pub converged: bool,
}

/// Minimises the sum of squares from `start`; `None` when the residual cannot be evaluated there.
pub fn minimise(problem: &mut impl Problem, start: &[f64], options: Options) -> Option<Minimum> {
    let n = problem.residual_len();
    let mut x = start.to_vec();
    problem.clamp(&mut x);
    let mut residual = vec![0.0; n];
    if !problem.residual(&x, &mut residual) {
        return None;
    }
    let mut cost = sum_of_squares(&residual);
    let mut damping = 1e-3;
    let (mut trial, mut trial_residual) = (x.clone(), vec![0.0; n]);
    let mut jacobian = jacobian_at(problem, &x, &residual);
    let (mut iterations, mut converged) = (0, x.is_empty());
    while iterations < options.most_iterations && !converged {
        iterations += 1;
        let normal = jacobian.tr_mul(&jacobian);
        let gradient = jacobian.tr_mul(&DVector::from_column_slice(&residual));
        let before = cost;
        let mut improved = false;
        for _ in 0..8 {
            let mut damped = normal.clone();
            for index in 0..x.len() {
                // A parameter without any influence keeps its value instead of making the matrix singular.
                damped[(index, index)] +=
                    damping * normal[(index, index)] + 1e-12 * normal.trace().max(1e-300);
            }
            if let Some(factor) = damped.cholesky() {
                let step = factor.solve(&gradient);
                for (index, value) in trial.iter_mut().enumerate() {
                    *value =
                        x[index] - step[index].clamp(-options.longest_step, options.longest_step);
                }
                problem.clamp(&mut trial);
                if problem.residual(&trial, &mut trial_residual) {
                    let there = sum_of_squares(&trial_residual);
                    if there < cost {
                        cost = there;
                        std::mem::swap(&mut x, &mut trial);
                        std::mem::swap(&mut residual, &mut trial_residual);
                        damping = (damping * 0.1).max(1e-9);
                        improved = true;
                        break;
                    }
                }
            }
            damping = (damping * 10.0).min(1e9);
        }
        converged = !improved || before - cost <= options.relative_cost * before;
        if improved {
            jacobian = jacobian_at(problem, &x, &residual);
        }
    }
    Some(Minimum {
        x,
        cost,
        residual,
        jacobian,
        iterations,
        converged,
    })
}

/// Forward-difference Jacobian; a direction that cannot be evaluated forwards is tried backwards, else it is zero.
pub fn jacobian_at(problem: &mut impl Problem, x: &[f64], residual: &[f64]) -> DMatrix<f64> {
    let mut jacobian = DMatrix::zeros(residual.len(), x.len());
    let mut moved = x.to_vec();
    let mut there = vec![0.0; residual.len()];
    for index in 0..x.len() {
        for step in [
            problem.difference_step(index),
            -problem.difference_step(index),
        ] {
            moved[index] = x[index] + step;
            let mut clamped = moved.clone();
            problem.clamp(&mut clamped);
            let inside = (clamped[index] - moved[index]).abs() < 1e-12;
            if inside && problem.residual(&moved, &mut there) {
                for (row, value) in jacobian.column_mut(index).iter_mut().enumerate() {
                    *value = (there[row] - residual[row]) / step;
                }
                break;
            }
        }
        moved[index] = x[index];
    }
    jacobian
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
    }

    impl Problem for Decay {
        fn residual(&mut self, x: &[f64], out: &mut [f64]) -> bool {
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
    }

    fn decay() -> Decay {
        Decay {
            data: (0..30).map(|k| 3.0 * (-0.2 * f64::from(k)).exp()).collect(),
            can_evaluate: true,
        }
    }

    #[test]
    fn recovers_gain_and_rate_from_far_away() {
        let minimum = minimise(&mut decay(), &[0.3, 0.5f64.ln()], Options::default()).unwrap();
        assert!(
            (minimum.x[0] - 3.0).abs() < 1e-6 && (minimum.x[1].exp() - 0.2).abs() < 1e-6,
            "{minimum:?}"
        );
        assert!(minimum.converged && minimum.cost < 1e-10);
    }

    #[test]
    fn stays_within_bounds_and_says_so_when_nothing_can_be_evaluated() {
        let mut bounded = Decay {
            data: vec![50.0; 30],
            can_evaluate: true,
        };
        let minimum = minimise(&mut bounded, &[1.0, -3.0], Options::default()).unwrap();
        assert!(minimum.x[0] <= 10.0);
        let mut broken = Decay {
            can_evaluate: false,
            ..decay()
        };
        assert!(minimise(&mut broken, &[1.0, -3.0], Options::default()).is_none());
    }
}

//! Recursive least squares as the textbook and paper A print it: the reference beside the factored, guarded form.
//!
//! `K = P psi / (lambda + psi' P psi)`, `P <- (P - K psi' P) / lambda` (Ljung and Soderstrom, *Theory and Practice of
//! Recursive Identification* (1983), section 2.2). It winds up without excitation and may lose positivity: for
//! comparison only.

/// Exponential memory in `N` parameters, nothing guarded.
#[derive(Clone, Debug)]
pub struct PlainRecursiveLeastSquares<const N: usize> {
    forgetting: f64,
    parameters: [f64; N],
    p: [[f64; N]; N],
}

impl<const N: usize> PlainRecursiveLeastSquares<N> {
    /// `prior`: the variances of the parameters before any data, in units of the noise variance.
    pub fn new(start: [f64; N], prior: f64, forgetting: f64) -> Self {
        Self {
            forgetting,
            parameters: start,
            p: std::array::from_fn(|i| std::array::from_fn(|j| if i == j { prior } else { 0.0 })),
        }
    }

    /// Takes one row and returns the innovation.
    pub fn update(&mut self, psi: &[f64; N], value: f64) -> f64 {
        let p_psi: [f64; N] = std::array::from_fn(|i| dot(&self.p[i], psi));
        let innovation = value - dot(psi, &self.parameters);
        let over = 1.0 / (self.forgetting + dot(psi, &p_psi));
        let growth = 1.0 / self.forgetting;
        for (i, (parameter, row)) in self.parameters.iter_mut().zip(&mut self.p).enumerate() {
            let gain = p_psi[i] * over;
            *parameter += gain * innovation;
            for (cell, other) in row.iter_mut().zip(&p_psi) {
                *cell = (*cell - gain * other) * growth;
            }
        }
        innovation
    }

    pub fn parameters(&self) -> [f64; N] {
        self.parameters
    }
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::numerics::recursive_least_squares::RecursiveLeastSquares;

    #[test]
    fn equals_the_factored_form_where_no_guard_steps_in() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut plain = PlainRecursiveLeastSquares::new([0.0; 4], 1e4, 0.97);
        let mut factored = RecursiveLeastSquares::new([0.0; 4], [1.0; 4], 1e4, 0.97);
        for row in 0..200 {
            let psi: [f64; 4] = std::array::from_fn(|_| random.random_range(-1.0..1.0));
            let value = dot(&psi, &[2.0, -1.0, 0.5, 3.0]) + random.random_range(-0.1..0.1);
            plain.update(&psi, value);
            factored.update(&psi, value).unwrap();
            // The guarded form forgets nothing before every parameter has learnt something.
            if row > 100 {
                for (a, b) in plain.parameters().iter().zip(factored.parameters()) {
                    assert!((a - b).abs() < 2e-3, "{row} {a} {b}");
                }
            }
        }
    }

    #[test]
    fn winds_up_without_excitation_which_is_why_it_is_not_the_default() {
        let mut plain = PlainRecursiveLeastSquares::new([0.0; 2], 1e4, 0.97);
        for _ in 0..3000 {
            plain.update(&[1.0, 0.0], 2.0);
        }
        assert!(plain.p[1][1] > 1e20, "{}", plain.p[1][1]);
    }
}

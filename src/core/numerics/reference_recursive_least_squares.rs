//! Recursive least squares as paper A prints it, eq. (7)-(9): the plain covariance, kept to compare with.
//!
//! With forgetting below one and rows that excite only some directions its covariance grows without bound (wind-up), and
//! in floating point it loses its symmetry. The estimators of the program use [`super::recursive_least_squares`].

/// Least squares with exponential forgetting in `N` parameters, the textbook form.
#[derive(Clone, Debug)]
pub struct ReferenceRecursiveLeastSquares<const N: usize> {
    forgetting: f64,
    parameters: [f64; N],
    covariance: [[f64; N]; N],
}

impl<const N: usize> ReferenceRecursiveLeastSquares<N> {
    /// `prior`: variance of each parameter before any data, in units of the noise variance.
    pub fn new(start: [f64; N], prior: [f64; N], forgetting: f64) -> Self {
        Self {
            forgetting,
            parameters: start,
            covariance: std::array::from_fn(|row| {
                std::array::from_fn(|column| if row == column { prior[row] } else { 0.0 })
            }),
        }
    }

    /// Takes one row and returns the innovation.
    pub fn update(&mut self, regressor: &[f64; N], value: f64) -> f64 {
        // x: regressor, k: gain, P: covariance, beta: forgetting, as in eq. (7)-(9).
        let p_x: [f64; N] = std::array::from_fn(|row| dot(&self.covariance[row], regressor));
        let denominator = self.forgetting + dot(regressor, &p_x);
        let innovation = value - dot(regressor, &self.parameters);
        for (parameter, along) in self.parameters.iter_mut().zip(&p_x) {
            *parameter += along / denominator * innovation;
        }
        let x_p: [f64; N] = std::array::from_fn(|column| {
            (0..N)
                .map(|row| regressor[row] * self.covariance[row][column])
                .sum()
        });
        for (line, along) in self.covariance.iter_mut().zip(&p_x) {
            for (cell, across) in line.iter_mut().zip(&x_p) {
                *cell = (*cell - along * across / denominator) / self.forgetting;
            }
        }
        innovation
    }

    pub fn parameters(&self) -> [f64; N] {
        self.parameters
    }

    /// Variance of a parameter in units of the noise variance.
    pub fn variance(&self, parameter: usize) -> f64 {
        self.covariance[parameter][parameter]
    }
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::numerics::recursive_least_squares::RecursiveLeastSquares;

    const TRUE: [f64; 3] = [2.0, -0.5, 7.0];

    struct Both {
        plain: ReferenceRecursiveLeastSquares<3>,
        factored: RecursiveLeastSquares<3>,
        random: ChaCha8Rng,
    }

    impl Both {
        fn new(forgetting: f64) -> Self {
            Self {
                plain: ReferenceRecursiveLeastSquares::new([0.0; 3], [1e6; 3], forgetting),
                factored: RecursiveLeastSquares::new([0.0; 3], [1.0; 3], 1e6, forgetting),
                random: ChaCha8Rng::seed_from_u64(5),
            }
        }

        fn take(&mut self, row: [f64; 3]) {
            let value = dot(&row, &TRUE) + 0.1 * self.random.sample::<f64, _>(StandardNormal);
            let plain = self.plain.update(&row, value);
            let factored = self.factored.update(&row, value).unwrap();
            assert!(plain.is_finite() && factored.is_finite());
        }

        fn rich(&mut self) {
            let row = std::array::from_fn(|_| self.random.random_range(-1.0..1.0));
            self.take(row);
        }

        fn errors(&self) -> [f64; 2] {
            [self.plain.parameters(), self.factored.parameters()].map(|found| {
                found
                    .iter()
                    .zip(TRUE)
                    .map(|(value, truth)| (value - truth).abs())
                    .fold(0.0, f64::max)
            })
        }
    }

    #[test]
    fn both_forms_agree_on_rich_rows_with_and_without_forgetting() {
        for forgetting in [1.0, 0.97] {
            let mut both = Both::new(forgetting);
            for _ in 0..800 {
                both.rich();
            }
            let (plain, factored) = (both.plain.parameters(), both.factored.parameters());
            for (one, other) in plain.iter().zip(factored) {
                assert!((one - other).abs() < 1e-7, "{forgetting} {one} {other}");
            }
            assert!(both.errors()[0] < 0.1);
        }
    }

    #[test]
    fn rows_of_one_direction_wind_the_plain_form_up_and_not_the_gated_one() {
        let mut both = Both::new(0.97);
        for _ in 0..300 {
            both.rich();
        }
        let settled = both.plain.variance(2);
        for _ in 0..1000 {
            both.take([1.0, 0.0, 0.0]);
        }
        assert!(both.plain.variance(2) > 1e6 * settled);
        assert!(both.factored.ignorance(2) < 1e-5);
        // The first row that moves again, a disturbed one, throws the plain estimate away.
        let row = [0.0, 0.1, 0.1];
        let value = dot(&row, &TRUE) + 5.0;
        both.plain.update(&row, value);
        both.factored.update(&row, value);
        let (plain, gated) = (both.plain.parameters(), both.factored.parameters());
        assert!((plain[2] - TRUE[2]).abs() > 10.0, "{plain:?}");
        assert!((gated[2] - TRUE[2]).abs() < 0.5, "{gated:?}");
    }
}

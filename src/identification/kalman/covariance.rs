//! State and covariance of the filter: eight numbers, fixed size, no allocation.
//!
//! The covariance stays symmetric because both halves are written from one value, and positive because the update is in
//! Joseph's form (Bucy and Joseph, *Filtering for Stochastic Processes*, 1968): `P = (I - K h)P(I - K h)' + K r K'`.

/// Number of states.
pub(super) const N: usize = 8;
/// Current, A.
pub(super) const I: usize = 0;
/// Speed, rad/s.
pub(super) const W: usize = 1;
/// Logarithms of resistance, inductance, back-EMF constant, inertia.
pub(super) const R: usize = 2;
pub(super) const L: usize = 3;
pub(super) const KE: usize = 4;
pub(super) const J: usize = 5;
/// Coulomb torque, always against the motion, N.m.
pub(super) const MC: usize = 6;
/// Load torque of the process, positive against positive speed, N.m.
pub(super) const TL: usize = 7;

#[derive(Clone, Copy, Debug)]
pub(super) struct Belief {
    pub(super) x: [f64; N],
    pub(super) p: [[f64; N]; N],
}

impl Belief {
    pub(super) const fn new(x: [f64; N]) -> Self {
        Self {
            x,
            p: [[0.0; N]; N],
        }
    }

    /// Variance of one state, forgetting what it had in common with the others.
    pub(super) fn forget(&mut self, state: usize, variance: f64) {
        for other in 0..N {
            self.p[state][other] = 0.0;
            self.p[other][state] = 0.0;
        }
        self.p[state][state] = variance;
    }

    /// Time update: `rows` are the derivatives of the new current and speed to every state; the others stay.
    pub(super) fn propagate(&mut self, mean: [f64; 2], rows: &[[f64; N]; 2]) {
        let fp: [[f64; N]; 2] = std::array::from_fn(|k| {
            std::array::from_fn(|column| (0..N).map(|m| rows[k][m] * self.p[m][column]).sum())
        });
        let inner = |k: usize, m: usize| -> f64 { (0..N).map(|n| fp[k][n] * rows[m][n]).sum() };
        let (p00, p01, p11) = (inner(0, 0), inner(0, 1), inner(1, 1));
        for (k, row) in fp.iter().enumerate() {
            for (column, value) in row.iter().enumerate().skip(2) {
                self.p[k][column] = *value;
                self.p[column][k] = *value;
            }
        }
        self.p[0][0] = p00;
        self.p[0][1] = p01;
        self.p[1][0] = p01;
        self.p[1][1] = p11;
        self.x[I] = mean[0];
        self.x[W] = mean[1];
    }

    /// Adds `q g g'` for the states I, W, TL.
    pub(super) fn disturb(&mut self, g: [f64; 3], q: f64) {
        const AT: [usize; 3] = [I, W, TL];
        for k in 0..3 {
            for m in 0..3 {
                self.p[AT[k]][AT[m]] += q * g[k] * g[m];
            }
        }
    }

    /// Measurement of one state with noise variance `r`; `limit` bounds the step of each state.
    pub(super) fn measure(&mut self, state: usize, innovation: f64, r: f64, limit: &[f64; N]) {
        let variance = self.p[state][state] + r;
        if variance <= 0.0 {
            return;
        }
        let gain: [f64; N] = std::array::from_fn(|k| self.p[k][state] / variance);
        let row = self.p[state];
        // (I - K h) P, then (..)(I - K h)' + K r K'.
        let left: [[f64; N]; N] =
            std::array::from_fn(|k| std::array::from_fn(|m| self.p[k][m] - gain[k] * row[m]));
        for k in 0..N {
            for m in 0..=k {
                let value = left[k][m] - left[k][state] * gain[m] + r * gain[k] * gain[m];
                self.p[k][m] = value;
                self.p[m][k] = value;
            }
        }
        for k in 0..N {
            self.x[k] += (gain[k] * innovation).clamp(-limit[k], limit[k]);
        }
    }

    pub(super) fn is_sound(&self) -> bool {
        self.x.iter().all(|x| x.is_finite())
            && (0..N).all(|k| self.p[k][k].is_finite() && self.p[k][k] >= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Whatever is measured in whatever order, the covariance stays symmetric and positive.
        #[test]
        fn the_covariance_stays_a_covariance(
            steps in proptest::collection::vec((0_usize..2, -12.0_f64..0.0, proptest::array::uniform8(-1.0_f64..1.0)), 1..60)
        ) {
            let mut belief = Belief::new([0.0; N]);
            for k in 0..N {
                belief.p[k][k] = 10f64.powi(2 - i32::try_from(k).unwrap());
            }
            // Rounding is relative to the largest covariance that was ever there.
            let mut largest = 0.0_f64;
            for (state, exponent, row) in steps {
                let mut rows = [row, row];
                rows[1][0] = -row[1];
                rows[1][5] = 0.3;
                belief.propagate([0.0; 2], &rows);
                largest = largest.max((0..N).map(|k| belief.p[k][k]).sum());
                belief.measure(state, 0.1, 10f64.powf(exponent), &[f64::INFINITY; N]);
                let matrix = nalgebra::SMatrix::<f64, N, N>::from_fn(|k, m| belief.p[k][m]);
                prop_assert!((matrix - matrix.transpose()).abs().max() <= 0.0);
                let least = matrix.symmetric_eigenvalues().min();
                largest = largest.max(matrix.trace());
                prop_assert!(least > -1e-12 * largest, "{}", least);
                prop_assert!(belief.is_sound());
            }
        }
    }

    #[test]
    fn two_measurements_of_one_state_average_by_their_variances() {
        let mut belief = Belief::new([0.0; N]);
        belief.p[I][I] = 1e12;
        for (value, variance) in [(1.0, 1.0), (3.0, 3.0)] {
            belief.measure(I, value - belief.x[I], variance, &[f64::INFINITY; N]);
        }
        assert!((belief.x[I] - 1.5).abs() < 1e-9, "{}", belief.x[I]);
        assert!((belief.p[I][I] - 0.75).abs() < 1e-9);
    }
}

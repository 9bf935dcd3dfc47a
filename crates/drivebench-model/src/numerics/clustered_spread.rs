//! Recursive cluster-robust (sandwich) covariance over blocks of time, with the gains of the recursion.
//!
//! White noise makes `Q <- A Q A' + K K'`, `A = I - K psi'`. Where the errors of neighbouring rows are correlated (a missing
//! effect, a wrong stamp, a parameter that changed) that is far too small. Here the contributions `K e` of the rows of one
//! block are added up before they are squared (Liang and Zeger, *Biometrika* 73, 1986, for the batch form).

#[derive(Clone, Debug)]
pub(super) struct ClusteredSpread<const N: usize> {
    /// Error of the estimate from the rows of the block that is not complete yet.
    open: [f64; N],
    rows: u32,
    /// Covariance from the complete blocks.
    closed: [[f64; N]; N],
}

impl<const N: usize> ClusteredSpread<N> {
    pub(super) const fn new() -> Self {
        Self { open: [0.0; N], rows: 0, closed: [[0.0; N]; N] }
    }

    /// One row with its gain and its residual after the update. Blocks have 25 rows.
    pub(super) fn take(&mut self, psi: &[f64; N], gain: &[f64; N], residual: f64) {
        // open <- A open + K e, closed <- A closed A'.
        let psi_open: f64 = (0..N).map(|j| psi[j] * self.open[j]).sum();
        for (open, gain) in self.open.iter_mut().zip(gain) {
            *open += gain * (residual - psi_open);
        }
        let q_psi: [f64; N] =
            std::array::from_fn(|i| (0..N).map(|j| self.closed[i][j] * psi[j]).sum());
        let psi_q_psi: f64 = (0..N).map(|j| psi[j] * q_psi[j]).sum();
        for i in 0..N {
            for j in 0..N {
                self.closed[i][j] +=
                    psi_q_psi * gain[i] * gain[j] - gain[i] * q_psi[j] - q_psi[i] * gain[j];
            }
        }
        self.rows += 1;
        if self.rows >= 25 {
            for i in 0..N {
                for j in 0..N {
                    self.closed[i][j] += self.open[i] * self.open[j];
                }
            }
            self.open = [0.0; N];
            self.rows = 0;
        }
    }

    /// Variance of a parameter, the open block included.
    pub(super) fn variance(&self, parameter: usize) -> f64 {
        self.closed[parameter][parameter].max(0.0) + self.open[parameter].powi(2)
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use crate::numerics::recursive_least_squares::RecursiveLeastSquares;

    /// Root mean square error over the stated standard deviation, over seeds; `alike`: consecutive rows with the same error.
    fn error_over_stated(alike: usize, clustered: bool) -> f64 {
        let (mut squares, mut variances) = (0.0, 0.0);
        for seed in 0..200 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut rls = RecursiveLeastSquares::new([0.0], [1.0], 1e9, 0.995);
            if clustered {
                rls = rls.clustered();
            }
            let mut error = 0.0;
            for row in 0..800 {
                if row % alike == 0 {
                    error = random.random_range(-1.0..1.0);
                }
                rls.update(&[1.0], 3.0 + error);
            }
            squares += (rls.parameters()[0] - 3.0_f64).powi(2);
            variances += rls.standard_deviations().unwrap()[0].powi(2);
        }
        (squares / variances).sqrt()
    }

    #[test]
    fn correlated_errors_widen_the_deviation_and_white_ones_hardly() {
        let white = error_over_stated(1, true);
        assert!((0.8..1.1).contains(&white), "{white}");
        assert!(error_over_stated(12, false) > 2.5);
        let correlated = error_over_stated(12, true);
        assert!((0.7..1.25).contains(&correlated), "{correlated}");
    }
}

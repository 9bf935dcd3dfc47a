//! Covariance of a recursive estimate whose errors are alike from row to row: the sandwich of time blocks, propagated
//! with the gains that were really used.
//!
//! White noise makes `Q <- A Q A' + K K'`, `A = I - K psi'`. Where neighbouring rows err together (a missing effect, a
//! stamp that is off, a parameter that changed) that is far too small. Here the contributions `K e` of the rows of one
//! block are added up before they are squared (Liang and Zeger, *Biometrika* 73, 1986, for the batch form).

/// Rows of one block.
const BLOCK_ROWS: u32 = 25;

#[derive(Clone, Debug)]
pub(super) struct ClusteredSpread<const N: usize> {
    /// Error that the rows of the open block have made.
    open: [f64; N],
    rows: u32,
    closed: [[f64; N]; N],
}

impl<const N: usize> ClusteredSpread<N> {
    pub(super) const fn new() -> Self {
        Self {
            open: [0.0; N],
            rows: 0,
            closed: [[0.0; N]; N],
        }
    }

    /// One row with its gain and what it misses its value by after the update.
    pub(super) fn take(&mut self, psi: &[f64; N], gain: &[f64; N], residual: f64) {
        let along: f64 = (0..N).map(|j| psi[j] * self.open[j]).sum();
        for (open, gain) in self.open.iter_mut().zip(gain) {
            *open += gain * (residual - along);
        }
        let q_psi: [f64; N] =
            std::array::from_fn(|i| (0..N).map(|j| self.closed[i][j] * psi[j]).sum());
        let size: f64 = (0..N).map(|j| psi[j] * q_psi[j]).sum();
        for i in 0..N {
            for j in 0..N {
                self.closed[i][j] +=
                    size * gain[i] * gain[j] - gain[i] * q_psi[j] - q_psi[i] * gain[j];
            }
        }
        self.rows += 1;
        if self.rows >= BLOCK_ROWS {
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

//! Detection of a changed parameter by moving sums of residuals (MOSUM; Chu, Hornik and Kuan, *Biometrika* 82, 1995).
//!
//! Rows between consecutive samples share their errors, so that the noise of a sum of residuals is that of its two ends,
//! however many rows lie between: a change exceeds the noise of the sum sooner than that of any single row.

#[derive(Clone, Debug)]
pub struct ChangeWatch {
    /// A change is a sum beyond this share of the sizes of its rows, and beyond its noise.
    least_share: f64,
    /// Mean square of the residuals of rows.
    noise: f64,
    /// Residual and size of the last rows without an interruption, and the number of those rows.
    window: [(f64, f64); 8],
    rows: usize,
}

impl ChangeWatch {
    /// `noise`: prior of the mean square of the residuals.
    pub const fn new(least_share: f64, noise: f64) -> Self {
        Self { least_share, noise, window: [(0.0, 0.0); 8], rows: 0 }
    }

    /// Starts a new sum: the next row does not follow the last one, or the estimate was reset.
    pub const fn interrupt(&mut self) {
        self.rows = 0;
    }

    /// One row with its prediction. True where the sum of at least three residuals exceeds six standard deviations of its noise
    /// and the estimate has `settled`.
    pub fn take(&mut self, predicted: f64, value: f64, settled: bool) -> bool {
        let residual = value - predicted;
        let length = self.window.len();
        self.window[self.rows % length] = (residual, predicted.abs().max(value.abs()));
        self.rows += 1;
        let rows = self.window[..self.rows.min(length)].iter();
        let (sum, size) = rows.fold((0.0, 0.0), |sums, row| (sums.0 + row.0, sums.1 + row.1));
        let exceeds = sum.abs() > self.least_share * size && sum * sum > 6.0 * 6.0 * self.noise;
        if !exceeds {
            // Exponential mean over about fifty rows.
            self.noise += 0.02 * (residual * residual - self.noise);
        }
        exceeds && settled && self.rows >= 3
    }
}

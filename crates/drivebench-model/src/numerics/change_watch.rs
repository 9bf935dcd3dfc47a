//! Detection of a changed parameter by the sum of the last residuals of a recursive estimate (a moving-window CUSUM).
//!
//! Rows between consecutive samples share their errors, so that the noise of a sum of residuals is that of its two ends,
//! however many rows lie between: a change stands out of the sum sooner than out of any single row.

/// Rows of which the residuals are added up.
const WINDOW: usize = 8;

#[derive(Clone, Debug)]
pub struct ChangeWatch {
    /// A change is a sum beyond this share of the sizes of its rows, and beyond its noise.
    least_share: f64,
    /// Mean square of the residuals of rows.
    noise: f64,
    /// Residual and size of the last rows that follow each other, and their number.
    window: [(f64, f64); WINDOW],
    rows: usize,
}

impl ChangeWatch {
    /// `noise`: mean square of the residuals of rows as far as it is known beforehand.
    pub const fn new(least_share: f64, noise: f64) -> Self {
        Self { least_share, noise, window: [(0.0, 0.0); WINDOW], rows: 0 }
    }

    /// The next row does not follow the last one, or the memory was dropped.
    pub const fn interrupt(&mut self) {
        self.rows = 0;
    }

    /// One row: the estimate predicted `foreseen` for the value `moved`. True where at least three rows together stand out of
    /// six standard deviations of their noise; `believed` is whether the estimate has settled enough for that.
    pub fn take(&mut self, foreseen: f64, moved: f64, believed: bool) -> bool {
        let residual = moved - foreseen;
        self.window[self.rows % WINDOW] = (residual, foreseen.abs().max(moved.abs()));
        self.rows += 1;
        let rows = self.window[..self.rows.min(WINDOW)].iter();
        let (sum, size) = rows.fold((0.0, 0.0), |sums, row| (sums.0 + row.0, sums.1 + row.1));
        let stands_out = sum.abs() > self.least_share * size && sum * sum > 6.0 * 6.0 * self.noise;
        if !stands_out {
            // First-order mean over about fifty rows.
            self.noise += 0.02 * (residual * residual - self.noise);
        }
        stands_out && believed && self.rows >= 3
    }
}

//! Detection of a changed parameter by the sum of the last misses of a recursive estimate.
//!
//! Rows between consecutive samples share their errors, so that the noise of a sum of misses is that of its two ends,
//! however many rows lie between: a change stands out of the sum sooner than out of any single row.

/// Rows of which the misses are added up.
const WATCHED: usize = 8;
/// Standard deviations of a row's noise that the sum exceeds by no chance.
const NOISES: f64 = 6.0;
/// Fewest rows that tell a change.
const FEWEST: usize = 3;
/// Share by which the noise of the rows is followed.
const NOISE_SHARE: f64 = 0.02;

#[derive(Clone, Debug)]
pub struct ChangeWatch {
    /// A change is a sum beyond this share of the moves of its rows, and beyond its noise.
    least_share: f64,
    /// Mean square of the misses of rows.
    noise: f64,
    /// Miss and size of the last rows that follow each other, and how many they are.
    watched: [(f64, f64); WATCHED],
    rows: usize,
}

impl ChangeWatch {
    /// `noise`: mean square of the misses of rows as far as it is known beforehand.
    pub const fn new(least_share: f64, noise: f64) -> Self {
        Self {
            least_share,
            noise,
            watched: [(0.0, 0.0); WATCHED],
            rows: 0,
        }
    }

    /// The next row does not follow the last one, or the memory was dropped.
    pub const fn interrupt(&mut self) {
        self.rows = 0;
    }

    /// One row: by what the estimate missed what `moved`. Whether the rows say together that a parameter is another;
    /// `believed` is whether the estimate has settled enough to be missed by.
    pub fn take(&mut self, foreseen: f64, moved: f64, believed: bool) -> bool {
        let miss = moved - foreseen;
        self.watched[self.rows % WATCHED] = (miss, foreseen.abs().max(moved.abs()));
        self.rows += 1;
        let rows = &self.watched[..self.rows.min(WATCHED)];
        let (sum, size) = rows
            .iter()
            .fold((0.0, 0.0), |(sum, size), row| (sum + row.0, size + row.1));
        let stands_out =
            sum.abs() > self.least_share * size && sum * sum > NOISES * NOISES * self.noise;
        if !stands_out {
            self.noise += NOISE_SHARE * (miss * miss - self.noise);
        }
        stands_out && believed && self.rows >= FEWEST
    }
}

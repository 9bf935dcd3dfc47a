//! Recursive least squares with factored covariance, and exponential forgetting only while the rows excite.
//!
//! `P = U D U'` (U unit upper triangular, D diagonal): Bierman, *Factorization Methods for Discrete Sequential
//! Estimation* (1977), chapter V; it stays positive in floating point where the plain form does not. Covariance wind-up
//! (Astrom and Wittenmark, *Adaptive Control*, chapter 11) is avoided: rows forget only while their leverage `psi' P psi` is
//! large, and never beyond the prior variance.

use super::clustered_spread::ClusteredSpread;

/// Moving-average noise of a row: the difference of two errors of unit variance, `e_end - carry e_begin`.
///
/// Rows between consecutive samples share a sample: as white noise their standard deviations would be far too large.
#[derive(Clone, Copy, Debug)]
pub struct RowNoise {
    pub carry: f64,
    /// Whether `e_begin` is the `e_end` of the row before.
    pub continues: bool,
}

impl RowNoise {
    pub const WHITE: Self = Self { carry: 0.0, continues: false };
}

/// Least squares with exponential memory in `N` parameters; allocates nothing.
///
/// Divisions are few and the products of a row are formed once: an update is a few tens of nanoseconds.
#[derive(Clone, Debug)]
pub struct RecursiveLeastSquares<const N: usize> {
    forgetting: f64,
    /// `1 / forgetting`, and the mean leverage below which forgetting pauses.
    growth: f64,
    least_leverage: f64,
    /// Size of each parameter: the algebra runs on `parameter / scale`.
    scale: [f64; N],
    scaled: [f64; N],
    /// Column by column: `upper[j][i]` is `U_ij`, of which only `i < j` counts.
    upper: [[f64; N]; N],
    diagonal: [f64; N],
    /// Diagonal of `P`.
    variance: [f64; N],
    prior: f64,
    /// `Q`: covariance of the scaled parameters for errors of unit variance, propagated with the gains of the recursion.
    spread: [[f64; N]; N],
    /// `s`: covariance of the scaled parameters with the error of the last sample.
    shared: [f64; N],
    /// Covariance for correlated errors of neighbouring rows.
    clustered: Option<Box<ClusteredSpread<N>>>,
    noise_sum: f64,
    noise_weight: f64,
    rows: u64,
    recent_leverage: f64,
}

impl<const N: usize> RecursiveLeastSquares<N> {
    /// `scale` gives the size of each parameter (positive), `prior` the variance of `parameter / scale` before any data
    /// in units of the noise variance; `forgetting` is limited to 0.5..1.
    pub fn new(start: [f64; N], scale: [f64; N], prior: f64, forgetting: f64) -> Self {
        let mut estimator = Self {
            forgetting: 1.0,
            growth: 1.0,
            least_leverage: 0.0,
            scale,
            scaled: std::array::from_fn(|j| start[j] / scale[j]),
            upper: [[0.0; N]; N],
            diagonal: [prior; N],
            variance: [prior; N],
            prior,
            spread: std::array::from_fn(|row| {
                std::array::from_fn(|column| if row == column { prior } else { 0.0 })
            }),
            shared: [0.0; N],
            clustered: None,
            noise_sum: 0.0,
            noise_weight: 0.0,
            rows: 0,
            recent_leverage: 1.0,
        };
        estimator.set_forgetting(forgetting);
        estimator
    }

    /// With standard deviations that also hold for correlated errors of neighbouring rows.
    #[must_use]
    pub fn clustered(mut self) -> Self {
        self.clustered = Some(Box::new(ClusteredSpread::new()));
        self
    }

    /// Takes one row of independent noise and returns the innovation; `None`, and no change, where it is not finite.
    pub fn update(&mut self, regressor: &[f64; N], value: f64) -> Option<f64> {
        self.update_row(regressor, value, RowNoise::WHITE)
    }

    /// As [`Self::update`], for a row whose noise is the difference of two samples' errors.
    pub fn update_row(&mut self, regressor: &[f64; N], value: f64, noise: RowNoise) -> Option<f64> {
        let psi: [f64; N] = std::array::from_fn(|j| regressor[j] * self.scale[j]);
        // A regressor that is not finite leaves an innovation that is not.
        let innovation = value - dot(&psi, &self.scaled);
        let f = self.projected(&psi);
        let leverage: f64 = (0..N).map(|j| f[j] * f[j] * self.diagonal[j]).sum();
        if !(innovation.is_finite() && leverage.is_finite()) {
            return None;
        }
        // Exponential mean over 16 rows.
        self.recent_leverage += (leverage.min(1.0) - self.recent_leverage) * (1.0 / 16.0);
        let forgets = self.recent_leverage >= self.least_leverage
            && self.variance.iter().all(|variance| *variance < self.prior);
        // Before the divisions of the gain, so that a processor overlaps both.
        let terms = self.spread_terms(&psi, noise);
        let growth = if forgets { self.growth } else { 1.0 };
        let (gain, leverage) = self.measure(&f, growth);
        for (parameter, gain) in self.scaled.iter_mut().zip(&gain) {
            *parameter += gain * innovation;
        }
        self.propagate_spread(terms, &gain);
        if let Some(clustered) = &mut self.clustered {
            clustered.take(&psi, &gain, innovation / (1.0 + leverage));
        }
        // While the prior dominates, the innovation is that of the parameters, not of the noise.
        if leverage < 10.0 {
            let row_variance = 1.0 + noise.carry * noise.carry;
            let square = innovation * innovation / ((1.0 + leverage) * row_variance);
            self.noise_sum = self.forgetting * self.noise_sum + square;
            self.noise_weight = self.forgetting * self.noise_weight + 1.0;
        }
        self.rows += 1;
        Some(innovation)
    }

    /// `f = U' psi`.
    fn projected(&self, psi: &[f64; N]) -> [f64; N] {
        std::array::from_fn(|j| psi[j] + (0..j).map(|i| self.upper[j][i] * psi[i]).sum::<f64>())
    }

    /// Bierman's measurement update for unit noise, after `D` was divided by the forgetting factor: the gain, and the leverage
    /// before it.
    fn measure(&mut self, f: &[f64; N], growth: f64) -> ([f64; N], f64) {
        let grown: [f64; N] = std::array::from_fn(|j| self.diagonal[j] * growth);
        let v: [f64; N] = std::array::from_fn(|j| grown[j] * f[j]);
        // alpha[j]: variance of the innovation by the first j directions; its inverses are independent divisions.
        let mut alpha = [1.0; N];
        let mut sum = 1.0;
        for j in 0..N {
            sum += f[j] * v[j];
            alpha[j] = sum;
        }
        let inverse: [f64; N] = alpha.map(|alpha| 1.0 / alpha);
        let mut gain = [0.0; N];
        let mut variance = [0.0; N];
        let (mut before, mut inverse_before) = (1.0, 1.0);
        for j in 0..N {
            let diagonal = grown[j] * (before * inverse[j]);
            let p = -f[j] * inverse_before;
            let column = &mut self.upper[j];
            for i in 0..j {
                let u = column[i];
                let updated = u + gain[i] * p;
                gain[i] += u * v[j];
                column[i] = updated;
                variance[i] += updated * updated * diagonal;
            }
            gain[j] = v[j];
            variance[j] += diagonal;
            self.diagonal[j] = diagonal;
            (before, inverse_before) = (alpha[j], inverse[j]);
        }
        self.variance = variance;
        (gain.map(|g| g * inverse_before), sum - 1.0)
    }

    /// The parts of [`Self::propagate_spread`] that the gain does not enter: `Q psi + carry s`, and what the gain is
    /// multiplied with.
    fn spread_terms(&self, psi: &[f64; N], noise: RowNoise) -> ([f64; N], f64) {
        let carry = noise.carry;
        let shared_carry = if noise.continues { carry } else { 0.0 };
        let q_psi: [f64; N] = std::array::from_fn(|i| dot(&self.spread[i], psi));
        let half = 0.5 * (dot(psi, &q_psi) + (1.0 + carry * carry));
        let psi_s = shared_carry * dot(psi, &self.shared);
        let sum = std::array::from_fn(|i| q_psi[i] + shared_carry * self.shared[i]);
        (sum, half + psi_s)
    }

    /// `Q <- A Q A' + (1 + carry^2) K K' - carry (A s K' + K s' A')`, `A = I - K psi'`, `s` the covariance with `e_begin`,
    /// as `Q - K a' - a K'` with `a = Q psi + carry s - ((psi' Q psi + 1 + carry^2)/2 + carry psi' s) K`.
    fn propagate_spread(&mut self, (sum, share): ([f64; N], f64), gain: &[f64; N]) {
        let a: [f64; N] = std::array::from_fn(|i| sum[i] - share * gain[i]);
        for (i, row) in self.spread.iter_mut().enumerate() {
            for (j, cell) in row.iter_mut().enumerate() {
                *cell -= gain[i] * a[j] + a[i] * gain[j];
            }
        }
        self.shared = *gain;
    }

    pub fn parameters(&self) -> [f64; N] {
        std::array::from_fn(|j| self.scaled[j] * self.scale[j])
    }

    pub fn set_forgetting(&mut self, forgetting: f64) {
        self.forgetting = forgetting.clamp(0.5, 1.0);
        self.growth = 1.0 / self.forgetting;
        // In the mean the leverage is `1 - lambda` times the number of directions that the rows excite: a machine at constant speed
        // excites one, and the others would be forgotten.
        let directions = if N > 1 { 1.2 } else { 0.0 };
        self.least_leverage = directions * (1.0 - self.forgetting);
    }

    /// Variance of one sample's error; `None` without more rows than parameters.
    pub fn noise_variance(&self) -> Option<f64> {
        (self.rows > N as u64 && self.noise_weight > 1.0)
            .then(|| self.noise_sum / self.noise_weight)
    }

    /// Covariance of two parameters with the present forgetting factor; `None` before the noise is known.
    pub fn covariance(&self, row: usize, column: usize) -> Option<f64> {
        let unit = self.spread[row][column] * self.scale[row] * self.scale[column];
        let variance = self.noise_variance()?;
        let widened = self.widening(row, variance) * self.widening(column, variance);
        Some(variance * unit * widened)
    }

    /// Factor on the standard deviation of a parameter for correlated errors of neighbouring rows; at least one.
    fn widening(&self, parameter: usize, noise_variance: f64) -> f64 {
        let white = noise_variance * self.spread[parameter][parameter];
        match &self.clustered {
            Some(clustered) if white > 0.0 => {
                (clustered.variance(parameter) / white).max(1.0).sqrt()
            }
            _ => 1.0,
        }
    }

    /// Standard deviations; `None` before the noise is known.
    pub fn standard_deviations(&self) -> Option<[f64; N]> {
        let variance = self.noise_variance()?;
        Some(std::array::from_fn(|j| {
            (variance * self.spread[j][j].max(0.0)).sqrt()
                * self.widening(j, variance)
                * self.scale[j]
        }))
    }

    /// Posterior over prior variance of a parameter: 1 without information, towards 0 with it; forgetting can raise it above 1.
    pub fn variance_ratio(&self, parameter: usize) -> f64 {
        self.variance[parameter] / self.prior
    }

    pub fn rows(&self) -> u64 {
        self.rows
    }
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const TRUE: [f64; 3] = [2.0, -0.03, 500.0];
    const SCALE: [f64; 3] = [1.0, 0.01, 100.0];

    fn row(random: &mut ChaCha8Rng) -> [f64; 3] {
        [1.0, 100.0, 0.01].map(|size| size * random.random_range(-1.0..1.0))
    }

    /// Sum of twelve uniforms: variance one.
    fn noise(random: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| random.random_range(-0.5..0.5)).sum()
    }

    /// An estimator with memory and so many rows of these parameters, noise included.
    fn trained(seed: u64, rows: usize, truth: &[f64; 3]) -> (ChaCha8Rng, RecursiveLeastSquares<3>) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut rls = RecursiveLeastSquares::new([0.0; 3], SCALE, 1e6, 0.97);
        feed(&mut random, &mut rls, rows, truth);
        (random, rls)
    }

    fn feed(
        random: &mut ChaCha8Rng,
        rls: &mut RecursiveLeastSquares<3>,
        rows: usize,
        truth: &[f64; 3],
    ) {
        for _ in 0..rows {
            let psi = row(random);
            rls.update(&psi, dot(&psi, truth) + 0.01 * noise(random));
        }
    }

    #[test]
    fn equals_batch_weighted_least_squares() {
        // With lambda = 1, and in one dimension, forgetting never pauses: the weights are then known in closed form.
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut recursive = RecursiveLeastSquares::new([0.0; 3], SCALE, 1e12, 1.0);
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for _ in 0..300 {
            let psi = row(&mut random);
            let value = dot(&psi, &TRUE) + 0.1 * noise(&mut random);
            recursive.update(&psi, value).unwrap();
            let scaled = Vector3::from_fn(|j, _| psi[j] * SCALE[j]);
            normal += scaled * scaled.transpose();
            right += scaled * value;
        }
        let batch = normal.try_inverse().unwrap() * right;
        for (j, found) in recursive.parameters().iter().enumerate() {
            assert!((found / SCALE[j] - batch[j]).abs() < 1e-8, "{j} {found}");
        }
        let variance = recursive.noise_variance().unwrap();
        assert!((variance / 0.01 - 1.0).abs() < 0.2, "{variance}");

        let mut one = RecursiveLeastSquares::new([0.0], [1.0], 1e12, 0.9);
        let (mut above, mut below) = (0.0, 0.0);
        for _ in 0..100 {
            let psi = random.random_range(0.5..1.5);
            let value = 3.0 * psi + noise(&mut random);
            one.update(&[psi], value).unwrap();
            (above, below) = (0.9 * above + psi * value, 0.9 * below + psi * psi);
        }
        assert!((one.parameters()[0] - above / below).abs() < 1e-9);
    }

    #[test]
    fn standard_deviations_are_those_of_repeated_trials() {
        for carry in [0.0, 1.0] {
            let kind = RowNoise { carry, continues: true };
            let (mut squares, mut variances) = ([0.0; 3], [0.0; 3]);
            for seed in 0..300 {
                let mut random = ChaCha8Rng::seed_from_u64(seed);
                let mut rls = RecursiveLeastSquares::new([0.0; 3], SCALE, 1e9, 0.97);
                let mut before = noise(&mut random);
                for _ in 0..300 {
                    let psi = row(&mut random);
                    let error = noise(&mut random);
                    let value = dot(&psi, &TRUE) + 0.1 * (error - carry * before);
                    before = error;
                    rls.update_row(&psi, value, kind).unwrap();
                }
                let (found, std) = (rls.parameters(), rls.standard_deviations().unwrap());
                for j in 0..3 {
                    squares[j] += (found[j] - TRUE[j]).powi(2);
                    variances[j] += std[j].powi(2);
                }
            }
            for j in 0..3 {
                let ratio = (variances[j] / squares[j]).sqrt();
                assert!((0.8..1.25).contains(&ratio), "carry {carry} {j} {ratio}");
            }
        }
    }

    #[test]
    fn a_million_rows_of_one_direction_do_not_wind_up() {
        let (mut random, mut rls) = trained(2, 300, &TRUE);
        let psi = [1.0, 0.0, 0.01];
        for _ in 0..1_000_000 {
            let value = dot(&psi, &TRUE) + 0.01 * noise(&mut random);
            rls.update(&psi, value).unwrap();
        }
        let stds = rls.standard_deviations().unwrap();
        for (j, found) in rls.parameters().iter().enumerate() {
            assert!((found / TRUE[j] - 1.0).abs() < 0.05, "{j} {found}");
            assert!(
                rls.variance_ratio(j) > 0.0 && rls.variance_ratio(j) < 1e-3 && stds[j].is_finite()
            );
        }
    }

    #[test]
    fn a_jump_of_a_parameter_is_followed() {
        let (mut random, mut rls) = trained(3, 600, &TRUE);
        assert!((rls.parameters()[0] - 2.0).abs() < 0.02);
        feed(&mut random, &mut rls, 600, &[4.0, -0.03, 500.0]);
        assert!((rls.parameters()[0] - 4.0).abs() < 0.02);
    }

    #[test]
    fn a_row_that_is_not_finite_changes_nothing() {
        let (_, mut rls) = trained(4, 20, &TRUE);
        let before = format!("{rls:?}");
        for (psi, value) in [
            ([1.0, f64::NAN, 0.0], 1.0),
            ([1.0, 1.0, 0.0], f64::INFINITY),
            ([1e200, 1e200, 0.0], 1.0),
        ] {
            assert_eq!(rls.update(&psi, value), None);
        }
        assert_eq!(format!("{rls:?}"), before);
    }
}

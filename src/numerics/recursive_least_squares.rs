//! Recursive least squares with factored covariance and forgetting in the excited direction only.
//!
//! `P = U D U'` (U unit upper triangular, D diagonal): Bierman, *Factorization Methods for Discrete Sequential
//! Estimation* (1977), chapter V; it stays positive in floating point where the plain form does not. Forgetting is
//! directional (Cao and Schwartz, Automatica 36 (2000) 1725): `P += (1/lambda - 1) psi psi' / (psi' P^-1 psi)`, so
//! a direction that the data leave alone keeps its information and cannot wind up.

/// Forgetting pauses while the row carries less than this share of what a row carries in steady excitation: a regressor
/// that is almost zero would otherwise wipe out what larger ones have taught.
const LEAST_NEWS: f64 = 0.1;
/// Rows that the parameters still follow freely say nothing about the noise: `psi' P psi` above this.
const FREE_ROW: f64 = 10.0;

/// The noise of a row as the difference of two errors of unit variance, `e_end - carry e_begin`.
///
/// Rows between consecutive samples share a sample: without this the standard deviations would be far too large.
#[derive(Clone, Copy, Debug)]
pub struct RowNoise {
    pub carry: f64,
    /// Whether `e_begin` is the `e_end` of the row before.
    pub continues: bool,
}

impl RowNoise {
    /// A row of independent noise.
    pub const WHITE: Self = Self {
        carry: 0.0,
        continues: false,
    };
}

/// Least squares with exponential memory in `N` parameters; allocates nothing.
#[derive(Clone, Debug)]
pub struct RecursiveLeastSquares<const N: usize> {
    forgetting: f64,
    /// Size of each parameter: the algebra runs on `parameter / scale`.
    scale: [f64; N],
    scaled: [f64; N],
    upper: [[f64; N]; N],
    diagonal: [f64; N],
    prior: f64,
    /// Covariance of the scaled parameters for errors of unit variance, propagated with the gains that were really used.
    spread: [[f64; N]; N],
    /// Covariance of the scaled parameters with the error of the last sample.
    shared: [f64; N],
    noise_sum: f64,
    noise_weight: f64,
    rows: u64,
}

impl<const N: usize> RecursiveLeastSquares<N> {
    /// `scale` gives the size of each parameter (positive), `prior` the variance of `parameter / scale` before any data
    /// in units of the noise variance; `forgetting` is limited to 0.5..1.
    pub fn new(start: [f64; N], scale: [f64; N], prior: f64, forgetting: f64) -> Self {
        Self {
            forgetting: forgetting.clamp(0.5, 1.0),
            scale,
            scaled: std::array::from_fn(|j| start[j] / scale[j]),
            upper: std::array::from_fn(|row| {
                std::array::from_fn(|column| f64::from(u8::from(row == column)))
            }),
            diagonal: [prior; N],
            prior,
            spread: std::array::from_fn(|row| {
                std::array::from_fn(|column| if row == column { prior } else { 0.0 })
            }),
            shared: [0.0; N],
            noise_sum: 0.0,
            noise_weight: 0.0,
            rows: 0,
        }
    }

    /// Takes one row of independent noise and returns the innovation; `None`, and no change, where it is not finite.
    pub fn update(&mut self, regressor: &[f64; N], value: f64) -> Option<f64> {
        self.update_row(regressor, value, RowNoise::WHITE)
    }

    /// As [`Self::update`], for a row whose noise is the difference of two samples' errors.
    pub fn update_row(&mut self, regressor: &[f64; N], value: f64, noise: RowNoise) -> Option<f64> {
        let psi: [f64; N] = std::array::from_fn(|j| regressor[j] * self.scale[j]);
        let innovation = value - dot(&psi, &self.scaled);
        if !innovation.is_finite() || psi.iter().any(|x| !x.is_finite()) {
            return None;
        }
        let news = self.news(&psi);
        if !news.is_finite() {
            return None;
        }
        if news >= LEAST_NEWS * (1.0 - self.forgetting) {
            self.forget(&psi);
        }
        let (gain, news) = self.measure(&psi);
        for (parameter, gain) in self.scaled.iter_mut().zip(&gain) {
            *parameter += gain * innovation;
        }
        self.propagate_spread(&psi, &gain, noise);
        if news < FREE_ROW {
            let square =
                innovation * innovation / (1.0 + news) / noise.carry.mul_add(noise.carry, 1.0);
            self.noise_sum = self.forgetting * self.noise_sum + square;
            self.noise_weight = self.forgetting * self.noise_weight + 1.0;
        }
        self.rows += 1;
        Some(innovation)
    }

    /// `psi' P psi`: variance of the prediction in units of the noise variance.
    fn news(&self, psi: &[f64; N]) -> f64 {
        (0..N)
            .map(|j| {
                let f: f64 = psi[j] + (0..j).map(|i| self.upper[i][j] * psi[i]).sum::<f64>();
                f * f * self.diagonal[j]
            })
            .sum()
    }

    /// Directional forgetting: a rank-one addition along `psi` (Agee and Turner's update of the factors).
    fn forget(&mut self, psi: &[f64; N]) {
        // v = U^-1 psi, so psi' P^-1 psi = sum v_j^2 / D_j.
        let mut v = *psi;
        for j in (0..N).rev() {
            for i in 0..j {
                v[i] -= self.upper[i][j] * v[j];
            }
        }
        let information: f64 = (0..N).map(|j| v[j] * v[j] / self.diagonal[j]).sum();
        let mut c = (1.0 / self.forgetting - 1.0) / information;
        if !(c.is_finite() && c > 0.0) {
            return;
        }
        let mut a = *psi;
        for j in (0..N).rev() {
            let before = self.diagonal[j];
            let after = before + c * a[j] * a[j];
            self.diagonal[j] = after;
            let lift = c * a[j] / after;
            for i in 0..j {
                a[i] -= a[j] * self.upper[i][j];
                self.upper[i][j] += lift * a[i];
            }
            c *= before / after;
        }
    }

    /// Bierman's measurement update for unit noise: the gain, and `psi' P psi` before it.
    fn measure(&mut self, psi: &[f64; N]) -> ([f64; N], f64) {
        let f: [f64; N] = std::array::from_fn(|j| {
            psi[j] + (0..j).map(|i| self.upper[i][j] * psi[i]).sum::<f64>()
        });
        let mut gain = [0.0; N];
        let mut alpha = 1.0;
        for j in 0..N {
            let v = self.diagonal[j] * f[j];
            let before = alpha;
            alpha += f[j] * v;
            self.diagonal[j] *= before / alpha;
            gain[j] = v;
            let p = -f[j] / before;
            for i in 0..j {
                let u = self.upper[i][j];
                self.upper[i][j] += gain[i] * p;
                gain[i] += u * v;
            }
        }
        (gain.map(|g| g / alpha), alpha - 1.0)
    }

    /// `Q <- A Q A' + (1 + carry^2) K K' - carry (A s K' + K s' A')`, `A = I - K psi'`, `s` the covariance with `e_begin`.
    fn propagate_spread(&mut self, psi: &[f64; N], gain: &[f64; N], noise: RowNoise) {
        let q_psi: [f64; N] = std::array::from_fn(|i| dot(&self.spread[i], psi));
        let variance = dot(psi, &q_psi) + 1.0 + noise.carry * noise.carry;
        let shared = if noise.continues {
            self.shared
        } else {
            [0.0; N]
        };
        let along = dot(psi, &shared);
        for i in 0..N {
            for j in 0..=i {
                let own = self.spread[i][j] - gain[i] * q_psi[j] - q_psi[i] * gain[j]
                    + gain[i] * gain[j] * variance;
                let cross = (shared[i] - gain[i] * along) * gain[j]
                    + gain[i] * (shared[j] - gain[j] * along);
                let value = own - noise.carry * cross;
                self.spread[i][j] = value;
                self.spread[j][i] = value;
            }
        }
        self.shared = *gain;
    }

    pub fn parameters(&self) -> [f64; N] {
        std::array::from_fn(|j| self.scaled[j] * self.scale[j])
    }

    /// Moves the parameters, as a limit of physics may demand; covariance and noise stay.
    pub fn set_parameters(&mut self, parameters: &[f64; N]) {
        self.scaled = std::array::from_fn(|j| parameters[j] / self.scale[j]);
    }

    /// Variance of one sample's error; `None` before more rows than parameters have spoken of it.
    pub fn noise_variance(&self) -> Option<f64> {
        (self.rows > N as u64 && self.noise_weight > 1.0)
            .then(|| self.noise_sum / self.noise_weight)
    }

    /// Covariance of two parameters under the memory that forgetting leaves; `None` before the noise is known.
    pub fn covariance(&self, row: usize, column: usize) -> Option<f64> {
        let unit = self.spread[row][column] * self.scale[row] * self.scale[column];
        Some(self.noise_variance()? * unit)
    }

    /// Standard deviations; `None` before the noise is known.
    pub fn standard_deviations(&self) -> Option<[f64; N]> {
        let variance = self.noise_variance()?;
        Some(std::array::from_fn(|j| {
            (variance * self.spread[j][j].max(0.0)).sqrt() * self.scale[j]
        }))
    }

    /// Share of the prior variance that the data have left, 1 (nothing learnt) to 0; forgetting can lift it above 1.
    pub fn ignorance(&self, parameter: usize) -> f64 {
        let variance: f64 = (parameter..N)
            .map(|j| self.upper[parameter][j].powi(2) * self.diagonal[j])
            .sum();
        variance / self.prior
    }

    /// Rows taken so far.
    pub fn rows(&self) -> u64 {
        self.rows
    }
}

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

//! Recursive prediction-error estimation of R, L and Ke along one run, from one start.
//!
//! Ljung and Soderstrom, *Theory and Practice of Recursive Identification* (1983), section 3.4, in innovations form: the
//! current is predicted from a filtered state, not from the last noisy sample, and the gradient is propagated through
//! that filter. A noisy regressor would bias the resistance and the inductance (errors in variables). The filter is a
//! Kalman filter for the current and for the error of the speed sample that two blocks share: without the latter the
//! innovations of neighbours would be correlated, and the standard deviations a quarter too small at T above L/R.

use super::winding::Winding;
use drivebench_model::numerics::recursive_least_squares::{RecursiveLeastSquares, RowNoise};

#[derive(Clone, Copy, Debug)]
pub(super) struct SampleNoise {
    pub(super) current_a: f64,
    pub(super) speed_rad_s: f64,
    /// Noise of the current with the error of the sample's stamp, over that of the sensor; divides the weight of the row.
    pub(super) by_stamp: f64,
}

pub(super) struct Block<F: Fn(f64, &Winding, f64, [f64; 2]) -> f64> {
    /// Current at the end from Kt/J, the winding, the current at the begin and the errors of the first and the last speed.
    pub(super) predict: F,
    /// Kt/J, and Kt/J plus its standard deviation: the speed between the samples depends on it.
    pub(super) acceleration: [f64; 2],
    pub(super) first_current_a: f64,
    pub(super) last_current_a: f64,
    pub(super) length_s: f64,
    /// Intervals between samples in the block.
    pub(super) intervals: f64,
    /// Whether it begins with the sample that ended the last one taken.
    pub(super) continues: bool,
}

#[derive(Clone, Copy, Debug)]
struct Filtered {
    current_a: f64,
    /// Error of the speed sample at the same instant, measured less true.
    speed_error: f64,
    /// Derivatives of both to R, L, Ke.
    current_by: [f64; 3],
    speed_error_by: [f64; 3],
    /// Variance of the current, covariance, variance of the speed error.
    covariance: [f64; 3],
}

/// Current that independent errors of the speed samples inside a block of `n` intervals and `share` times L/R make at its
/// end, A per rad/s: root of the sum of squares.
fn inner_speed_gain([r, _, ke]: &Winding, share: f64, n: f64) -> f64 {
    let x = share / n;
    let c = (-x).exp();
    let step = -(-x).exp_m1() / x;
    let (begin, end) = (step - c, 1.0 - step);
    let squares = (1.0 - c.powf(2.0 * (n - 1.0))) / (1.0 - c * c);
    ke / r * (end * c + begin) * squares.max(0.0).sqrt()
}

#[derive(Clone, Debug)]
pub(super) struct Track {
    estimator: RecursiveLeastSquares<3>,
    /// The same with the predictions for Kt/J plus its standard deviation.
    doubtful: RecursiveLeastSquares<3>,
    start: Winding,
    /// Point of linearisation: the estimates once they are certain, before that the start, since estimates from a few rows
    /// may be far off.
    anchor: Winding,
    forgetting: f64,
    /// Forgetting of the first rows (Ljung and Soderstrom, section 5.6): they were linearised about a start with an
    /// error of some per cent.
    early_loss: f64,
    filtered: Option<Filtered>,
    /// Recent mean square of the normalised innovation.
    misfit: f64,
}

impl Track {
    /// `certain`: the start is near the true values; no forgetting of the first rows.
    pub(super) fn new(start: Winding, noise: SampleNoise, forgetting: f64, certain: bool) -> Self {
        let prior = (0.5 / noise.current_a).powi(2);
        let doubtful = RecursiveLeastSquares::new(start, start, prior, forgetting);
        Self {
            estimator: doubtful.clone().clustered(),
            doubtful,
            start,
            anchor: start,
            forgetting,
            early_loss: if certain { 0.0 } else { 0.08 },
            filtered: None,
            misfit: f64::NAN,
        }
    }

    pub(super) fn estimator(&self) -> &RecursiveLeastSquares<3> {
        &self.estimator
    }

    /// Standard deviations of R, L and Ke with the error by the speed between samples.
    pub(super) fn standard_deviations(&self) -> Option<[f64; 3]> {
        let (values, other) = (self.estimator.parameters(), self.doubtful.parameters());
        let stds = self.estimator.standard_deviations()?;
        Some(std::array::from_fn(|j| stds[j].hypot(other[j] - values[j])))
    }

    /// Relative distance of a parameter from the start.
    pub(super) fn moved(&self, parameter: usize) -> f64 {
        (self.estimator.parameters()[parameter] / self.start[parameter] - 1.0).abs()
    }

    /// R, L, Ke about which the model is linearised.
    pub(super) fn winding(&self) -> Winding {
        self.anchor
    }

    pub(super) fn misfit(&self) -> f64 {
        self.misfit
    }

    /// Takes a block and returns the innovation, A.
    pub(super) fn take<F>(&mut self, block: &Block<F>, noise: SampleNoise) -> Option<f64>
    where
        F: Fn(f64, &Winding, f64, [f64; 2]) -> f64,
    {
        let [known, doubtful] = block.acceleration;
        let predict = |winding: &Winding, begin_a: f64, speed_errors: [f64; 2]| {
            (block.predict)(known, winding, begin_a, speed_errors)
        };
        let winding = self.anchor;
        let power = noise.current_a.powi(2);
        let speed_power = noise.speed_rad_s.powi(2);
        let begin = self.filtered.filter(|_| block.continues).unwrap_or(Filtered {
            current_a: block.first_current_a,
            speed_error: 0.0,
            current_by: [0.0; 3],
            speed_error_by: [0.0; 3],
            covariance: [power, 0.0, speed_power],
        });
        self.filtered = None;
        let errors = [begin.speed_error, 0.0];
        let predicted = predict(&winding, begin.current_a, errors);
        let surprise = block.last_current_a - predicted;
        // Derivative to each parameter, with that of the initial state.
        let psi: [f64; 3] = std::array::from_fn(|j| {
            let step = 1e-4 * winding[j];
            let at = |step: f64| {
                let mut moved = winding;
                moved[j] += step;
                let speed_error = begin.speed_error + step * begin.speed_error_by[j];
                let current_a = begin.current_a + step * begin.current_by[j];
                predict(&moved, current_a, [speed_error, 0.0])
            };
            (at(step) - at(-step)) / (2.0 * step)
        });
        let share = block.length_s * winding[0] / winding[1];
        // The prediction is affine in the initial state and in the errors.
        let carry = predict(&winding, begin.current_a + 1.0, errors) - predicted;
        let first = predict(&winding, begin.current_a, [errors[0] + 1.0, 0.0]) - predicted;
        let last = predict(&winding, begin.current_a, [errors[0], 1.0]) - predicted;
        let between = inner_speed_gain(&winding, share, block.intervals);
        let [current, cross, speed] = begin.covariance;
        let variance = carry * carry * current
            + 2.0 * carry * first * cross
            + first * first * speed
            + (last * last + between * between) * speed_power;
        let shared = last * speed_power;
        let total = power + variance;
        let state = variance.sqrt();
        let by_speed = first.hypot(last).hypot(between) * noise.speed_rad_s;
        let least = [
            -(-share).exp_m1() * state / winding[0],
            share * (-share).exp() * state / winding[1],
            by_speed / winding[2],
        ];
        // In steady state a gradient of noise alone would make the parameter drift.
        let gated: [f64; 3] = std::array::from_fn(|j| {
            let is_noise = psi[j].abs() < 3.0 * least[j];
            if is_noise { 0.0 } else { psi[j] }
        });
        let weight = (power / total).sqrt() / noise.by_stamp;
        let row = gated.map(|g| weight * g);
        let value = surprise + (0..3).map(|j| gated[j] * winding[j]).sum::<f64>();
        let age = f64::from(u32::try_from(self.estimator.rows()).unwrap_or(u32::MAX));
        let lack = (1.0 - self.forgetting).max(self.early_loss * (-age / 40.0).exp());
        self.estimator.set_forgetting(1.0 - lack);
        self.doubtful.set_forgetting(1.0 - lack);
        let other = predicted - (block.predict)(doubtful, &winding, begin.current_a, errors);
        (self.doubtful).update_row(&row, weight * (value + other), RowNoise::WHITE);
        let innovation = self.estimator.update_row(&row, weight * value, RowNoise::WHITE)? / weight;
        let (gain, speed_gain) = (variance / total, shared / total);
        self.filtered = Some(Filtered {
            current_a: predicted + gain * surprise,
            speed_error: speed_gain * surprise,
            current_by: psi.map(|p| (1.0 - gain) * p),
            speed_error_by: psi.map(|p| -speed_gain * p),
            covariance: [
                (1.0 - gain) * variance,
                (1.0 - gain) * shared,
                speed_power - speed_gain * shared,
            ],
        });
        self.move_anchor();
        let square = innovation * innovation / total;
        self.misfit =
            if self.misfit.is_nan() { square } else { self.misfit + (square - self.misfit) / 40.0 };
        Some(innovation)
    }

    /// Relinearises about the certain estimates, and moves the state with them.
    fn move_anchor(&mut self) {
        let (Some(stds), Some(filtered)) =
            (self.estimator.standard_deviations(), &mut self.filtered)
        else {
            return;
        };
        let values = self.estimator.parameters();
        for j in 0..3 {
            if values[j] > 0.0 && stds[j] < 0.02 * values[j] {
                let step = values[j] - self.anchor[j];
                self.anchor[j] = values[j];
                filtered.current_a += filtered.current_by[j] * step;
                filtered.speed_error += filtered.speed_error_by[j] * step;
            }
        }
    }

    /// A block was left out: the next one begins with its own sample.
    pub(super) fn interrupt(&mut self) {
        self.filtered = None;
    }
}

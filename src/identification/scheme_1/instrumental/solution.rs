//! One instrumental-variable solution: filtered rows, normal equations, sandwich covariance.

use nalgebra::{SMatrix, SVector};

use super::{CLUSTERS, FEWEST_ROWS, InstrumentalError, LEAST_EXCITATION, Series};
use crate::identification::scheme_1::inverse::{Coefficients, Dynamics};
use crate::identification::scheme_1::rows::{self, Reading, Row};
use crate::numerics::count::whole;

/// p, q, voltage, load: the fourth motor parameter of five coefficients is tied to the others.
type M4 = SMatrix<f64, 4, 4>;
type V4 = SVector<f64, 4>;

/// A filtered row of the measurement and its instrument.
pub(super) struct Pair {
    sample: usize,
    instrument: V4,
    regressor: V4,
    value: f64,
}

/// The regressors with the two voltage coefficients in the proportion that the model's poles give them: left free, their
/// difference costs most of the accuracy when the sampling is fast.
fn tied(row: &Row, ratio: f64) -> [f64; 4] {
    let [p, q, voltage, load, step] = row.regressor;
    [p, q, voltage + ratio * step, load]
}

/// Rows and instruments, both filtered by `1/A(z)` of the model.
///
/// A row over a reversal or a standstill is no equation, but the filter must not start afresh behind it: such a row is
/// corrected by what the auxiliary model lacks there, `A x - B u - b3 s`, and only passes through the filter. Where a
/// speed is missing, and at the two samples before the first row, the auxiliary speed stands in: a start on noisy samples
/// would send a free response as long as the time constants through every row.
pub(super) fn pairs(series: &Series<'_>, auxiliary: &[Reading], model: &Dynamics) -> Vec<Pair> {
    let coefficients = Coefficients::of_motor(model, series.period_s);
    let theta = coefficients.to_array();
    let ratio = coefficients.voltage_step / coefficients.voltage;
    let known = |k: usize| k >= 2 && series.speed_rad_s[k].is_finite();
    let measured = |k: usize| Reading {
        speed_rad_s: if known(k) {
            series.speed_rad_s[k]
        } else {
            auxiliary[k].speed_rad_s
        },
        ..auxiliary[k]
    };
    let mut out = Vec::with_capacity(auxiliary.len());
    let mut memory = [[0.0; 9]; 2];
    for k in 2..auxiliary.len() {
        let last = [&auxiliary[k - 2], &auxiliary[k - 1], &auxiliary[k]];
        let instrument = rows::whatever_direction(last[0], last[1], last[2]);
        let row = rows::whatever_direction(&measured(k - 2), &measured(k - 1), &measured(k));
        let Some((instrument, mut row)) = instrument.zip(row) else {
            memory = [[0.0; 9]; 2];
            continue;
        };
        let valid = rows::row(last[0], last[1], last[2]).is_some();
        if !valid {
            let explained: f64 = instrument
                .regressor
                .iter()
                .zip(theta)
                .map(|(x, t)| x * t)
                .sum();
            row.value -= instrument.value - explained;
        }
        let [instrument, regressor] = [&instrument, &row].map(|row| tied(row, ratio));
        let now: [f64; 9] = std::array::from_fn(|j| {
            let raw = match j {
                0..4 => instrument[j],
                4..8 => regressor[j - 4],
                _ => row.value,
            };
            raw + coefficients.a1() * memory[0][j] + coefficients.a2() * memory[1][j]
        });
        memory = [now, memory[0]];
        if valid && known(k) {
            out.push(Pair {
                sample: k,
                instrument: V4::from_fn(|j, _| now[j]),
                regressor: V4::from_fn(|j, _| now[j + 4]),
                value: now[8],
            });
        }
    }
    out
}

pub(super) struct Solution {
    pub(super) theta: V4,
    /// Inverse of the sum of instrument times regressor.
    inverse: M4,
    pub(super) residual_rad_s: f64,
}

impl Solution {
    pub(super) fn of(pairs: &[Pair]) -> Result<Self, InstrumentalError> {
        let rows = pairs.len();
        if rows < FEWEST_ROWS {
            return Err(InstrumentalError::TooFewRows { rows });
        }
        let length = |of: &dyn Fn(&Pair, usize) -> f64| {
            V4::from_fn(|j, _| {
                let squares: f64 = pairs.iter().map(|pair| of(pair, j).powi(2)).sum();
                squares.sqrt().max(f64::MIN_POSITIVE)
            })
        };
        let norms = length(&|pair, j| pair.regressor[j]);
        let sizes = length(&|pair, j| pair.instrument[j]);
        let (mut normal, mut right) = (M4::zeros(), V4::zeros());
        for pair in pairs {
            let z = pair.instrument.component_div(&sizes);
            let x = pair.regressor.component_div(&norms);
            normal += z * x.transpose();
            right += z * pair.value;
        }
        let least = normal.singular_values().min();
        let inverse = normal
            .try_inverse()
            .filter(|_| least > LEAST_EXCITATION)
            .ok_or(InstrumentalError::NotExcited { least })?;
        let theta = (inverse * right).component_div(&norms);
        let inverse = M4::from_fn(|i, j| inverse[(i, j)] / (norms[i] * sizes[j]));
        let squares: f64 = pairs.iter().map(|pair| pair.error(&theta).powi(2)).sum();
        Ok(Self {
            theta,
            inverse,
            residual_rad_s: (squares / (rows - 4) as f64).sqrt(),
        })
    }

    /// Sandwich covariance of the coefficients; the scores are summed over stretches of several time constants, because
    /// the filtered errors of a chain share the error of its first samples.
    pub(super) fn covariance(&self, pairs: &[Pair], model: &Dynamics, period_s: f64) -> M4 {
        let stretch = whole((4.0 * (model.ta_s + model.tm_s) / period_s).clamp(20.0, 1e6))
            .min((pairs.len() / CLUSTERS).max(1));
        let mut meat = M4::zeros();
        let mut clusters = 0usize;
        for cluster in pairs.chunk_by(|a, b| a.sample / stretch == b.sample / stretch) {
            let score = cluster.iter().fold(V4::zeros(), |sum, pair| {
                sum + pair.instrument * pair.error(&self.theta)
            });
            meat += score * score.transpose();
            clusters += 1;
        }
        let correction = clusters as f64 / (clusters as f64 - 4.0).max(1.0);
        self.inverse * meat * self.inverse.transpose() * correction
    }
}

impl Pair {
    fn error(&self, theta: &V4) -> f64 {
        self.value - self.regressor.dot(theta)
    }
}

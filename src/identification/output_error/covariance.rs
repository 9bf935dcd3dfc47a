//! Covariance of the scaled parameters, clustered in blocks of time (DISCOVERY.md 2.12).

use nalgebra::{DMatrix, DVector};

use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::numerics::count::whole;
use crate::numerics::least_squares::{clustered, inverse_where_determined};
use crate::numerics::levenberg_marquardt::Minimum;
use crate::numerics::statistics;
use crate::plant::Scenario;

/// Length of one block, s.
pub const BLOCK_S: f64 = 0.25;

/// Block-clustered covariance at a minimum; NaN on the diagonal where the data leave a parameter undetermined. A variance
/// from some ten blocks is itself uncertain by a quarter: none counts that is below what white residuals of this size
/// would make.
pub(super) fn at_minimum(
    minimum: &Minimum,
    rows: &[(usize, bool)],
    scenario: &Scenario,
) -> DMatrix<f64> {
    let (bread, determined) = inverse_where_determined(&minimum.jacobian);
    let begin_s = rows
        .first()
        .map_or(0.0, |row| scenario.sample_time_s[row.0]);
    let blocks: Vec<usize> = rows
        .iter()
        .map(|row| whole((scenario.sample_time_s[row.0] - begin_s) / BLOCK_S))
        .collect();
    let residual = DVector::from_column_slice(&minimum.residual);
    let spare = residual.len().saturating_sub(bread.ncols()).max(1) as f64;
    let white = bread.diagonal() * (residual.norm_squared() / spare);
    let mut covariance = clustered(&minimum.jacobian, &residual, &blocks, bread, &determined);
    for (index, least) in white.iter().enumerate() {
        if covariance[(index, index)] < *least {
            covariance[(index, index)] = *least;
        }
    }
    covariance
}

/// What standard deviations are multiplied by where more than noise is left over (DISCOVERY.md 2.12).
const WIDENED: f64 = 2.0;
/// Error in units of the noise above which more than noise is left over.
const ABOVE_THE_NOISE: f64 = 1.1;

/// Factor on every standard deviation of a fit. Blocks cover what neighbouring samples share, but not what a missing effect
/// puts into whole stretches of the run: where the error stands above the noise, or is coloured, the interval is doubled.
/// It then holds if nothing else is missing.
pub(super) fn interval_factor(
    minimum: &Minimum,
    rows: &[(usize, bool)],
    noise: &NoiseFloor,
) -> f64 {
    let residual = minimum.residual.as_slice();
    let nrms = super::nrms(minimum, rows);
    let above = noise.source != FloorSource::None && nrms > noise.tolerance(ABOVE_THE_NOISE);
    let is_coloured = |speed: bool| {
        let of_signal: Vec<f64> = rows
            .iter()
            .zip(residual)
            .filter(|((_, is_speed), _)| *is_speed == speed)
            .map(|(_, value)| *value)
            .collect();
        statistics::is_coloured(&of_signal)
    };
    if above || is_coloured(false) || is_coloured(true) {
        WIDENED
    } else {
        1.0
    }
}

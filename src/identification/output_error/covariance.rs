//! Covariance of the scaled parameters, clustered in blocks of time (DISCOVERY.md 2.12).

use nalgebra::{DMatrix, DVector};

use crate::numerics::count::whole;
use crate::numerics::least_squares::{clustered, inverse_where_determined};
use crate::numerics::levenberg_marquardt::Minimum;
use crate::plant::Scenario;

/// Length of one block, s.
pub const BLOCK_S: f64 = 0.25;

/// Block-clustered covariance at a minimum; NaN on the diagonal where the data leave a parameter undetermined.
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
    clustered(&minimum.jacobian, &residual, &blocks, bread, &determined)
}

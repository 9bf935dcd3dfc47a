//! Block-clustered ("sandwich") covariance: honest where residuals are correlated (DISCOVERY.md 2.12).

use nalgebra::{DMatrix, DVector};

use crate::numerics::levenberg_marquardt::Minimum;
use crate::plant::Scenario;

/// Length of one block, s. Blocks are longer where there would be too many to be independent, never shorter.
pub const BLOCK_S: f64 = 0.25;
/// Blocks below which the meat of the sandwich is not trusted.
const FEWEST_BLOCKS: usize = 8;

/// Eigenvalue of the scaled normal matrix below which a direction is not determined by the data.
const UNDETERMINED: f64 = 1e-9;

/// Covariance of the scaled parameters: `A G A` with bread `A = (J'J)^-1` and meat summed over blocks of time; the
/// plain `A s^2` where there are too few blocks. A parameter that the data leave undetermined has a NaN variance and
/// takes no part in the others'.
pub(super) fn clustered(
    minimum: &Minimum,
    rows: &[(usize, bool)],
    scenario: &Scenario,
) -> DMatrix<f64> {
    let jacobian = &minimum.jacobian;
    let parameters = jacobian.ncols();
    let (bread, determined) = inverse_where_determined(jacobian);
    let time_s = |row: &(usize, bool)| scenario.sample_time_s[row.0];
    let begin_s = rows.first().map_or(0.0, time_s);
    let block_of = |row: &(usize, bool)| ((time_s(row) - begin_s) / BLOCK_S) as usize;
    let blocks = rows.last().map_or(0, block_of) + 1;
    let mut covariance = if blocks < FEWEST_BLOCKS.max(parameters + 2) {
        let spare = rows.len().saturating_sub(parameters).max(1) as f64;
        bread * (minimum.cost / spare)
    } else {
        let mut meat = DMatrix::zeros(parameters, parameters);
        let mut score = DVector::zeros(parameters);
        let mut current = 0;
        for (index, row) in rows.iter().enumerate() {
            if block_of(row) != current {
                meat += &score * score.transpose();
                score.fill(0.0);
                current = block_of(row);
            }
            for parameter in 0..parameters {
                score[parameter] += jacobian[(index, parameter)] * minimum.residual[index];
            }
        }
        meat += &score * score.transpose();
        &bread * meat * &bread * (blocks as f64 / (blocks - parameters) as f64)
    };
    for (index, determined) in determined.into_iter().enumerate() {
        if !determined {
            covariance[(index, index)] = f64::NAN;
        }
    }
    covariance
}

/// `(J'J)^-1` on the directions that the data determine, and which parameters those cover.
fn inverse_where_determined(jacobian: &DMatrix<f64>) -> (DMatrix<f64>, Vec<bool>) {
    let parameters = jacobian.ncols();
    let norms: Vec<f64> = (0..parameters)
        .map(|index| jacobian.column(index).norm())
        .collect();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    let mut determined: Vec<bool> = norms
        .iter()
        .map(|norm| *norm > 1e-12 * largest && *norm > 0.0)
        .collect();
    let scale = |index: usize| {
        if determined[index] {
            1.0 / norms[index]
        } else {
            0.0
        }
    };
    let scales: Vec<f64> = (0..parameters).map(scale).collect();
    let normal = jacobian.tr_mul(jacobian);
    let scaled = DMatrix::from_fn(parameters, parameters, |r, c| {
        normal[(r, c)] * scales[r] * scales[c]
    });
    let eigen = scaled.symmetric_eigen();
    let mut inverse = DMatrix::zeros(parameters, parameters);
    for (value, vector) in eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
    {
        if *value > UNDETERMINED {
            inverse += vector * vector.transpose() / *value;
        } else {
            for (index, component) in vector.iter().enumerate() {
                // Eigenvectors of the zero columns themselves are already known.
                if component * component > 1e-4 {
                    determined[index] = false;
                }
            }
        }
    }
    (
        DMatrix::from_fn(parameters, parameters, |r, c| {
            inverse[(r, c)] * scales[r] * scales[c]
        }),
        determined,
    )
}

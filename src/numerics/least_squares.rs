//! Linear least squares with columns scaled to one and a covariance that is honest about correlated residuals.

use nalgebra::{DMatrix, DVector};

/// Smallest eigenvalue of the scaled normal matrix for a direction to count as determined. Forward differences leave
/// about 1e-6 of a direction that is not (measured: 1.3e-6 without a speed, 0.06 and more where all is determined).
const UNDETERMINED: f64 = 1e-5;

/// Solution of `matrix x = right` in the least-squares sense.
#[derive(Clone, Debug)]
pub struct Solution {
    pub x: DVector<f64>,
    /// `A G A` with the meat summed over blocks; a parameter that the data leave undetermined has a NaN variance.
    pub covariance: DMatrix<f64>,
    /// `right - matrix x`.
    pub residual: DVector<f64>,
}

/// Solves with the block-clustered covariance; `block_of[row]` numbers the blocks in ascending order. The plain
/// covariance serves where there are too few blocks. `None` when there are no more rows than unknowns.
pub fn solve(matrix: &DMatrix<f64>, right: &DVector<f64>, block_of: &[usize]) -> Option<Solution> {
    let (rows, unknowns) = matrix.shape();
    if rows <= unknowns {
        return None;
    }
    let (bread, determined) = inverse_where_determined(matrix);
    let x = &bread * matrix.tr_mul(right);
    let residual = right - matrix * &x;
    let covariance = clustered(matrix, &residual, block_of, bread, &determined);
    Some(Solution {
        x,
        covariance,
        residual,
    })
}

/// Blocks below which the meat of the sandwich is not trusted.
const FEWEST_BLOCKS: usize = 8;

/// Sandwich covariance from the bread `(J'J)^-1`.
pub fn clustered(
    jacobian: &DMatrix<f64>,
    residual: &DVector<f64>,
    block_of: &[usize],
    bread: DMatrix<f64>,
    determined: &[bool],
) -> DMatrix<f64> {
    let unknowns = jacobian.ncols();
    let mut scores: Vec<DVector<f64>> = Vec::new();
    let mut current = None;
    for (row, block) in block_of.iter().enumerate() {
        if current != Some(block) {
            scores.push(DVector::zeros(unknowns));
            current = Some(block);
        }
        if let Some(score) = scores.last_mut() {
            score.axpy(residual[row], &jacobian.row(row).transpose(), 1.0);
        }
    }
    let blocks = scores.len();
    let mut covariance = if blocks < FEWEST_BLOCKS.max(unknowns + 2) {
        let spare = residual.len().saturating_sub(unknowns).max(1) as f64;
        bread * (residual.norm_squared() / spare)
    } else {
        let mut meat = DMatrix::zeros(unknowns, unknowns);
        for score in &scores {
            meat.ger(1.0, score, score, 1.0);
        }
        &bread * meat * &bread * (blocks as f64 / (blocks - unknowns) as f64)
    };
    for (index, determined) in determined.iter().enumerate() {
        if !determined {
            covariance[(index, index)] = f64::NAN;
        }
    }
    covariance
}

/// `(J'J)^-1` on the directions that the data determine, and which unknowns those cover.
pub fn inverse_where_determined(jacobian: &DMatrix<f64>) -> (DMatrix<f64>, Vec<bool>) {
    inverse_of_normal(&jacobian.tr_mul(jacobian))
}

/// The same from the normal matrix `J'J`.
pub fn inverse_of_normal(normal: &DMatrix<f64>) -> (DMatrix<f64>, Vec<bool>) {
    let unknowns = normal.ncols();
    if unknowns == 0 {
        return (DMatrix::zeros(0, 0), Vec::new());
    }
    let norms: Vec<f64> = normal
        .diagonal()
        .iter()
        .map(|square| square.sqrt())
        .collect();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    let mut determined: Vec<bool> = norms
        .iter()
        .map(|norm| *norm > 1e-12 * largest && *norm > 0.0)
        .collect();
    let scales: Vec<f64> = norms
        .iter()
        .zip(&determined)
        .map(|(norm, known)| if *known { 1.0 / norm } else { 0.0 })
        .collect();
    let scaled = DMatrix::from_fn(unknowns, unknowns, |r, c| {
        normal[(r, c)] * scales[r] * scales[c]
    });
    let eigen = scaled.symmetric_eigen();
    let mut inverse = DMatrix::zeros(unknowns, unknowns);
    for (value, vector) in eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
    {
        if *value > UNDETERMINED {
            inverse += vector * vector.transpose() / *value;
        } else {
            for (index, component) in vector.iter().enumerate() {
                if component * component > 1e-4 {
                    determined[index] = false;
                }
            }
        }
    }
    (
        DMatrix::from_fn(unknowns, unknowns, |r, c| {
            inverse[(r, c)] * scales[r] * scales[c]
        }),
        determined,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    fn data(seed: u64) -> (DMatrix<f64>, DVector<f64>, Vec<usize>) {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let matrix = DMatrix::from_fn(400, 2, |_, column| {
            (rng.random::<f64>() - 0.5) * [1.0, 1e5][column]
        });
        let right = DVector::from_fn(400, |row, _| {
            2.0 * matrix[(row, 0)] - 3e-5 * matrix[(row, 1)] + 0.1 * (rng.random::<f64>() - 0.5)
        });
        (matrix, right, (0..400).map(|row| row / 20).collect())
    }

    #[test]
    fn the_truth_lies_within_the_interval_however_the_columns_are_scaled() {
        let (mut outside, runs) = (0, 100);
        for seed in 0..runs {
            let (matrix, right, blocks) = data(seed);
            let solution = solve(&matrix, &right, &blocks).unwrap();
            let std = solution.covariance[(0, 0)].sqrt();
            outside += u32::from((solution.x[0] - 2.0).abs() > 2.1 * std);
            assert!((solution.x[1] + 3e-5).abs() < 1e-6);
        }
        assert!(outside <= 15, "{outside} of {runs}");
    }

    #[test]
    fn a_column_of_zeros_and_a_repeated_column_are_undetermined_and_spoil_nothing_else() {
        let (matrix, right, blocks) = data(1);
        let wide = DMatrix::from_fn(400, 4, |row, column| match column {
            0 => matrix[(row, 0)],
            1 | 2 => matrix[(row, 1)],
            _ => 0.0,
        });
        let solution = solve(&wide, &right, &blocks).unwrap();
        assert!((solution.x[0] - 2.0).abs() < 0.1 && solution.covariance[(0, 0)].is_finite());
        assert!((1..4).all(|index| solution.covariance[(index, index)].is_nan()));
        assert!(solve(&matrix.rows(0, 2).into(), &right.rows(0, 2).into(), &[0, 0]).is_none());
    }
}

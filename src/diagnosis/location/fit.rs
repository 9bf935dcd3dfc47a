//! Least squares over windows, row by row: no matrix of the run is ever held.

use nalgebra::{DMatrix, DVector};

use super::Equation;
use super::balance::{Window, Windows};

/// Share of the largest diagonal that keeps columns without data from being singular.
const RIDGE: f64 = 1e-9;

/// How much of an error some columns explain.
pub(super) struct Fitted {
    /// Coefficient of each column.
    pub coefficients: Vec<f64>,
    /// `1 - (RSS / (n - k)) / (TSS / n)`.
    pub adjusted: f64,
    /// Share of the squared error beyond the noise.
    pub follows: f64,
    /// Explained power over what chance gives to as many columns.
    pub strength: f64,
    pub columns: usize,
}

/// Fits the error of `equation` by `columns` values that `fill` gives for each window.
pub(super) fn fit(
    windows: &Windows<'_>,
    equation: Equation,
    columns: usize,
    mut fill: impl FnMut(&Window, &mut [f64]),
) -> Option<Fitted> {
    let mut normal: DMatrix<f64> = DMatrix::zeros(columns, columns);
    let mut right: DVector<f64> = DVector::zeros(columns);
    let mut row = vec![0.0; columns];
    let (mut power, mut noise, mut n) = (0.0, 0.0, 0.0);
    for window in windows.of(equation) {
        row.fill(0.0);
        fill(window, &mut row);
        if row.iter().any(|value| !value.is_finite()) {
            continue;
        }
        let error = window.error(equation);
        n += 1.0;
        power += error * error;
        noise += window.floor(equation).powi(2);
        for (at, value) in row.iter().enumerate() {
            if *value == 0.0 {
                continue;
            }
            right[at] += value * error;
            for (other, second) in row.iter().enumerate().skip(at) {
                normal[(at, other)] += value * second;
            }
        }
    }
    let k = columns as f64;
    if n < 3.0 * k + 10.0 || power <= 0.0 {
        return None;
    }
    normal.fill_lower_triangle_with_upper_triangle();
    // Columns in one unit, so that the ridge means the same for each.
    let scale: Vec<f64> = (0..columns).map(|at| normal[(at, at)].sqrt()).collect();
    let largest = scale.iter().fold(0.0, |most: f64, s| most.max(*s));
    if largest <= 0.0 {
        return None;
    }
    let inverse = |at: usize| {
        if scale[at] > 1e-9 * largest {
            1.0 / scale[at]
        } else {
            0.0
        }
    };
    for at in 0..columns {
        right[at] *= inverse(at);
        for other in 0..columns {
            normal[(at, other)] *= inverse(at) * inverse(other);
        }
        normal[(at, at)] += RIDGE + if inverse(at) == 0.0 { 1.0 } else { 0.0 };
    }
    let solved = normal.cholesky()?.solve(&right);
    let explained = solved.dot(&right).clamp(0.0, power);
    let left = power - explained;
    let per_chance = if noise > 0.0 {
        noise / n
    } else {
        left / (n - k)
    }
    .max(1e-12 * power / n);
    let adjusted = 1.0 - (left / (n - k)) / (power / n);
    let beyond = (power - noise).max(0.02 * power);
    Some(Fitted {
        coefficients: solved
            .iter()
            .enumerate()
            .map(|(at, x)| x * inverse(at))
            .collect(),
        adjusted,
        follows: ((explained - k * per_chance) / beyond).clamp(0.0, 1.0),
        strength: explained / (k * per_chance),
        columns,
    })
}

//! Curves from the weak-form balances.

use nalgebra::DMatrix;

use super::{AxisMap, HARMONICS, along, axes, explain, harmonics, knots, name, sentence};
use crate::identification::weak_form::Regression;
use crate::numerics::least_squares;
use crate::plant::Scenario;
use crate::plant::effect::{Axis, table_weights};

/// One map for each axis of this balance that the run knows.
pub(super) fn maps(regression: &Regression, scenario: &Scenario) -> Vec<AxisMap> {
    let error_over_noise = error_over_noise(regression);
    axes(regression.equation, scenario.input)
        .iter()
        .filter_map(|axis| map(*axis, regression, scenario, error_over_noise))
        .collect()
}

/// Residual over the noise floor.
pub(super) fn error_over_noise(regression: &Regression) -> Option<f64> {
    let Regression {
        matrix,
        right,
        blocks,
        ..
    } = regression;
    let residual = least_squares::solve(matrix, right, blocks)?.residual;
    let spare = (residual.len() - matrix.ncols()) as f64;
    Some((residual.norm_squared() / spare).sqrt() / regression.noise_floor?)
}

fn map(
    axis: Axis,
    regression: &Regression,
    scenario: &Scenario,
    error_over_noise: Option<f64>,
) -> Option<AxisMap> {
    let along = along(axis, scenario);
    let knots = knots(axis, &along);
    if knots.len() < 3 {
        return None;
    }
    let columns: Vec<_> = if axis == Axis::Angle {
        let all: Vec<[f64; 2 * HARMONICS]> = along.iter().map(|angle| harmonics(*angle)).collect();
        (0..2 * HARMONICS)
            .map(|column| regression.means(|sample| all[sample][column]))
            .collect()
    } else {
        let all: Vec<[(usize, f64); 2]> = along
            .iter()
            .map(|place| table_weights(axis, &knots, *place))
            .collect();
        let hat = |knot: usize, sample: usize| -> f64 {
            let [low, high] = all[sample];
            let of = |(at, weight): (usize, f64)| if at == knot { weight } else { 0.0 };
            // Added so that what is not known stays so.
            of(low) + of(high) + 0.0 * (low.1 + high.1)
        };
        (0..knots.len())
            .map(|knot| regression.means(|sample| hat(knot, sample)))
            .collect()
    };
    // Windows in which the axis is known throughout.
    let rows: Vec<usize> = (0..regression.right.len())
        .filter(|row| columns.iter().all(|column| column[*row].is_finite()))
        .collect();
    let columns = DMatrix::from_fn(rows.len(), columns.len(), |row, column| {
        columns[column][rows[row]]
    });
    let blocks: Vec<usize> = rows.iter().map(|row| regression.blocks[*row]).collect();
    let explained = explain(
        &regression.matrix.select_rows(&rows),
        &regression.right.select_rows(&rows),
        &columns,
        &blocks,
    )?;
    let shape = if axis == Axis::Angle {
        DMatrix::from_fn(knots.len(), 2 * HARMONICS, |knot, column| {
            harmonics(knots[knot])[column]
        })
    } else {
        DMatrix::identity(knots.len(), knots.len())
    };
    let (values, std) = explained.curve(&shape);
    Some(AxisMap {
        equation: name(regression.equation),
        axis: axis.key(),
        r2: explained.r2,
        sentence: sentence(
            regression.equation,
            axis,
            scenario,
            explained.r2,
            &knots,
            &values,
        ),
        knots,
        values,
        std,
        method: "weak_form",
        error_over_noise,
    })
}

//! Curves from the weak-form balances.

use nalgebra::{DMatrix, DVector};

use super::{
    AxisMap, CLOSEST_SHARE, Curve, FEWEST_KNOTS, FOLLOWS_SHARE, HARMONICS, along, axes, explain,
    harmonics, knots, name, sentence,
};
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

/// Rounds of refining, and knots that a curve may come to have.
const ROUNDS: usize = 5;
const MOST_KNOTS: usize = 32;
/// What a round must add to the share that is explained.
const WORTH_REFINING: f64 = 0.004;
/// Share of an average knot's data below which a knot is left out: the run was never there, or did not move.
const LEAST_DATA: f64 = 0.02;

fn map(
    axis: Axis,
    regression: &Regression,
    scenario: &Scenario,
    error_over_noise: Option<f64>,
) -> Option<AxisMap> {
    let along = along(axis, scenario);
    let places = knots(axis, &along);
    if places.len() < FEWEST_KNOTS {
        return None;
    }
    let curve = if axis == Axis::Angle {
        turn(regression, &along, places)?
    } else {
        let hats = Hats {
            axis,
            regression,
            along: &along,
        };
        let places = hats.with_data(places);
        let mut best = hats.fit(places)?;
        // Where nothing is followed a finer curve would follow the noise.
        let refines = axis != Axis::Time && best.r2 >= FOLLOWS_SHARE;
        for _ in 0..if refines { ROUNDS } else { 0 } {
            let Some(finer) = refined(&best).and_then(|places| hats.fit(hats.with_data(places)))
            else {
                break;
            };
            if finer.r2 < best.r2 + WORTH_REFINING {
                break;
            }
            best = finer;
        }
        best
    };
    Some(AxisMap {
        equation: name(regression.equation),
        axis: axis.key(),
        r2: curve.r2,
        sentence: sentence(regression.equation, axis, scenario, &curve),
        knots: curve.knots,
        values: curve.values,
        std: curve.std,
        method: "weak_form",
        error_over_noise,
    })
}

/// Harmonics over a turn.
fn turn(regression: &Regression, along: &[f64], knots: Vec<f64>) -> Option<Curve> {
    let all: Vec<[f64; 2 * HARMONICS]> = along.iter().map(|angle| harmonics(*angle)).collect();
    let columns: Vec<DVector<f64>> = (0..2 * HARMONICS)
        .map(|column| regression.means(|sample| all[sample][column]))
        .collect();
    let shape = DMatrix::from_fn(knots.len(), 2 * HARMONICS, |knot, column| {
        harmonics(knots[knot])[column]
    });
    fitted(regression, &columns, knots, &shape)
}

/// Hat functions over an axis.
struct Hats<'a> {
    axis: Axis,
    regression: &'a Regression,
    along: &'a [f64],
}

impl Hats<'_> {
    fn columns(&self, knots: &[f64]) -> Vec<DVector<f64>> {
        let all: Vec<[(usize, f64); 2]> = self
            .along
            .iter()
            .map(|place| table_weights(self.axis, knots, *place))
            .collect();
        let hat = |knot: usize, sample: usize| -> f64 {
            let [low, high] = all[sample];
            let of = |(at, weight): (usize, f64)| if at == knot { weight } else { 0.0 };
            // Added so that what is not known stays so.
            of(low) + of(high) + 0.0 * (low.1 + high.1)
        };
        (0..knots.len())
            .map(|knot| self.regression.means(|sample| hat(knot, sample)))
            .collect()
    }

    /// The knots that the usable windows say something about.
    fn with_data(&self, knots: Vec<f64>) -> Vec<f64> {
        let data: Vec<f64> = self
            .columns(&knots)
            .iter()
            .map(|column| {
                column
                    .iter()
                    .filter(|cell| cell.is_finite())
                    .map(|c| c * c)
                    .sum()
            })
            .collect();
        let least = LEAST_DATA * data.iter().sum::<f64>() / data.len() as f64;
        let kept = knots
            .into_iter()
            .zip(&data)
            .filter(|(_, data)| **data >= least);
        kept.map(|(knot, _)| knot).collect()
    }

    fn fit(&self, knots: Vec<f64>) -> Option<Curve> {
        if knots.len() < FEWEST_KNOTS {
            return None;
        }
        let shape = DMatrix::identity(knots.len(), knots.len());
        fitted(self.regression, &self.columns(&knots), knots, &shape)
    }
}

/// Knots halfway beside the two sharpest bends of a curve.
fn refined(curve: &Curve) -> Option<Vec<f64>> {
    let (knots, values) = (&curve.knots, &curve.values);
    let last = knots.len() - 1;
    let closest = CLOSEST_SHARE * (knots[last] - knots[0]);
    let slope = |at: usize| (values[at + 1] - values[at]) / (knots[at + 1] - knots[at]);
    let bend = |at: usize| (slope(at) - slope(at - 1)).abs();
    let mut bends: Vec<usize> = (1..last).collect();
    bends.sort_by(|a, b| bend(*b).total_cmp(&bend(*a)));
    let mut finer = knots.clone();
    for at in bends.into_iter().take(2) {
        for (low, high) in [(at - 1, at), (at, at + 1)] {
            let middle = 0.5 * (knots[low] + knots[high]);
            if knots[high] - knots[low] > 2.0 * closest && !finer.contains(&middle) {
                finer.push(middle);
            }
        }
    }
    finer.sort_by(f64::total_cmp);
    (finer.len() > knots.len() && finer.len() <= MOST_KNOTS).then_some(finer)
}

fn fitted(
    regression: &Regression,
    columns: &[DVector<f64>],
    knots: Vec<f64>,
    shape: &DMatrix<f64>,
) -> Option<Curve> {
    // Windows in which the axis is known throughout.
    let rows: Vec<usize> = (0..regression.right.len())
        .filter(|row| columns.iter().all(|column| column[*row].is_finite()))
        .collect();
    let matrix = DMatrix::from_fn(rows.len(), columns.len(), |row, column| {
        columns[column][rows[row]]
    });
    let blocks: Vec<usize> = rows.iter().map(|row| regression.blocks[*row]).collect();
    let explained = explain(
        &regression.matrix.select_rows(&rows),
        &regression.right.select_rows(&rows),
        &matrix,
        &blocks,
    )?;
    Some(explained.curve(knots, shape))
}

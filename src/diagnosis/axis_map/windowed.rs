//! Curves from short free runs, where the samples are too far apart for a balance of averages.
//!
//! The model is started afresh from the measurement every tenth of a second; what it misses within is linear in a small
//! curve in either equation. A simulation with each hat function raised gives its column; the baseline's own parameters
//! have theirs. Right at any sampling period, because nothing is averaged and nothing differentiated.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::{AxisMap, FEWEST_KNOTS, along, axes, explain, knots, name, sentence};
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::identification::output_error::{self, BLOCK_S, FitError};
use crate::numerics::count::whole;
use crate::plant::effect::{self, Axis};
use crate::plant::{ActiveEffect, Balance, Model, Plant, Scenario, State, typical_size};

/// Length of a window, s: the noise of its start shall not hide what the curve does.
const WINDOW_S: f64 = 0.1;
/// Relative step of a parameter of the baseline.
const STEP: f64 = 1e-3;

/// Free runs of the model over windows.
struct Windows<'a> {
    scenario: &'a Scenario,
    noise: &'a NoiseFloor,
    start: State,
    horizon: usize,
    /// `(sample, is_speed)` of every error.
    rows: Vec<(usize, bool)>,
    blocks: Vec<usize>,
}

impl Windows<'_> {
    /// What the model predicts, in units of the noise.
    fn predicted(&self, model: &Model) -> Result<DVector<f64>, FitError> {
        let ahead = Plant::new(model, self.scenario.input)?.predict_ahead(
            self.scenario,
            self.start,
            self.horizon,
        );
        Ok(DVector::from_iterator(
            self.rows.len(),
            self.rows.iter().map(|(sample, is_speed)| {
                if *is_speed {
                    ahead.speed_rad_s[*sample] / self.noise.speed_rad_s
                } else {
                    ahead.current_a[*sample] / self.noise.current_a
                }
            }),
        ))
    }
}

pub(super) fn maps(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<AxisMap>, FitError> {
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let prediction = output_error::predict(model, scenario, noise)?;
    let model = prediction.model;
    let rows: Vec<(usize, bool)> = scenario
        .scored
        .clone()
        .flat_map(|sample| [(sample, false), (sample, true)])
        .filter(|(sample, is_speed)| {
            if *is_speed {
                scenario.speed_rad_s[*sample].is_finite() && noise.speed_rad_s.is_finite()
            } else {
                scenario.current_a[*sample].is_finite() && noise.current_a.is_finite()
            }
        })
        .collect();
    let block = |row: &(usize, bool)| whole((times[row.0] - times[0]) / BLOCK_S);
    let windows = Windows {
        blocks: rows.iter().map(block).collect(),
        scenario,
        noise,
        start: prediction.start,
        horizon: whole((WINDOW_S / period_s).round()).max(1),
        rows,
    };
    let predicted = windows.predicted(&model)?;
    let errors = DVector::from_fn(windows.rows.len(), |row, _| {
        let (sample, is_speed) = windows.rows[row];
        let measured = if is_speed {
            scenario.speed_rad_s[sample] / noise.speed_rad_s
        } else {
            scenario.current_a[sample] / noise.current_a
        };
        measured - predicted[row]
    });
    let base = of_parameters(&model, &windows, &predicted)?;
    let error_over_noise =
        (noise.source != FloorSource::None).then(|| errors.norm() / (errors.len() as f64).sqrt());
    let wanted: Vec<(Balance, Axis)> = [Balance::Torque, Balance::Voltage]
        .into_iter()
        .flat_map(|equation| {
            let axes = axes(equation, scenario.input).iter();
            axes.map(move |axis| (equation, *axis))
        })
        .collect();
    let found: Result<Vec<Option<AxisMap>>, FitError> = wanted
        .into_par_iter()
        .map(|(equation, axis)| {
            map(
                &model,
                &windows,
                equation,
                axis,
                (&base, &predicted, &errors),
                error_over_noise,
            )
        })
        .collect();
    Ok(found?.into_iter().flatten().collect())
}

/// What a relative change of each free parameter does.
fn of_parameters(
    model: &Model,
    windows: &Windows<'_>,
    predicted: &DVector<f64>,
) -> Result<DMatrix<f64>, FitError> {
    let mut columns = Vec::new();
    for slot in model.free_slots() {
        let Some(value) = model.get(&slot).filter(|value| *value != 0.0) else {
            continue;
        };
        let mut moved = model.clone();
        moved.set(&slot, value * (1.0 + STEP));
        columns.push((windows.predicted(&moved)? - predicted) / STEP);
    }
    Ok(if columns.is_empty() {
        DMatrix::zeros(predicted.len(), 0)
    } else {
        DMatrix::from_columns(&columns)
    })
}

fn map(
    model: &Model,
    windows: &Windows<'_>,
    equation: Balance,
    axis: Axis,
    (base, predicted, errors): (&DMatrix<f64>, &DVector<f64>, &DVector<f64>),
    error_over_noise: Option<f64>,
) -> Result<Option<AxisMap>, FitError> {
    let scenario = windows.scenario;
    let knots = knots(axis, &along(axis, scenario));
    if knots.len() < FEWEST_KNOTS {
        return Ok(None);
    }
    let settings = toml::Table::from_iter([
        ("equation".to_owned(), toml::Value::from(name(equation))),
        ("axis".to_owned(), axis.key().into()),
        (
            "knots".to_owned(),
            toml::Value::Array(knots.iter().copied().map(toml::Value::from).collect()),
        ),
    ]);
    let Ok((effect, _)) = effect::define("table", &settings) else {
        return Ok(None);
    };
    let mut columns = Vec::with_capacity(knots.len());
    for knot in 0..knots.len() {
        let size = typical_size(effect, knot, model, scenario);
        let mut values = vec![Some(0.0); knots.len()];
        values[knot] = Some(size);
        let mut raised = model.clone();
        raised.effects.push(ActiveEffect { effect, values });
        columns.push((windows.predicted(&raised)? - predicted) / size);
    }
    let columns = DMatrix::from_columns(&columns);
    let Some(explained) = explain(base, errors, &columns, &windows.blocks) else {
        return Ok(None);
    };
    let shape = DMatrix::identity(knots.len(), knots.len());
    let curve = explained.curve(knots, &shape);
    let sentence = format!(
        "{} (from short free runs: the samples are too far apart to resolve the armature circuit)",
        sentence(equation, axis, scenario, &curve)
    );
    Ok(Some(AxisMap {
        equation: name(equation),
        axis: axis.key(),
        r2: curve.r2,
        knots: curve.knots,
        values: curve.values,
        std: curve.std,
        sentence,
        method: "windowed_free_run",
        error_over_noise,
    }))
}

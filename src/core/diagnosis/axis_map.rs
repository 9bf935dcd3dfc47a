//! The axis map: what the error of each equation follows, as a curve, before it has a name.
//!
//! ```text
//! balance of each equation --> hat functions over speed, current, voltage, time; harmonics of the angle
//!   residual of windows of the weak form, where the armature circuit is resolved
//!   errors of short free runs, where it is not                             --> refit --> adjusted R2, curve
//!   periodogram of the torque residual                                     --> line at f Hz with its share
//! ```
//!
//! The current is no axis of the torque balance and the voltage none of the voltage balance: they are what the balance
//! is solved for. A part of a curve that a parameter of the baseline explains as well is left to that parameter.

use std::fmt::Write as _;

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::Serialize;

use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::identification::output_error::{self, BLOCK_S, FitError};
use crate::identification::weak_form::{self, Regression};
use crate::numerics::count::whole;
use crate::numerics::least_squares;
use crate::plant::effect::{self, Axis, table_weights};
use crate::plant::{
    ActiveEffect, Balance, Input, Model, MotorKey, Plant, Scenario, State, typical_size,
};
use crate::text::number::{share, significant};

/// Hat functions over speed, current or voltage, and over time.
const KNOTS: usize = 14;
const KNOTS_IN_TIME: usize = 24;
/// Harmonics of the angle, and the knots at which the curve over a turn is given.
const HARMONICS: usize = 4;
const KNOTS_OF_A_TURN: usize = 16;
/// Share of the range that two knots are apart at least.
const CLOSEST_SHARE: f64 = 0.01;
/// Sampling periods in an electrical time constant from which on the voltage balance is resolved.
const RESOLVED_PERIODS: f64 = 3.0;
/// Knots that a curve has at least.
const FEWEST_KNOTS: usize = 3;
/// Standard deviations from which on a value counts as found.
const FOUND_SIGMAS: f64 = 3.0;
/// Adjusted R2 below which an error is not said to follow an axis.
const FOLLOWS_SHARE: f64 = 0.1;

/// How far the error of one equation follows one axis, and the curve.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisMap {
    /// `torque` or `voltage`.
    pub equation: &'static str,
    /// `speed_rad_s`, `current_a`, `voltage_v`, `angle_rad`, `time_s` (since the run's first command), or
    /// `frequency_hz`: a line in the spectrum of the torque error.
    pub axis: &'static str,
    /// Adjusted share of the error's variance that follows the axis.
    pub r2: f64,
    /// Places on the axis; of a line its frequency.
    pub knots: Vec<f64>,
    /// What the equation lacks there, V or N.m, a loss counted positive; of a line its amplitude.
    pub values: Vec<f64>,
    /// Standard deviation of each value, clustered in blocks of time.
    pub std: Vec<f64>,
    /// `weak_form`, or `windowed_free_run` where the samples do not resolve the armature circuit.
    pub method: &'static str,
    /// The equation's residual over what measurement noise alone would leave; `None` where the noise is not known.
    pub error_over_noise: Option<f64>,
    pub sentence: String,
}

impl AxisMap {
    /// Whether so much of the error follows the axis that it is worth a word.
    pub fn is_followed(&self) -> bool {
        self.r2 >= FOLLOWS_SHARE
    }
}

/// The maps of both balances, those that explain most first.
///
/// # Errors
/// Where the samples do not resolve the armature circuit: as the free run of `model`, which must be complete then.
pub fn axis_map(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<AxisMap>, FitError> {
    let balances = weak_form::regressions(model, scenario);
    let mut maps = if is_resolved(model, scenario) {
        let of_balance = |balance| weak_maps(balance, scenario);
        balances.iter().flat_map(of_balance).collect()
    } else {
        free_run_maps(model, scenario, noise)?
    };
    // A line is slow beside the armature circuit, if it is found at all.
    let lines = balances
        .iter()
        .filter_map(|one| strongest_line(one, scenario));
    maps.extend(lines);
    maps.sort_by(|a, b| b.r2.total_cmp(&a.r2));
    Ok(maps)
}

/// Whether the samples resolve the armature circuit; without a voltage there is none to resolve.
fn is_resolved(model: &Model, scenario: &Scenario) -> bool {
    let constant = |key| model.motor.get(key);
    let (inductance, resistance) = (
        constant(MotorKey::Inductance),
        constant(MotorKey::Resistance),
    );
    match inductance.zip(resistance) {
        Some((inductance, resistance)) if scenario.input == Input::Voltage => {
            scenario.mean_period_s() * RESOLVED_PERIODS <= inductance / resistance
        }
        _ => true,
    }
}

/// The axes of a balance. The input of a run that is driven by current or torque is what its balance is solved for.
fn axes(equation: Balance, input: Input) -> &'static [Axis] {
    match (equation, input) {
        (Balance::Voltage, _) => &[Axis::Speed, Axis::Current, Axis::Angle, Axis::Time],
        (Balance::Torque, Input::Voltage) => &[Axis::Speed, Axis::Voltage, Axis::Angle, Axis::Time],
        (Balance::Torque, Input::Current | Input::Torque) => {
            &[Axis::Speed, Axis::Angle, Axis::Time]
        }
    }
}

/// The scenario along an axis: its value at every sample, NaN where it is not known.
fn along(axis: Axis, scenario: &Scenario) -> Vec<f64> {
    let times = scenario.sample_time_s.iter();
    match axis {
        Axis::Speed => scenario.speed_rad_s.clone(),
        Axis::Current => scenario.current_a.clone(),
        Axis::Angle => weak_form::angles(scenario),
        Axis::Time => times.map(|time_s| time_s - scenario.begin_s()).collect(),
        Axis::Voltage => times.map(|time_s| scenario.input_at(*time_s)).collect(),
    }
}

/// Knots over what the run reached: each between as many samples as the next, time and angle evenly.
fn knots(axis: Axis, along: &[f64]) -> Vec<f64> {
    if axis == Axis::Angle {
        let step = TAU / KNOTS_OF_A_TURN as f64;
        return (0..KNOTS_OF_A_TURN)
            .map(|knot| knot as f64 * step)
            .collect();
    }
    let mut sorted: Vec<f64> = along.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let (Some(&first), Some(&last)) = (sorted.first(), sorted.last()) else {
        return Vec::new();
    };
    let count = if axis == Axis::Time {
        KNOTS_IN_TIME
    } else {
        KNOTS
    };
    let mut knots: Vec<f64> = Vec::with_capacity(count);
    for knot in 0..count {
        let share = knot as f64 / (count - 1) as f64;
        let even = first + share * (last - first);
        let at = if axis == Axis::Time {
            even
        } else {
            // Half way to even spacing: where the run was seldom, a curve is still asked for.
            let place = knot * (sorted.len() - 1) / (count - 1);
            0.5 * (sorted[place] + even)
        };
        if knots
            .last()
            .is_none_or(|before| at - before > CLOSEST_SHARE * (last - first))
        {
            knots.push(at);
        }
    }
    knots
}

/// What follows from adding `columns` to a balance: adjusted R2, coefficients and their covariance.
struct Explained {
    r2: f64,
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// Refits with `columns` beside `base`. The columns count only with what `base` cannot explain as well; directions
/// that are then lost (a curve over the current that is a resistance) stay at zero.
fn explain(
    base: &DMatrix<f64>,
    right: &DVector<f64>,
    columns: &DMatrix<f64>,
    blocks: &[usize],
) -> Option<Explained> {
    let (rows, added) = columns.shape();
    if rows <= base.ncols() + added {
        return None;
    }
    let (bread, _) = least_squares::inverse_where_determined(base);
    let left_over = |of: &DMatrix<f64>| of - base * (&bread * base.tr_mul(of));
    let residual = left_over(&DMatrix::from_columns(std::slice::from_ref(right)));
    let residual = DVector::from_column_slice(residual.as_slice());
    let own = left_over(columns);
    let (own_bread, _) = least_squares::inverse_where_determined(&own);
    let coefficients = &own_bread * own.tr_mul(&residual);
    let left = &residual - &own * &coefficients;
    let spare = (rows - base.ncols()) as f64;
    let variance = residual.norm_squared() / spare;
    let r2 = 1.0 - left.norm_squared() / (spare - added as f64) / variance;
    let known = vec![true; added];
    let covariance = least_squares::clustered(&own, &left, blocks, own_bread, &known);
    r2.is_finite().then_some(Explained {
        r2,
        coefficients,
        covariance,
    })
}

/// A curve with what it explains.
struct Curve {
    r2: f64,
    knots: Vec<f64>,
    values: Vec<f64>,
    std: Vec<f64>,
}

impl Explained {
    /// The curve at its knots, `shape` giving its values for the coefficients.
    fn curve(&self, knots: Vec<f64>, shape: &DMatrix<f64>) -> Curve {
        let values = shape * &self.coefficients;
        let covariance = shape * &self.covariance * shape.transpose();
        let deviations = covariance
            .diagonal()
            .map(|variance| variance.max(0.0).sqrt());
        Curve {
            r2: self.r2,
            knots,
            values: values.as_slice().to_vec(),
            std: deviations.as_slice().to_vec(),
        }
    }
}

impl Curve {
    /// The knot with the largest value that stands out from its uncertainty.
    fn peak(&self) -> Option<usize> {
        let sure = |knot: &usize| self.values[*knot].abs() > FOUND_SIGMAS * self.std[*knot];
        (0..self.values.len())
            .filter(sure)
            .max_by(|a, b| self.values[*a].abs().total_cmp(&self.values[*b].abs()))
    }
}

/// Sines and cosines of the harmonics of an angle.
fn harmonics(angle_rad: f64) -> [f64; 2 * HARMONICS] {
    std::array::from_fn(|index| {
        let order = (index / 2 + 1) as f64;
        let phase = order * angle_rad;
        if index % 2 == 0 {
            phase.sin()
        } else {
            phase.cos()
        }
    })
}

impl AxisMap {
    /// A curve that `method` found, with what is said of it.
    fn of(
        equation: Balance,
        axis: Axis,
        scenario: &Scenario,
        curve: Curve,
        (method, error_over_noise): (&'static str, Option<f64>),
    ) -> Self {
        let along = match axis {
            Axis::Speed => "speed",
            Axis::Current => "current",
            Axis::Voltage => "voltage",
            Axis::Angle if scenario.angle.is_empty() => "angle, integrated from the speed",
            Axis::Angle => "angle",
            Axis::Time => "time",
        };
        let what = equation.key();
        let mut sentence = if curve.r2 < FOLLOWS_SHARE {
            format!("the {what} error does not follow the {along}")
        } else {
            format!(
                "{} of the {what} error follows the {along}",
                share(curve.r2)
            )
        };
        if let Some(peak) = curve.peak().filter(|_| curve.r2 >= FOLLOWS_SHARE) {
            let [place, height] =
                [curve.knots[peak], curve.values[peak]].map(|v| significant(v, 3));
            let (across, upwards) = (axis.unit(), equation.unit());
            let _ = write!(
                sentence,
                "; it is largest near {place} {across}: {height} {upwards}"
            );
        }
        Self {
            equation: what,
            axis: axis.key(),
            r2: curve.r2,
            knots: curve.knots,
            values: curve.values,
            std: curve.std,
            method,
            error_over_noise,
            sentence,
        }
    }
}

/// One map for each axis of this balance that the run knows.
fn weak_maps(regression: &Regression, scenario: &Scenario) -> Vec<AxisMap> {
    let error_over_noise = error_over_noise(regression);
    axes(regression.equation, scenario.input)
        .iter()
        .filter_map(|axis| weak_map(*axis, regression, scenario, error_over_noise))
        .collect()
}

/// Residual over the noise floor.
fn error_over_noise(regression: &Regression) -> Option<f64> {
    let (matrix, right) = (&regression.matrix, &regression.right);
    let residual = least_squares::solve(matrix, right, &regression.blocks)?.residual;
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

fn weak_map(
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
    let by = ("weak_form", error_over_noise);
    Some(AxisMap::of(regression.equation, axis, scenario, curve, by))
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
        let squares = |column: &DVector<f64>| {
            let known = column.iter().filter(|cell| cell.is_finite());
            known.map(|cell| cell * cell).sum()
        };
        let data: Vec<f64> = self.columns(&knots).iter().map(squares).collect();
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

// Curves from short free runs, where the samples are too far apart for a balance of averages.
//
// The model is started afresh from the measurement every tenth of a second; what it misses within is linear in a small
// curve in either equation. A simulation with each hat function raised gives its column; the baseline's own parameters
// have theirs. Right at any sampling period, because nothing is averaged and nothing differentiated.

/// Length of a window, s: the noise of its start shall not hide what the curve does.
const WINDOW_S: f64 = 0.1;
/// Relative step of a parameter of the baseline.
const STEP: f64 = 1e-3;

/// Free runs of the model over windows.
struct FreeRuns<'a> {
    scenario: &'a Scenario,
    noise: &'a NoiseFloor,
    model: Model,
    start: State,
    horizon: usize,
    /// `(sample, is_speed)` of every error.
    rows: Vec<(usize, bool)>,
    blocks: Vec<usize>,
    /// What the model itself predicts, what the measurement has beyond that, and what a relative change of each free
    /// parameter does to it.
    predicted: DVector<f64>,
    errors: DVector<f64>,
    base: DMatrix<f64>,
    error_over_noise: Option<f64>,
}

impl<'a> FreeRuns<'a> {
    fn new(model: &Model, scenario: &'a Scenario, noise: &'a NoiseFloor) -> Result<Self, FitError> {
        let times = &scenario.sample_time_s;
        let prediction = output_error::predict(model, scenario, noise)?;
        let is_known = |&(sample, is_speed): &(usize, bool)| {
            let (value, level) = if is_speed {
                (scenario.speed_rad_s[sample], noise.speed_rad_s)
            } else {
                (scenario.current_a[sample], noise.current_a)
            };
            value.is_finite() && level.is_finite()
        };
        let samples = scenario.scored.clone();
        let rows = samples.flat_map(|sample| [(sample, false), (sample, true)]);
        let rows: Vec<(usize, bool)> = rows.filter(is_known).collect();
        let block = |row: &(usize, bool)| whole((times[row.0] - times[0]) / BLOCK_S);
        let mut runs = Self {
            blocks: rows.iter().map(block).collect(),
            scenario,
            noise,
            model: prediction.model,
            start: prediction.start,
            horizon: whole((WINDOW_S / scenario.mean_period_s()).round()).max(1),
            rows,
            predicted: DVector::zeros(0),
            errors: DVector::zeros(0),
            base: DMatrix::zeros(0, 0),
            error_over_noise: None,
        };
        runs.predicted = runs.of(&runs.model)?;
        runs.errors = runs.weighed(&scenario.current_a, &scenario.speed_rad_s) - &runs.predicted;
        let rms = runs.errors.norm() / (runs.errors.len() as f64).sqrt();
        runs.error_over_noise = (noise.source != FloorSource::None).then_some(rms);
        let mut columns = Vec::new();
        for slot in runs.model.free_slots() {
            let value = runs.model.get(&slot).filter(|value| *value != 0.0);
            let Some(value) = value else { continue };
            let mut moved = runs.model.clone();
            moved.set(&slot, value * (1.0 + STEP));
            columns.push((runs.of(&moved)? - &runs.predicted) / STEP);
        }
        runs.base = if columns.is_empty() {
            DMatrix::zeros(runs.rows.len(), 0)
        } else {
            DMatrix::from_columns(&columns)
        };
        Ok(runs)
    }

    /// Both signals in its rows, in units of the noise.
    fn weighed(&self, current_a: &[f64], speed_rad_s: &[f64]) -> DVector<f64> {
        let weighed = self.rows.iter().map(|(sample, is_speed)| {
            if *is_speed {
                speed_rad_s[*sample] / self.noise.speed_rad_s
            } else {
                current_a[*sample] / self.noise.current_a
            }
        });
        DVector::from_iterator(self.rows.len(), weighed)
    }

    /// What a model predicts.
    fn of(&self, model: &Model) -> Result<DVector<f64>, FitError> {
        let mut plant = Plant::new(model, self.scenario.input)?;
        let ahead = plant.predict_ahead(self.scenario, self.start, self.horizon);
        Ok(self.weighed(&ahead.current_a, &ahead.speed_rad_s))
    }

    fn map(&self, equation: Balance, axis: Axis) -> Result<Option<AxisMap>, FitError> {
        let knots = knots(axis, &along(axis, self.scenario));
        if knots.len() < FEWEST_KNOTS {
            return Ok(None);
        }
        let places = knots.iter().copied().map(toml::Value::from);
        let settings = toml::Table::from_iter([
            ("equation".to_owned(), equation.key().into()),
            ("axis".to_owned(), axis.key().into()),
            ("knots".to_owned(), toml::Value::Array(places.collect())),
        ]);
        let Ok((effect, _)) = effect::define("table", &settings) else {
            return Ok(None);
        };
        let mut columns = Vec::with_capacity(knots.len());
        for knot in 0..knots.len() {
            let size = typical_size(effect, knot, &self.model, self.scenario);
            let mut values = vec![Some(0.0); knots.len()];
            values[knot] = Some(size);
            let mut raised = self.model.clone();
            raised.effects.push(ActiveEffect { effect, values });
            columns.push((self.of(&raised)? - &self.predicted) / size);
        }
        let columns = DMatrix::from_columns(&columns);
        let Some(explained) = explain(&self.base, &self.errors, &columns, &self.blocks) else {
            return Ok(None);
        };
        let shape = DMatrix::identity(knots.len(), knots.len());
        let curve = explained.curve(knots, &shape);
        let by = ("windowed_free_run", self.error_over_noise);
        let mut map = AxisMap::of(equation, axis, self.scenario, curve, by);
        map.sentence += " (from short free runs: the samples are too far apart to resolve the armature circuit)";
        Ok(Some(map))
    }
}

fn free_run_maps(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<AxisMap>, FitError> {
    let runs = FreeRuns::new(model, scenario, noise)?;
    let wanted = [Balance::Torque, Balance::Voltage].into_iter();
    let wanted = wanted.flat_map(|equation| {
        let axes = axes(equation, scenario.input).iter();
        axes.map(move |axis| (equation, *axis))
    });
    let wanted: Vec<(Balance, Axis)> = wanted.collect();
    let maps = wanted.into_par_iter();
    let maps = maps.map(|(equation, axis)| runs.map(equation, axis));
    let found: Vec<Option<AxisMap>> = maps.collect::<Result<_, FitError>>()?;
    Ok(found.into_iter().flatten().collect())
}

// A line in the spectrum of the torque error: a shaker, a belt, a mains hum that turns the shaft.

/// Windows of a run that are looked at: enough to resolve a line to a part in a thousand of the highest frequency.
const MOST_WINDOWS: usize = 2000;
/// Share of a line's explained variance that the next may have for it to be a line of its own.
const ALONE: f64 = 0.5;
/// Frequencies per resolved line.
const OVERSAMPLING: f64 = 4.0;

/// The frequency at which a sine and a cosine explain most of the torque error.
fn strongest_line(regression: &Regression, scenario: &Scenario) -> Option<AxisMap> {
    let windows = regression.right.len().min(MOST_WINDOWS);
    if regression.equation != Balance::Torque || windows < 40 {
        return None;
    }
    let base = regression.matrix.rows(0, windows).into_owned();
    let right = DVector::from_fn(windows, |row, _| regression.right[row]);
    let times = &regression.time_s[..windows];
    let blocks = &regression.blocks[..windows];
    let begin_s = scenario.begin_s();
    let length_s = times[windows - 1] - times[0];
    let stride_s = shortest_stride(times)?;
    let step_hz = 1.0 / (OVERSAMPLING * length_s);
    let highest_hz = 0.5 / stride_s;
    let lowest_hz = 2.0 / length_s;
    let wave = |frequency_hz: f64| {
        DMatrix::from_fn(windows, 2, |row, column| {
            let phase = TAU * frequency_hz * (times[row] - begin_s);
            if column == 0 {
                phase.sin()
            } else {
                phase.cos()
            }
        })
    };
    let gain = |frequency_hz: f64| {
        explain(&base, &right, &wave(frequency_hz), blocks)
            .map_or(f64::NEG_INFINITY, |found| found.r2)
    };
    let tried = whole(((highest_hz - lowest_hz) / step_hz).max(1.0));
    let tries = (0..tried).map(|place| lowest_hz + place as f64 * step_hz);
    let spectrum: Vec<(f64, f64)> = tries.map(|at_hz| (at_hz, gain(at_hz))).collect();
    let strongest = |points: &mut dyn Iterator<Item = &(f64, f64)>| {
        points.copied().max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let best = strongest(&mut spectrum.iter())?;
    // An error that goes with the excitation has many lines, and none is its cause.
    let apart = |point: &&(f64, f64)| (point.0 - best.0).abs() > 2.0 / length_s;
    let second = strongest(&mut spectrum.iter().filter(apart)).map_or(0.0, |point| point.1);
    let frequency_hz = best_near(best.0, step_hz, gain);
    // What the window takes from a wave of this frequency is given back to its amplitude.
    let seen = attenuation(regression, scenario, frequency_hz);
    let found = explain(&base, &right, &wave(frequency_hz), blocks)?;
    let amplitude = found.coefficients.norm() / seen;
    let along = &found.coefficients / found.coefficients.norm();
    let variance = (along.transpose() * &found.covariance * &along)[(0, 0)];
    // The best of many frequencies explains something of any noise: as many columns more as that is worth.
    let spare = (windows - base.ncols()) as f64;
    let chance = 2.0 * (tried as f64).ln().max(0.0);
    let r2 = 1.0 - (1.0 - found.r2) * spare / (spare - chance);
    let sentence = if r2 < FOLLOWS_SHARE || second > ALONE * r2 {
        "no single line stands out in the spectrum of the torque error".to_owned()
    } else {
        format!(
            "{} of the torque error is a line at {} Hz with an amplitude of {} N.m",
            share(r2),
            significant(frequency_hz, 3),
            significant(amplitude, 3)
        )
    };
    Some(AxisMap {
        equation: "torque",
        axis: "frequency_hz",
        r2,
        knots: vec![frequency_hz],
        values: vec![amplitude],
        std: vec![variance.max(0.0).sqrt() / seen],
        method: "weak_form",
        error_over_noise: error_over_noise(regression),
        sentence,
    })
}

/// Golden section around the best frequency of the grid.
fn best_near(at_hz: f64, step_hz: f64, gain: impl Fn(f64) -> f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let (mut low, mut high) = (at_hz - step_hz, at_hz + step_hz);
    for _ in 0..16 {
        let width = high - low;
        let (left, right) = (high - GOLDEN * width, low + GOLDEN * width);
        if gain(left) > gain(right) {
            high = right;
        } else {
            low = left;
        }
    }
    0.5 * (low + high)
}

/// Amplitude that is left of a wave when windows average it.
fn attenuation(regression: &Regression, scenario: &Scenario, frequency_hz: f64) -> f64 {
    let times = &scenario.sample_time_s;
    let phase = |sample: usize| TAU * frequency_hz * times[sample];
    let sines = regression.means(|sample| phase(sample).sin());
    let cosines = regression.means(|sample| phase(sample).cos());
    let power = (sines.norm_squared() + cosines.norm_squared()) / sines.len() as f64;
    power.sqrt().max(f64::MIN_POSITIVE)
}

fn shortest_stride(times: &[f64]) -> Option<f64> {
    let mut strides: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    strides.sort_by(f64::total_cmp);
    strides
        .get(strides.len() / 2)
        .copied()
        .filter(|stride| *stride > 0.0)
}

#[cfg(test)]
mod tests;

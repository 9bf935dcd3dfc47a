//! The axis map: what the error of each equation follows, as a curve, before it has a name.
//!
//! ```text
//! balance of each equation --> hat functions over speed, current, voltage, time; harmonics of the angle
//!   weak_balance.rs: residual of windows, where the armature circuit is resolved
//!   windowed.rs:     errors of short free runs, where it is not            --> refit --> adjusted R2, curve
//!   line.rs:         periodogram of the torque residual                    --> line at f Hz with its share
//! ```
//!
//! The current is no axis of the torque balance and the voltage none of the voltage balance: they are what the balance
//! is solved for. A part of a curve that a parameter of the baseline explains as well is left to that parameter.

mod line;
mod weak_balance;
mod windowed;

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::FitError;
use crate::identification::weak_form;
use crate::numerics::least_squares;
use crate::plant::effect::Axis;
use crate::plant::{Balance, Input, Model, MotorKey, Scenario};
use crate::text::number::significant;

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
    let mut maps = if is_resolved(model, scenario) {
        let mut maps = Vec::new();
        for regression in weak_form::regressions(model, scenario) {
            maps.extend(weak_balance::maps(&regression, scenario));
            maps.extend(line::strongest(&regression, scenario));
        }
        maps
    } else {
        let mut maps = windowed::maps(model, scenario, noise)?;
        // A line is slow beside the armature circuit, if it is found at all.
        let balances = weak_form::regressions(model, scenario);
        maps.extend(
            balances
                .iter()
                .filter_map(|one| line::strongest(one, scenario)),
        );
        maps
    };
    maps.sort_by(|a, b| b.r2.total_cmp(&a.r2));
    Ok(maps)
}

/// Whether the samples resolve the armature circuit; without a voltage there is none to resolve.
fn is_resolved(model: &Model, scenario: &Scenario) -> bool {
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let constant = |key| model.motor.get(key);
    match (
        constant(MotorKey::Inductance),
        constant(MotorKey::Resistance),
    ) {
        (Some(inductance), Some(resistance)) if scenario.input == Input::Voltage => {
            period_s * RESOLVED_PERIODS <= inductance / resistance
        }
        _ => true,
    }
}

const fn name(equation: Balance) -> &'static str {
    match equation {
        Balance::Voltage => "voltage",
        Balance::Torque => "torque",
    }
}

const fn unit(equation: Balance) -> &'static str {
    match equation {
        Balance::Voltage => "V",
        Balance::Torque => "N.m",
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

/// What is said of a curve.
fn sentence(equation: Balance, axis: Axis, scenario: &Scenario, curve: &Curve) -> String {
    let what = name(equation);
    let along = match axis {
        Axis::Speed => "speed",
        Axis::Current => "current",
        Axis::Voltage => "voltage",
        Axis::Angle if scenario.angle.is_empty() => "angle, integrated from the speed",
        Axis::Angle => "angle",
        Axis::Time => "time",
    };
    if curve.r2 < FOLLOWS_SHARE {
        return format!("the {what} error does not follow the {along}");
    }
    let share = format!(
        "{:.0} % of the {what} error follows the {along}",
        100.0 * curve.r2
    );
    match curve.peak() {
        Some(peak) => format!(
            "{share}; it is largest near {} {}: {} {}",
            significant(curve.knots[peak], 3),
            axis.unit(),
            significant(curve.values[peak], 3),
            unit(equation)
        ),
        None => share,
    }
}

#[cfg(test)]
mod tests;

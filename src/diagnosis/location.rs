//! Where the model fails: which equation, and over which speeds, currents, angles or times.
//!
//! The model is started afresh from the measurement every few samples. What it misses by the end of such a window is
//! turned into the torque and the voltage that the equations lack on average over the window; this needs no derivative
//! and holds at any sampling period. Over the bins of a variable the systematic part (mean squared, less what chance
//! gives) is then compared: an error that follows a variable shows up in its bins, noise does not.

use std::f64::consts::{SQRT_2, TAU};

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::identification::output_error::{self, FitError};
use crate::numerics::count::whole;
use crate::numerics::least_squares;
use crate::plant::{Input, Model, MotorKey, Plant, Scenario};

/// Length of a window, s: long enough that noise does not drown the missing torque, short beside the time constants.
const WINDOW_S: f64 = 0.02;
const BINS: usize = 20;
/// Share of the largest speed below which the direction of motion is open.
const DEAD_ZONE: f64 = 0.01;
/// Windows in a bin below which its mean says nothing.
const FEWEST_IN_BIN: usize = 8;
/// Share of the systematic error that a region must hold to be worth a sentence.
const WORTH_SAYING: f64 = 0.7;

/// Share of an equation's error beyond noise that must follow a variable.
const WORTH_MENTIONING: f64 = 0.1;
/// Multiple of the spread that chance alone gives.
const CERTAIN: f64 = 4.0;

/// A region that holds much of the error of one equation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FailureLocation {
    pub equation: &'static str,
    pub variable: &'static str,
    pub from: f64,
    pub to: f64,
    pub share_of_error: f64,
    pub share_of_time: f64,
    /// Share of the equation's squared error beyond the noise that follows this variable.
    pub follows: f64,
    /// Systematic error in units of what chance gives: the larger, the more certain.
    pub strength: f64,
    pub sentence: String,
}

/// Which error is located.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorOf {
    /// The model with its values as they are: a wrong resistance shows as an error that follows the current.
    Model,
    /// What the baseline's own parameters cannot explain, each balance for itself: where something is missing. A fit of
    /// the whole model spreads a missing torque over both balances; this takes that back.
    Structure,
}

/// One window: what the equations lacked, and where that was.
struct Window {
    torque_n_m: f64,
    voltage_v: f64,
    torque_noise_n_m: f64,
    voltage_noise_v: f64,
    speed_rad_s: f64,
    current_a: f64,
    time_s: f64,
    turn_rad: Option<f64>,
    current_rate_a_s: f64,
    acceleration_rad_s2: f64,
    length_s: f64,
}

/// What an error may follow.
struct Variable {
    key: &'static str,
    unit: &'static str,
    /// Its value in a window; `None` where it is not measured.
    of: fn(&Window) -> Option<f64>,
}

const VARIABLES: [Variable; 4] = [
    Variable {
        key: "speed_rad_s",
        unit: "rad/s",
        of: |window| Some(window.speed_rad_s),
    },
    Variable {
        key: "current_a",
        unit: "A",
        of: |window| Some(window.current_a),
    },
    Variable {
        key: "angle_rad",
        unit: "rad",
        of: |window| window.turn_rad,
    },
    Variable {
        key: "time_s",
        unit: "s",
        of: |window| Some(window.time_s),
    },
];

/// A window seen along one variable.
struct Point {
    at: f64,
    error: f64,
    /// Variance that the measurement noise alone gives to the error.
    noise_variance: f64,
}

#[derive(Clone, Copy)]
enum Equation {
    Torque,
    Voltage,
}

impl Equation {
    const fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Voltage => "voltage",
        }
    }

    fn point(self, window: &Window, at: f64) -> Point {
        let (error, noise) = match self {
            Self::Torque => (window.torque_n_m, window.torque_noise_n_m),
            Self::Voltage => (window.voltage_v, window.voltage_noise_v),
        };
        Point {
            at,
            error,
            noise_variance: noise * noise,
        }
    }
}

/// Regions of both equations, the strongest first; empty where the error follows nothing.
pub fn locate(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
    error_of: ErrorOf,
) -> Result<Vec<FailureLocation>, FitError> {
    if scenario.input != Input::Voltage {
        return Ok(Vec::new());
    }
    let mut windows = windows(model, scenario, noise)?;
    if error_of == ErrorOf::Structure {
        remove_what_parameters_explain(&mut windows);
    }
    let mut found = Vec::new();
    for equation in [Equation::Torque, Equation::Voltage] {
        for variable in &VARIABLES {
            let points: Vec<Point> = windows
                .iter()
                .filter_map(|window| Some(equation.point(window, (variable.of)(window)?)))
                .filter(|point| point.at.is_finite() && point.error.is_finite())
                .collect();
            found.extend(region(equation.name(), variable, &points));
        }
    }
    // Time explains nothing by itself: it is named first only where no physical variable comes near.
    let weight = |found: &FailureLocation| {
        found.strength * if found.variable == "time_s" { 0.3 } else { 1.0 }
    };
    found.sort_by(|a, b| weight(b).total_cmp(&weight(a)));
    Ok(found)
}

/// Takes out of each balance what a change of its own parameters would explain.
fn remove_what_parameters_explain(windows: &mut [Window]) {
    let fastest = windows
        .iter()
        .fold(0.0, |most, window| f64::max(most, window.speed_rad_s.abs()));
    let direction = |window: &Window| {
        if window.speed_rad_s.abs() > DEAD_ZONE * fastest {
            window.speed_rad_s.signum()
        } else {
            0.0
        }
    };
    let voltage: Vec<[f64; 4]> = windows
        .iter()
        .map(|w| [w.current_a, w.current_rate_a_s, w.speed_rad_s, w.voltage_v])
        .collect();
    let torque: Vec<[f64; 3]> = windows
        .iter()
        .map(|w| [w.acceleration_rad_s2, direction(w), w.torque_n_m])
        .collect();
    let blocks: Vec<usize> = windows
        .iter()
        .map(|w| whole(w.time_s / (8.0 * w.length_s)))
        .collect();
    if let Some(residual) = residual_of(&voltage, &blocks) {
        for (window, left) in windows.iter_mut().zip(residual.iter()) {
            window.voltage_v = *left;
        }
    }
    if let Some(residual) = residual_of(&torque, &blocks) {
        for (window, left) in windows.iter_mut().zip(residual.iter()) {
            window.torque_n_m = *left;
        }
    }
}

/// Residual of a least-squares fit of rows `[regressors.., value]`; `None` where a cell is missing.
fn residual_of<const M: usize>(rows: &[[f64; M]], blocks: &[usize]) -> Option<DVector<f64>> {
    if rows.iter().flatten().any(|cell| !cell.is_finite()) {
        return None;
    }
    let matrix = DMatrix::from_fn(rows.len(), M - 1, |row, column| rows[row][column]);
    let right = DVector::from_iterator(rows.len(), rows.iter().map(|row| row[M - 1]));
    Some(least_squares::solve(&matrix, &right, blocks)?.residual)
}

fn windows(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<Window>, FitError> {
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let horizon = whole((WINDOW_S / period_s).round()).max(1);
    let start = output_error::predict(model, scenario, noise)?.start;
    let ahead = Plant::new(model, scenario.input)?.predict_ahead(scenario, start, horizon);
    let value = |key| model.motor.get(key).unwrap_or(f64::NAN);
    let (resistance, inertia) = (value(MotorKey::Resistance), value(MotorKey::Inertia));
    let time_constant_s = value(MotorKey::Inductance) / resistance;
    let back_emf = value(MotorKey::BackEmf);
    let torque_constant = model.motor.torque_constant().unwrap_or(f64::NAN);
    let known = |level: f64| {
        if noise.source == FloorSource::None || level.is_infinite() {
            0.0
        } else {
            level
        }
    };
    let mut angle = scenario.angle.iter().peekable();
    let mut windows = Vec::new();
    for begin in (0..scenario.samples().saturating_sub(horizon)).step_by(horizon) {
        let end = begin + horizon;
        let (begin_s, end_s) = (times[begin], times[end]);
        let mean = |values: &[f64]| values[begin..=end].iter().sum::<f64>() / (horizon + 1) as f64;
        while angle.next_if(|point| point.0 < begin_s).is_some() {}
        if !scenario.scored.contains(&begin) {
            continue;
        }
        let speed_error = |sample: usize| scenario.speed_rad_s[sample] - ahead.speed_rad_s[sample];
        let current_error = |sample: usize| scenario.current_a[sample] - ahead.current_a[sample];
        let length_s = end_s - begin_s;
        let settled = -(-length_s / time_constant_s).exp_m1();
        // A missing torque bends the speed, which bends the current, and the other way round: what one error does
        // to the other equation is taken out. The current forgets with its time constant.
        let (mut mean_current, mut mean_speed, mut weights) = (0.0, 0.0, 0.0);
        for (sample, time_s) in (begin + 1..=end).zip(&times[begin + 1..=end]) {
            let weight = ((time_s - end_s) / time_constant_s).exp();
            mean_current += current_error(sample) / horizon as f64;
            mean_speed += weight
                * 0.5
                * (speed_error(sample)
                    + if sample == begin + 1 {
                        0.0
                    } else {
                        speed_error(sample - 1)
                    });
            weights += weight;
        }
        mean_speed /= weights;
        windows.push(Window {
            // Missing torque and voltage count as losses, like the terms of the catalogue.
            torque_n_m: torque_constant * mean_current - inertia * speed_error(end) / length_s,
            voltage_v: -resistance * current_error(end) / settled - back_emf * mean_speed,
            // Two noisy readings stand in each error: the anchor and the end.
            torque_noise_n_m: (SQRT_2 * inertia * known(noise.speed_rad_s) / length_s)
                .hypot(torque_constant * known(noise.current_a)),
            voltage_noise_v: (SQRT_2 * resistance * known(noise.current_a) / settled)
                .hypot(back_emf * known(noise.speed_rad_s)),
            speed_rad_s: mean(&scenario.speed_rad_s),
            current_a: mean(&scenario.current_a),
            time_s: 0.5 * (begin_s + end_s),
            current_rate_a_s: (scenario.current_a[end] - scenario.current_a[begin]) / length_s,
            acceleration_rad_s2: (scenario.speed_rad_s[end] - scenario.speed_rad_s[begin])
                / length_s,
            length_s,
            turn_rad: angle.peek().map(|point| point.1.rem_euclid(TAU)),
        });
    }
    Ok(windows)
}

fn region(
    equation: &'static str,
    variable: &Variable,
    points: &[Point],
) -> Option<FailureLocation> {
    // Bins of equal population: where the run spent much time, as near standstill, the picture is sharp.
    let mut sorted: Vec<&Point> = points.iter().collect();
    sorted.sort_by(|a, b| a.at.total_cmp(&b.at));
    let edge = |bin: usize| sorted[(bin * sorted.len() / BINS).min(sorted.len() - 1)].at;
    if points.len() < BINS * FEWEST_IN_BIN || edge(0) >= edge(BINS) {
        return None;
    }
    let bins: Vec<Vec<f64>> = (0..BINS)
        .map(|bin| {
            let members = bin * sorted.len() / BINS..(bin + 1) * sorted.len() / BINS;
            sorted[members].iter().map(|point| point.error).collect()
        })
        .collect();
    let systematic: Vec<f64> = bins.iter().map(|errors| systematic_part(errors)).collect();
    let total: f64 = systematic.iter().sum();
    let power: f64 = points.iter().map(|point| point.error * point.error).sum();
    let noise: f64 = points.iter().map(|point| point.noise_variance).sum();
    let beyond_noise = (power - noise).max(0.1 * power);
    let follows = (total / beyond_noise).min(1.0);
    // What the bins' means hold by chance: the variance once per bin, with its spread.
    let variance = if noise > 0.0 { noise } else { power } / points.len() as f64;
    let chance = variance * (2.0 * BINS as f64).sqrt();
    if follows < WORTH_MENTIONING || total < CERTAIN * chance {
        return None;
    }
    // The narrowest run of bins that holds enough of the error.
    let (first, last) = (0..BINS)
        .flat_map(|first| (first..BINS).map(move |last| (first, last)))
        .filter(|(first, last)| {
            systematic[*first..=*last].iter().sum::<f64>() >= WORTH_SAYING * total
        })
        .min_by(|a, b| (edge(a.1 + 1) - edge(a.0)).total_cmp(&(edge(b.1 + 1) - edge(b.0))))?;
    let share_of_error = systematic[first..=last].iter().sum::<f64>() / total;
    let inside = bins[first..=last].iter().map(Vec::len).sum::<usize>();
    let share_of_time = inside as f64 / points.len() as f64;
    let (from, to) = (edge(first), edge(last + 1));
    let Variable { key, unit, .. } = *variable;
    let name = key.split('_').next().unwrap_or(key);
    let sentence = if share_of_time > 0.7 {
        format!(
            "{:.0} % of the {equation} error follows the {name}, over its whole range",
            100.0 * follows
        )
    } else {
        format!(
            "{:.0} % of the {equation} error that follows the {name} lies between {from:.1} and {to:.1} {unit} \
             ({:.0} % of the time)",
            100.0 * share_of_error,
            100.0 * share_of_time
        )
    };
    Some(FailureLocation {
        equation,
        variable: key,
        from,
        to,
        share_of_error,
        share_of_time,
        follows,
        strength: total / chance,
        sentence,
    })
}

/// Squared mean of a bin times its count, less what chance gives.
fn systematic_part(errors: &[f64]) -> f64 {
    let n = errors.len();
    if n < FEWEST_IN_BIN {
        return 0.0;
    }
    let count = n as f64;
    let mean = errors.iter().sum::<f64>() / count;
    let variance = errors
        .iter()
        .map(|error| (error - mean).powi(2))
        .sum::<f64>()
        / (count - 1.0);
    (count * mean * mean - variance).max(0.0)
}

//! Where the model fails: which equation, and over which speeds, currents, angles or times.
//!
//! The model is started afresh from the measurement every few samples. What it misses by the end of such a window is
//! turned into the torque and the voltage that the equations lack on average over the window; this needs no derivative
//! and holds at any sampling period. Over the bins of a variable the systematic part (mean squared, less what chance
//! gives) is then compared: an error that follows a variable shows up in its bins, noise does not.

use std::f64::consts::{SQRT_2, TAU};

use serde::Serialize;

use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::identification::output_error::{self, FitError};
use crate::plant::{Input, Model, MotorKey, Plant, Scenario};

/// Length of a window, s: long enough that noise does not drown the missing torque, short beside the time constants.
const WINDOW_S: f64 = 0.02;
const BINS: usize = 14;
/// Windows in a bin below which its mean says nothing.
const FEWEST_IN_BIN: usize = 8;
/// Share of the systematic error that a region must hold to be worth a sentence.
const WORTH_SAYING: f64 = 0.6;

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
}

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
) -> Result<Vec<FailureLocation>, FitError> {
    if scenario.input != Input::Voltage {
        return Ok(Vec::new());
    }
    let windows = windows(model, scenario, noise)?;
    let variables: [(&'static str, &'static str, fn(&Window) -> Option<f64>); 4] = [
        ("speed_rad_s", "rad/s", |w| Some(w.speed_rad_s)),
        ("current_a", "A", |w| Some(w.current_a)),
        ("angle_rad", "rad", |w| w.turn_rad),
        ("time_s", "s", |w| Some(w.time_s)),
    ];
    let mut found = Vec::new();
    for equation in [Equation::Torque, Equation::Voltage] {
        for (variable, unit, value) in variables {
            let points: Vec<Point> = windows
                .iter()
                .filter_map(|window| Some(equation.point(window, value(window)?)))
                .filter(|point| point.at.is_finite() && point.error.is_finite())
                .collect();
            found.extend(region(equation.name(), variable, unit, &points));
        }
    }
    found.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    Ok(found)
}

fn windows(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<Window>, FitError> {
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let horizon = ((WINDOW_S / period_s).round() as usize).max(1);
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
        for sample in begin + 1..=end {
            let weight = ((times[sample] - end_s) / time_constant_s).exp();
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
            turn_rad: angle.peek().map(|point| point.1.rem_euclid(TAU)),
        });
    }
    Ok(windows)
}

fn region(
    equation: &'static str,
    variable: &'static str,
    unit: &'static str,
    points: &[Point],
) -> Option<FailureLocation> {
    let low = points
        .iter()
        .map(|point| point.at)
        .fold(f64::INFINITY, f64::min);
    let high = points
        .iter()
        .map(|point| point.at)
        .fold(f64::NEG_INFINITY, f64::max);
    let width = (high - low) / BINS as f64;
    if points.len() < 4 * FEWEST_IN_BIN || width <= 0.0 {
        return None;
    }
    let mut bins: Vec<Vec<f64>> = vec![Vec::new(); BINS];
    for point in points {
        bins[(((point.at - low) / width) as usize).min(BINS - 1)].push(point.error);
    }
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
        .min_by_key(|(first, last)| (last - first, *first))?;
    let share_of_error = systematic[first..=last].iter().sum::<f64>() / total;
    let inside = bins[first..=last].iter().map(Vec::len).sum::<usize>();
    let share_of_time = inside as f64 / points.len() as f64;
    let (from, to) = (low + width * first as f64, low + width * (last + 1) as f64);
    let name = variable.split('_').next().unwrap_or(variable);
    let sentence = if last - first + 1 >= BINS * 2 / 3 {
        format!(
            "the {equation} error follows the {name} over its whole range ({:.0} % of it)",
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
        variable,
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

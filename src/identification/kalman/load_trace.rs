//! The load torque over a recorded run, with the rate at which it changes taken from the data.

use super::load::{LoadError, LoadPoint, LoadTracker};
use crate::numerics::statistics;
use crate::plant::{Input, Model, MotorKey, Scenario};
use crate::sample::{Channel, Run};

/// Rates that are tried, as powers of ten of the largest torque per sqrt(s): four per decade.
const FIRST_TRIAL: i32 = -16;
const LAST_TRIAL: i32 = 8;
const PER_DECADE: f64 = 4.0;
/// Rows without which nothing is told.
const FEWEST_ROWS: u64 = 20;
const FEWEST_ROWS_IN_MOTION: usize = 20;

/// What the user may set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadOptions {
    /// Expected change of the load, N.m/sqrt(s); without it the rate under which the run is likeliest.
    pub rate_n_m_per_sqrt_s: Option<f64>,
}

/// The load torque of a run.
#[derive(Clone, Debug)]
pub struct LoadTrace {
    pub points: Vec<LoadPoint>,
    pub rate_n_m_per_sqrt_s: f64,
    pub rate_from_data: bool,
    pub input: Input,
    /// Rows at which the motor turned and the model followed: there the load was seen.
    pub rows_followed: usize,
    /// Root mean square of the last innovations over the noise at rest: current, speed.
    pub consistency: [Option<f64>; 2],
    pub notes: Vec<String>,
}

/// Tracks the load torque through `run` with the parameters of `model`.
pub fn load_torque_trace(
    run: &Run,
    model: &Model,
    options: LoadOptions,
) -> Result<LoadTrace, LoadError> {
    let mut input = Scenario::from_run(run)?.input;
    let electrical = [
        MotorKey::Resistance,
        MotorKey::Inductance,
        MotorKey::BackEmf,
    ];
    let has_current = run.points(Channel::Current).next().is_some();
    let mut notes = vec![
        "positive against positive speed, negative where the load drives; friction of the model is not in it".to_owned(),
        "the standard deviation holds for exact parameters of the model".to_owned(),
    ];
    if input == Input::Voltage
        && has_current
        && electrical.iter().any(|key| model.motor.get(*key).is_none())
    {
        notes.push("the model has no winding: the measured current drives the shaft, straight between samples".to_owned());
        input = Input::Current;
    }
    let driving = if input == Input::Torque {
        Channel::Torque
    } else {
        Channel::Current
    };
    let most = run
        .points(driving)
        .map(|point| point.1.abs())
        .fold(0.0, f64::max);
    let per_unit = if input == Input::Torque {
        1.0
    } else {
        model.motor.torque_constant().unwrap_or(1.0)
    };
    // Without any current the friction's size stands in.
    let load = model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0).abs();
    let size = (most * per_unit).max(load).max(1e-9);
    let (rate, from_data) = match options.rate_n_m_per_sqrt_s {
        Some(rate) => (rate, false),
        None => (likeliest_rate(run, model, input, size)?, true),
    };
    let mut tracker = LoadTracker::new(model, input, rate)?;
    let mut points = Vec::with_capacity(run.rows());
    let mut rows_followed = 0;
    for sample in run.samples() {
        if let Some(point) = tracker.push(&sample) {
            rows_followed += usize::from(tracker.is_turning());
            points.push(point);
        }
    }
    let used = tracker.evidence().1;
    if used < FEWEST_ROWS || rows_followed < FEWEST_ROWS_IN_MOTION {
        let [_, speed] = tracker.largest();
        return Err(LoadError::NothingSeen {
            run: run.name.clone(),
            reason: format!(
                "{rows_followed} of {} rows in motion, at least {FEWEST_ROWS_IN_MOTION} are needed (largest speed {speed:.2} rad/s)",
                points.len()
            ),
        });
    }
    if !tracker.left_out().is_empty() {
        notes.push(format!(
            "not subtracted, so part of the load torque: {}",
            tracker.left_out().join(", ")
        ));
    }
    Ok(LoadTrace {
        points,
        rate_n_m_per_sqrt_s: rate,
        rate_from_data: from_data,
        input,
        rows_followed,
        consistency: tracker.consistency(),
        notes,
    })
}

/// The rate at which the innovations are likeliest, by trial on a logarithmic scale and a parabola through the best three.
fn likeliest_rate(run: &Run, model: &Model, input: Input, size: f64) -> Result<f64, LoadError> {
    let rate = |power: f64| size * 10f64.powf(power / PER_DECADE);
    let mut scores = Vec::new();
    for power in FIRST_TRIAL..=LAST_TRIAL {
        let mut tracker = LoadTracker::new(model, input, rate(f64::from(power)))?;
        for sample in run.samples() {
            tracker.push(&sample);
        }
        scores.push((f64::from(power), tracker.evidence().0));
    }
    let best = (0..scores.len())
        .max_by(|a, b| scores[*a].1.total_cmp(&scores[*b].1))
        .unwrap_or(0);
    let mut power = scores[best].0;
    if best > 0 && best + 1 < scores.len() {
        let [before, at, after] = [best - 1, best, best + 1].map(|k| scores[k].1);
        let bend = before - 2.0 * at + after;
        if bend < 0.0 {
            power += (0.5 * (before - after) / bend).clamp(-0.5, 0.5);
        }
    }
    Ok(rate(power))
}

impl LoadTrace {
    /// Median standard deviation over the rows, N.m.
    pub fn median_std_n_m(&self) -> f64 {
        let stds: Vec<f64> = self.points.iter().map(|point| point.std_n_m).collect();
        statistics::median(&stds)
    }
}

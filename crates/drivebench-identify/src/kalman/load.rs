//! Disturbance observer (Kalman filter) for the load torque over time, as of rolling, cutting or lifting, with its standard
//! deviation.
//!
//! `J dw/dt = Kt i - Mc sgn(w) - friction(w) - TL(t)`: TL is positive against positive speed, negative while the load
//! drives in that direction, and does not contain the friction of the model. TL is a random walk; its rate, N.m/sqrt(s), is
//! the only setting: a load that changes by 0.5 N.m within a second has about 0.5. The parameters are taken as exact: an
//! error of the torque constant of 1 % is an error of 1 % of the motor's torque in TL, which is not in the standard deviation.

use thiserror::Error;

use super::filter::{Filter, I, J, KE, L, MC, Mode, N, R, Source, TL};
use super::physics::KnownEffects;
use crate::online::AppliedVoltage;
use drivebench_model::numerics::statistics;
use drivebench_model::plant::{Input, Model, MotorKey, Scenario, ScenarioError};
use drivebench_model::sample::{Channel, Run, Sample};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadPoint {
    pub time_s: f64,
    /// Positive against positive speed, negative where it drives; Coulomb and known friction are not in it.
    pub load_torque_n_m: f64,
    pub std_n_m: f64,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum LoadError {
    #[error("the model has no {key}, which the load torque needs")]
    Incomplete { key: &'static str },
    #[error("{key} = {value} is not allowed (expected more than 0)")]
    Value { key: &'static str, value: f64 },
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    #[error("run {run:?}: the load torque is not observable: {reason}")]
    NotObservable { run: String, reason: String },
}

impl LoadError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Incomplete { .. } => {
                "identify the motor first and give the model with --model MODEL.toml"
            }
            Self::Value { .. } => "see the commented example in bench-configs/",
            Self::Scenario(error) => error.help(),
            Self::NotObservable { .. } => {
                "the load is observable only while the motor turns: map a speed with --map speed_rad_s=HEADER"
            }
        }
    }
}

#[derive(Clone, Debug)]
struct LoadTracker {
    filter: Filter,
    input: Input,
    applied: AppliedVoltage,
    /// Effects of the model that are not subtracted and so are part of the load torque.
    left_out: Vec<&'static str>,
}

impl LoadTracker {
    /// `model` gives inertia, torque constant and friction, under [`Input::Voltage`] also R, L, Ke;
    /// `rate_n_m_per_sqrt_s` how fast the load is expected to change.
    fn new(model: &Model, input: Input, rate_n_m_per_sqrt_s: f64) -> Result<Self, LoadError> {
        let motor = &model.motor;
        let refused = |key, value| Err(LoadError::Value { key, value });
        let positive = |key: MotorKey| match motor.get(key) {
            None => Err(LoadError::Incomplete { key: key.key() }),
            Some(value) if value > 0.0 && value.is_finite() => Ok(value),
            Some(value) => refused(key.key(), value),
        };
        if !(rate_n_m_per_sqrt_s > 0.0 && rate_n_m_per_sqrt_s.is_finite()) {
            refused("rate_n_m_per_sqrt_s", rate_n_m_per_sqrt_s)?;
        }
        let torque = match input {
            Input::Torque => 1.0,
            _ => motor
                .torque_constant()
                .ok_or(LoadError::Incomplete { key: MotorKey::TorqueConstant.key() })?,
        };
        let mut x = [0.0; N];
        x[J] = positive(MotorKey::Inertia)?.ln();
        x[KE] = torque.ln();
        if input == Input::Voltage {
            x[R] = positive(MotorKey::Resistance)?.ln();
            x[L] = positive(MotorKey::Inductance)?.ln();
            x[KE] = positive(MotorKey::BackEmf)?.ln();
        }
        x[MC] = motor.get(MotorKey::LoadTorque).unwrap_or(0.0);
        let mut variance = [0.0; N];
        // Of the load nothing is known at first.
        variance[TL] = (100.0 * (x[MC].abs() + rate_n_m_per_sqrt_s)).powi(2);
        let mut filter = Filter::new(x, variance, Some(torque));
        let (effects, left_out) = KnownEffects::of(model);
        filter.effects = effects;
        filter.source = if input == Input::Voltage { Source::Voltage } else { Source::Current };
        filter.load_rate = rate_n_m_per_sqrt_s;
        // Process noise as of a winding that is warmer by 3 K, without which the predicted current would never be corrected.
        filter.voltage_share = 0.01;
        filter.freeze();
        Ok(Self { filter, input, applied: AppliedVoltage::default(), left_out })
    }

    /// Takes a sample as [`crate::online::Online::push`] does, and gives the load torque at its instant;
    /// `None` where it carries neither current nor speed.
    fn push(&mut self, sample: &Sample) -> Option<LoadPoint> {
        let time_s = sample.time_s;
        // While a limit of the drive holds its output the motor has another voltage than was commanded.
        let unlike_command = self.input == Input::Voltage && sample.limited;
        self.filter.voltage.torn |= unlike_command;
        if self.input == Input::Voltage
            && let Some(volts) = self.applied.of(sample)
        {
            self.filter.voltage.apply(time_s, volts, self.filter.now_s);
        }
        let measured = [driving(self.input), Channel::Speed].map(|channel| sample.good(channel));
        if measured == [None, None] {
            return None;
        }
        if self.input != Input::Voltage {
            // Without a voltage the first current or motion ends the rest before the start.
            let zone = self.filter.zone_rad_s().max(f64::MIN_POSITIVE);
            let moves = self.filter.sensors[1].at_rest().is_some()
                && measured[1].is_some_and(|speed| speed.abs() > 2.0 * zone);
            self.filter.voltage.energised |= moves;
        }
        self.filter.push(time_s, measured);
        self.filter.voltage.torn |= unlike_command;
        if self.filter.mode == Mode::AtRest {
            self.bound_by_friction();
        }
        Some(LoadPoint {
            time_s,
            load_torque_n_m: self.filter.belief.x[TL],
            std_n_m: self.filter.belief.p[TL][TL].sqrt(),
        })
    }

    /// At rest the load differs from the motor's torque by the Coulomb torque at most, and more is not known.
    fn bound_by_friction(&mut self) {
        let kt = self.filter.physics().kt;
        let noise = kt * self.filter.sensors[0].variance().sqrt();
        let half = self.filter.belief.x[MC].abs() + 3.0 * noise;
        let centre = kt * self.filter.belief.x[I];
        let belief = &mut self.filter.belief;
        let bound = belief.x[TL].clamp(centre - half, centre + half);
        let widest = half * half / 3.0;
        if belief.p[TL][TL] > widest || bound.total_cmp(&belief.x[TL]).is_ne() {
            belief.x[TL] = bound;
            belief.reset(TL, widest);
        }
    }
}

/// Input of the mechanics without a voltage.
const fn driving(input: Input) -> Channel {
    match input {
        Input::Torque => Channel::Torque,
        Input::Voltage | Input::Current => Channel::Current,
    }
}

#[derive(Clone, Debug)]
pub struct LoadTrace {
    pub points: Vec<LoadPoint>,
    /// The rate under which the run is likeliest.
    pub rate_n_m_per_sqrt_s: f64,
    pub input: Input,
    /// Rows at which the motor turned and the model followed: there the load is observed.
    pub rows_followed: usize,
    /// Root mean square of the last innovations over the noise at rest: current, speed.
    pub consistency: [Option<f64>; 2],
    pub notes: Vec<String>,
}

pub fn load_torque_trace(run: &Run, model: &Model) -> Result<LoadTrace, LoadError> {
    use MotorKey::{BackEmf, Inductance, Resistance};
    let mut input = Scenario::from_run(run)?.input;
    let lacks_winding =
        [Resistance, Inductance, BackEmf].iter().any(|key| model.motor.get(*key).is_none());
    let has_current = run.points(Channel::Current).next().is_some();
    let mut notes = vec![
        "positive against positive speed, negative where the load drives; friction of the model is not in it".to_owned(),
        "the standard deviation holds for exact parameters of the model".to_owned(),
    ];
    if input == Input::Voltage && has_current && lacks_winding {
        notes.push("the model has no winding: the measured current drives the shaft, straight between samples".to_owned());
        input = Input::Current;
    }
    let most = run.points(driving(input)).map(|point| point.1.abs()).fold(0.0, f64::max);
    let per_unit = match input {
        Input::Torque => 1.0,
        _ => model.motor.torque_constant().unwrap_or(1.0),
    };
    // Without any current the friction gives the size.
    let load = model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0).abs();
    let size = (most * per_unit).max(load).max(1e-9);
    let rate = likeliest_rate(run, model, input, size)?;
    let mut tracker = LoadTracker::new(model, input, rate)?;
    let mut points = Vec::with_capacity(run.rows());
    let mut rows_followed = 0;
    for sample in run.samples() {
        if let Some(point) = tracker.push(&sample) {
            rows_followed += usize::from(matches!(tracker.filter.mode, Mode::Turning(_)));
            points.push(point);
        }
    }
    let fewest = 20;
    if tracker.filter.tally.used < 20 || rows_followed < fewest {
        let speed = tracker.filter.sensors[1].largest;
        return Err(LoadError::NotObservable {
            run: run.name.clone(),
            reason: format!(
                "{rows_followed} of {} rows in motion, at least {fewest} are needed (largest speed {speed:.2} rad/s)",
                points.len()
            ),
        });
    }
    let limited = run.limited_rows().len();
    if input == Input::Voltage && limited > 0 {
        notes.push(format!(
            "a limit of the drive held its output at {limited} rows: the load torque is not followed there"
        ));
    }
    if !tracker.left_out.is_empty() {
        let left_out = tracker.left_out.join(", ");
        notes.push(format!("not subtracted, so part of the load torque: {left_out}"));
    }
    Ok(LoadTrace {
        points,
        rate_n_m_per_sqrt_s: rate,
        input,
        rows_followed,
        consistency: tracker.filter.consistency(),
        notes,
    })
}

/// Maximum-likelihood estimate of the rate from the innovations: a logarithmic grid, and a parabola through the best three.
fn likeliest_rate(run: &Run, model: &Model, input: Input, size: f64) -> Result<f64, LoadError> {
    // Four rates per decade.
    let rate = |power: f64| size * 10f64.powf(power / 4.0);
    let mut scores = Vec::new();
    for power in -16..=8 {
        let mut tracker = LoadTracker::new(model, input, rate(f64::from(power)))?;
        for sample in run.samples() {
            tracker.push(&sample);
        }
        scores.push((f64::from(power), tracker.filter.log_likelihood));
    }
    let best = (0..scores.len()).max_by(|a, b| scores[*a].1.total_cmp(&scores[*b].1)).unwrap_or(0);
    let mut power = scores[best].0;
    if best > 0 && best + 1 < scores.len() {
        let [before, at, after] = [best - 1, best, best + 1].map(|k| scores[k].1);
        let curvature = before - 2.0 * at + after;
        if curvature < 0.0 {
            power += (0.5 * (before - after) / curvature).clamp(-0.5, 0.5);
        }
    }
    Ok(rate(power))
}

impl LoadTrace {
    pub fn median_std_n_m(&self) -> f64 {
        let stds: Vec<f64> = self.points.iter().map(|point| point.std_n_m).collect();
        statistics::median(&stds)
    }
}

#[cfg(test)]
#[path = "load_tests.rs"]
mod tests;

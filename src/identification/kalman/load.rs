//! Load torque as a process output: rolling, cutting or lifting force over time, with its standard deviation.
//!
//! `J dw/dt = Kt i - Mc sgn(w) - friction(w) - TL(t)`: TL is positive against positive speed; negative while the load
//! drives in that direction. What the model calls friction is not in it. TL is a random walk; its rate, N.m/sqrt(s), is
//! the one figure to set: a load that changes by 0.5 N.m within a second has about 0.5. The parameters are taken as
//! exact: an error of the torque constant of 1 % is 1 % of the motor's torque in TL beside the standard deviation.

use thiserror::Error;

use super::covariance::{I, J, KE, L, MC, N, R, TL};
use super::filter::{Disturbance, Filter, Mode, Source};
use super::friction::KnownEffects;
use crate::plant::{Input, Model, MotorKey, ScenarioError};
use crate::sample::{Channel, Quality, Sample};

/// Standard deviation of the voltage as share of itself: a resistance that is warm by 3 K errs as much. It keeps the
/// current near its measurement, where a prediction without it would be believed for ever.
const VOLTAGE_SHARE: f64 = 0.01;
/// First standard deviation of the load, in units of what is known of its size: nothing is known.
const IGNORANCE: f64 = 100.0;
/// Standard deviations of the current that a torque at rest is uncertain by.
const REST_NOISE: f64 = 3.0;

/// Load torque with its standard deviation at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadPoint {
    pub time_s: f64,
    /// Positive against positive speed, negative where it drives; Coulomb and known friction are not in it.
    pub load_torque_n_m: f64,
    pub std_n_m: f64,
}

/// Why the load torque cannot be tracked.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LoadError {
    #[error("the model has no {key}, which the load torque needs")]
    Incomplete { key: &'static str },
    #[error("{key} = {value} is not allowed (expected more than 0)")]
    Value { key: &'static str, value: f64 },
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    #[error("run {run:?}: no load torque can be told: {reason}")]
    NothingSeen { run: String, reason: String },
}

impl LoadError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Incomplete { .. } => {
                "identify the motor first and give the model with --model MODEL.toml"
            }
            Self::Value { .. } => "see the commented example in bench-configs/",
            Self::Scenario(error) => error.help(),
            Self::NothingSeen { .. } => {
                "the load shows only while the motor turns: map a speed with --map speed_rad_s=HEADER"
            }
        }
    }
}

/// Follows the load torque sample by sample; interface as [`crate::identification::online::Online`].
#[derive(Clone, Debug)]
pub struct LoadTracker {
    filter: Filter,
    input: Input,
    commanded: bool,
    left_out: Vec<&'static str>,
}

impl LoadTracker {
    /// `model` gives inertia, torque constant and friction, under [`Input::Voltage`] also R, L, Ke;
    /// `rate_n_m_per_sqrt_s` how fast the load is expected to change.
    pub fn new(model: &Model, input: Input, rate_n_m_per_sqrt_s: f64) -> Result<Self, LoadError> {
        let motor = &model.motor;
        let positive = |key: MotorKey| match motor.get(key) {
            None => Err(LoadError::Incomplete { key: key.key() }),
            Some(value) if value > 0.0 && value.is_finite() => Ok(value),
            Some(value) => Err(LoadError::Value {
                key: key.key(),
                value,
            }),
        };
        if !(rate_n_m_per_sqrt_s > 0.0 && rate_n_m_per_sqrt_s.is_finite()) {
            return Err(LoadError::Value {
                key: "rate_n_m_per_sqrt_s",
                value: rate_n_m_per_sqrt_s,
            });
        }
        let torque = match input {
            Input::Torque => 1.0,
            _ => motor.torque_constant().ok_or(LoadError::Incomplete {
                key: MotorKey::TorqueConstant.key(),
            })?,
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
        variance[TL] = (IGNORANCE * (x[MC].abs() + rate_n_m_per_sqrt_s)).powi(2);
        let mut filter = Filter::new(x, variance, Some(torque));
        let (effects, left_out) = KnownEffects::of(model);
        filter.effects = effects;
        filter.source = if input == Input::Voltage {
            Source::Voltage
        } else {
            Source::Current
        };
        filter.disturbance = Disturbance {
            load: rate_n_m_per_sqrt_s,
            drift: 0.0,
            voltage_share: VOLTAGE_SHARE,
        };
        filter.freeze();
        Ok(Self {
            filter,
            input,
            commanded: false,
            left_out,
        })
    }

    /// The voltage that the drive has applied from `time_s` on; see [`crate::identification::online::Online`].
    pub fn command_applied(&mut self, time_s: f64, voltage_v: f64) {
        self.commanded = true;
        let now_s = self.filter.now_s;
        self.filter.voltage.apply(time_s, voltage_v, now_s);
    }

    /// Takes a sample as [`crate::identification::online::Online::push`] does, and gives the load torque at its instant;
    /// `None` where it carries neither current nor speed.
    pub fn push(&mut self, sample: &Sample) -> Option<LoadPoint> {
        let time_s = sample.time_s;
        if self.input == Input::Voltage {
            if let Some(volts) = sample.get(Channel::VoltageCmd) {
                self.command_applied(time_s, volts);
            } else if !self.commanded
                && let Some(volts) = sample.get(Channel::Voltage)
            {
                let now_s = self.filter.now_s;
                self.filter.voltage.apply(time_s, volts, now_s);
            }
        }
        let driving = if self.input == Input::Torque {
            Channel::Torque
        } else {
            Channel::Current
        };
        let measured = [driving, Channel::Speed].map(|channel| good(sample, channel));
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
        let half = self.filter.belief.x[MC].abs() + REST_NOISE * noise;
        let centre = kt * self.filter.belief.x[I];
        let belief = &mut self.filter.belief;
        let bound = belief.x[TL].clamp(centre - half, centre + half);
        let widest = half * half / 3.0;
        if belief.p[TL][TL] > widest || bound.total_cmp(&belief.x[TL]).is_ne() {
            belief.x[TL] = bound;
            belief.forget(TL, widest);
        }
    }

    /// Whether the last sample was followed by the model while the motor turned.
    pub fn is_turning(&self) -> bool {
        matches!(self.filter.mode, Mode::Turning(_))
    }

    /// Effects of the model that are not subtracted and so are part of the load torque.
    pub fn left_out(&self) -> &[&'static str] {
        &self.left_out
    }

    /// Root mean square of the recent innovations over the noise at rest: current (or torque), speed.
    pub fn consistency(&self) -> [Option<f64>; 2] {
        self.filter
            .sensors
            .map(|sensor| sensor.consistency().map(|found| found.0))
    }

    /// Logarithm of the likelihood of the speed and current seen so far, and the rows that it rests on.
    pub(super) fn evidence(&self) -> (f64, u64) {
        (self.filter.log_likelihood, self.filter.tally.used)
    }

    pub(super) fn largest(&self) -> [f64; 2] {
        self.filter.sensors.map(|sensor| sensor.largest)
    }
}

/// The value of a channel if it is good.
pub(super) fn good(sample: &Sample, channel: Channel) -> Option<f64> {
    sample
        .get(channel)
        .filter(|_| sample.quality(channel) == Quality::Good)
}

#[cfg(test)]
#[path = "load_tests.rs"]
mod tests;

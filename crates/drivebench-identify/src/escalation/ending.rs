//! Ending of an escalation: a motor, or a reason with its numbers.

use serde::Serialize;
use thiserror::Error;

use super::{Bounds, Observation, RestWinding};
use crate::belief::Settings;
use drivebench_model::plant::{Motor, MotorKey};
use drivebench_model::sample::ParameterEstimate;

#[derive(Clone, Debug)]
pub enum Outcome {
    Found(Found),
    Named(Ending),
}

#[derive(Clone, Debug)]
pub struct Found {
    pub motor: Motor,
    pub parameters: Vec<ParameterEstimate>,
}

impl Found {
    pub fn get(&self, key: MotorKey) -> Option<&ParameterEstimate> {
        ParameterEstimate::find(&self.parameters, key.key())
    }
}

/// Why no motor was found. Every number is what was measured.
#[derive(Clone, Debug, Error, PartialEq, Serialize)]
#[serde(tag = "finding", rename_all = "snake_case")]
pub enum Ending {
    #[error(
        "open phase, or the motor is not connected: {voltage_v:.2} V applied for {:.0} ms, current below {below_a:.3} A",
        1e3 * seconds
    )]
    OpenPhase { voltage_v: f64, seconds: f64, below_a: f64 },
    #[error(
        "the drive puts out no voltage: {commanded_v:.2} V commanded, {measured_v:.2} V measured, and no current"
    )]
    NoOutput { commanded_v: f64, measured_v: f64 },
    #[error(
        "locked rotor, or a load beyond the rated torque: {current_a:.2} A (rated {rated_current_a:.2} A) at {voltage_v:.2} V for {:.0} ms, speed below {below_rad_s:.2} rad/s",
        1e3 * seconds
    )]
    LockedRotor {
        current_a: f64,
        voltage_v: f64,
        seconds: f64,
        below_rad_s: f64,
        rated_current_a: f64,
    },
    /// The current shows that the shaft turns, the speed does not.
    #[error(
        "the speed signal is dead: voltage over current rose from {ohm_at_rest:.3} to {ohm_now:.3} ohm, the back-EMF of a turning shaft, but the speed stays below {below_rad_s:.2} rad/s"
    )]
    SpeedSignalDead { ohm_at_rest: f64, ohm_now: f64, below_rad_s: f64 },
    /// The voltage limit was reached before the rated current.
    #[error(
        "the shaft stands still and the voltage limit keeps the current low: {current_a:.2} A of {rated_current_a:.2} A rated at {voltage_v:.2} V"
    )]
    VoltageLimit { current_a: f64, voltage_v: f64, rated_current_a: f64 },
    #[error("the current has the wrong sign: {current_a:.3} A at {voltage_v:.3} V")]
    CurrentSign { voltage_v: f64, current_a: f64 },
    #[error("the speed has the wrong sign: {speed_rad_s:.2} rad/s at {voltage_v:.3} V")]
    SpeedSign { voltage_v: f64, speed_rad_s: f64 },
    #[error("the motor could not be identified: {reason}")]
    NotIdentified { reason: String },
}

impl Ending {
    pub const fn name(&self) -> &'static str {
        match self {
            Self::OpenPhase { .. } => "open phase",
            Self::NoOutput { .. } => "no output",
            Self::LockedRotor { .. } => "locked rotor",
            Self::SpeedSignalDead { .. } => "speed signal dead",
            Self::VoltageLimit { .. } => "voltage limit",
            Self::CurrentSign { .. } => "current sign",
            Self::SpeedSign { .. } => "speed sign",
            Self::NotIdentified { .. } => "not identified",
        }
    }

    pub fn sentence(&self) -> String {
        self.to_string()
    }

    pub const fn help(&self) -> &'static str {
        match self {
            Self::OpenPhase { .. } => {
                "measure the resistance between the motor's terminals with the power off; check leads, brushes, fuse"
            }
            Self::NoOutput { .. } => "check the drive's enable input and its supply",
            Self::LockedRotor { .. } => {
                "power off, release the brake, turn the shaft by hand; is motor.rated_current_a right?"
            }
            Self::SpeedSignalDead { .. } => "check the encoder or tachometer and its cable",
            Self::VoltageLimit { .. } => {
                "turn the shaft by hand with the power off; raise limits.voltage_v if it is below the rated voltage"
            }
            Self::CurrentSign { .. } => {
                "turn the current sensor round, or swap the motor's leads at the drive"
            }
            Self::SpeedSign { .. } => {
                "swap the motor's two leads, or the encoder's channels A and B: a closed loop would run away"
            }
            Self::NotIdentified { .. } => {
                "give the values of the nameplate in [motor], or raise the limits"
            }
        }
    }
}

pub(super) fn wrong_sign(stage: &Observation) -> Option<Ending> {
    let against = |value: f64, volts: f64| value * volts < 0.0;
    // At its peak the current of a ramp, and that of the first steps, goes with the voltage; while braking it does not.
    let current_a = stage.current_at_peak_a;
    if current_a.abs() > Settings::CLEAR_STD * stage.noise_a
        && against(current_a, stage.peak_v)
        && !stage.moves()
    {
        return Some(Ending::CurrentSign { voltage_v: stage.peak_v, current_a });
    }
    // Twice the threshold of motion, and under a voltage, not while coasting.
    let is_driven = stage.voltage_of_motion_v.abs() > 0.2 * stage.peak_v.abs();
    let is_clear = stage.mean_speed_rad_s.abs() > 2.0 * stage.motion_rad_s;
    if is_clear && is_driven && against(stage.mean_speed_rad_s, stage.voltage_of_motion_v) {
        return Some(Ending::SpeedSign {
            voltage_v: stage.voltage_of_motion_v,
            speed_rad_s: stage.mean_speed_rad_s,
        });
    }
    None
}

/// The safe voltage was reached and next to no current flowed.
pub(super) fn no_current(stage: &Observation, share_a: f64) -> Ending {
    if let Some(measured_v) = stage.measured_at_peak_v
        && measured_v.abs() < Settings::UNEXPLAINED * stage.peak_v.abs()
    {
        return Ending::NoOutput { commanded_v: stage.peak_v, measured_v };
    }
    Ending::OpenPhase {
        voltage_v: stage.peak_v,
        seconds: stage.peak_time_s,
        below_a: stage.peak_current_a.abs().max(share_a),
    }
}

/// A current without a motion; `None` where a back-EMF is that of a speed below the noise of the sensor.
pub(super) fn no_motion(
    stage: &Observation,
    before: Option<RestWinding>,
    reached_a: f64,
    bounds: &Bounds,
) -> Option<Ending> {
    let rated_current_a = bounds.rated_current_a;
    let current_a = stage.current_at_peak_a;
    let ohm_now = (stage.peak_v / current_a).abs();
    // Only a turning shaft makes the ratio of voltage to current grow by a third against rest.
    if let Some(rest) = before
        && ohm_now > (1.0 + Settings::CATALOGUE) * rest.resistance_ohm
    {
        let back_emf_v = stage.peak_v.abs() - rest.resistance_ohm * current_a.abs();
        // Ten times what counts as motion by the rated values: then its absence is a finding.
        let expected = back_emf_v * bounds.speed_limit_rad_s / bounds.rated_voltage_v;
        return (expected >= 10.0 * stage.motion_rad_s).then_some(Ending::SpeedSignalDead {
            ohm_at_rest: rest.resistance_ohm,
            ohm_now,
            below_rad_s: stage.motion_rad_s,
        });
    }
    Some(if current_a.abs() < reached_a {
        Ending::VoltageLimit { current_a, voltage_v: stage.peak_v, rated_current_a }
    } else {
        Ending::LockedRotor {
            current_a,
            voltage_v: stage.peak_v,
            seconds: stage.peak_time_s,
            below_rad_s: stage.motion_rad_s,
            rated_current_a,
        }
    })
}

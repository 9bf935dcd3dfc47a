//! Why no loop is closed, with what to do.

use thiserror::Error;

use crate::control::tuning::TuningError;
use crate::control::{PaperBError, PlantError};

/// Why no loop is closed.
#[derive(Debug, Error)]
pub enum RegulatorError {
    #[error(transparent)]
    Plant(#[from] PlantError),
    #[error("{rule}: {error}")]
    Tuning {
        rule: &'static str,
        #[source]
        error: TuningError,
    },
    #[error("paper-b: {0}")]
    PaperB(#[source] PaperBError),
    #[error("load-observer: {0}")]
    LoadObserver(#[source] PaperBError),
    #[error("the model is of the motor {model:?} (expected {bench:?}, which the bench file names)")]
    OtherName { model: String, bench: String },
    #[error(
        "the model's {key} = {value} is that of another motor (expected {low:.4} to {high:.4}, about the nameplate)"
    )]
    OtherMotor {
        key: &'static str,
        value: f64,
        low: f64,
        high: f64,
    },
    #[error(
        "viscous_friction.viscous_n_m_s_per_rad = {0} is not physical: it drives the shaft (expected 0 or more)"
    )]
    Drives(f64),
    #[error(
        "speed.gains.proportional_v_s_per_rad = {value} is not allowed (expected up to {most:.4} with {cycles:.2} cycles of delay)"
    )]
    Gain { value: f64, most: f64, cycles: f64 },
    #[error(
        "speed.gains.integral_time_s = {value} s is not allowed: the sampled loop has a radius of {radius:.3} (expected more, for a radius below 1)"
    )]
    IntegralTime { value: f64, radius: f64 },
    #[error(
        "speed.gains is for the controller \"pi\" over a voltage only, and {controller:?} over a {actuator} is asked for"
    )]
    GainsOf {
        controller: &'static str,
        actuator: &'static str,
    },
    #[error(
        "the controller {controller:?} does not act with a {actuator} (expected one of {allowed})"
    )]
    Acts {
        controller: &'static str,
        actuator: &'static str,
        allowed: String,
    },
    #[error(
        "speed.drive_lag_s is missing (needed for a speed command: the time in which the drive's own loop follows)"
    )]
    NoLag,
    #[error("speed.feed_forward: nothing can be given forward {why}")]
    NothingForward { why: &'static str },
    #[error(
        "{controller}: with {cycles:.2} cycles of delay the loop goes on swinging by {swing:.1} rad/s after a step of {step:.1} rad/s (expected below {most:.1})"
    )]
    Swings {
        controller: &'static str,
        cycles: f64,
        swing: f64,
        step: f64,
        most: f64,
    },
}

impl RegulatorError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Plant(error) => error.help(),
            Self::Tuning { error, .. } => error.help(),
            Self::PaperB(error) | Self::LoadObserver(error) => error.help(),
            Self::OtherName { .. } | Self::OtherMotor { .. } => {
                "gains of one motor may be unstable on another: identify this one (drivebench run, identify)"
            }
            Self::Drives(_) => "identify the motor again, or take the effect out of the model",
            Self::Gain { .. } | Self::IntegralTime { .. } => {
                "leave [speed.gains] out: the rule finds gains that are stable"
            }
            Self::GainsOf { .. } => "leave [speed.gains] out, or give --controller pi",
            Self::Acts { .. } => {
                "give another --controller, or another speed.actuator where the drive takes one"
            }
            Self::NoLag => {
                "the manual's speed loop response time, or a step of the set-point seen on the drive's own scope"
            }
            Self::NothingForward { .. } => "leave --feed-forward out",
            Self::Swings { .. } => {
                "take addc or pi, which are tuned for the delay, or a faster link"
            }
        }
    }
}

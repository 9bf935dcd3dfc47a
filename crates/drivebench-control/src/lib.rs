//! Speed control, host-side: tuning, controllers, limiter, feed-forward. Pure; time comes in with each cycle.
//!
//! ```text
//! model + timing --> tuning (rule) --> gains, reasons, margins over the spread of the parameters, predicted step
//!                                        |
//! reference, Measured --> SpeedController --> wanted output --> limiter --> output --(applied)--> SpeedController
//!                             ^   PI, ADDC, MRAC, LQ            ^
//!       on-line TM, Ta -------/                                 \-- current, voltage, slew
//! ```
//!
//! Whatever the controller, a [`LoopWatch`] looks for swings and for limits that get nowhere, and has the gains lowered
//! where they can be.
//!
//! A controller is a function of what is measured; it never sees a link, a file or a clock. A new one is one file here and
//! one arm where the `[speed]` of a bench file becomes a controller.

mod actuator;
mod adaptation;
mod addc;
mod electrical;
mod feed_forward;
mod holding;
mod limiter;
mod linear_plant;
mod loop_shape;
mod mrac;
mod notch;
mod optimal;
mod pi;
mod response;
mod schedule;
mod sensor;
mod spread;
#[cfg(test)]
pub(crate) mod testing;
mod timing;
mod trial;
pub mod tuning;
mod watch;

pub use actuator::Actuator;
pub use adaptation::{Load, LoadEstimator};
pub use addc::{Addc, AddcSettings};
pub use feed_forward::{Compensated, FeedForward, Motion};
pub use holding::Holding;
pub use limiter::{CurrentLimit, Limiter};
pub use linear_plant::{Dominant, LinearPlant, PlantError, viscous_n_m_s_per_rad};
pub use loop_shape::{LoopShape, Margins, PiGains, StepPoint};
pub use mrac::{Mrac, MracScales};
pub use notch::Notch;
pub use optimal::{
    LoadObserving, LoadObservingSettings, PaperB, PaperBError, PaperBPlant, PaperBSettings,
};
pub use pi::{AntiWindup, Pi};
pub use response::{Response, SETTLED_SHARE, response};
pub use schedule::{Schedule, Scheduled};
pub use sensor::{Direct, SpeedSensor};
pub use spread::drawn;
pub use timing::LoopTiming;
pub use trial::{Course, TrialMachine, TrialPoint, trial, trial_seen_by};
pub use watch::{Finding, LoopWatch};

#[cfg(test)]
mod loop_tests;

/// What a controller is given in each cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    pub speed_rad_s: f64,
    /// Where the drive measures it.
    pub current_a: Option<f64>,
    /// Unwrapped, where the drive gives it.
    pub angle_rad: Option<f64>,
    /// A limit of the drive held its output: the motor had less than was asked for.
    pub limited: bool,
}

impl Measured {
    pub const fn at(speed_rad_s: f64) -> Self {
        Self { speed_rad_s, current_a: None, angle_rad: None, limited: false }
    }
}

/// What a controller follows, and where its gains are. `None`: not known, or not settled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adapted {
    /// Kp, in the actuator's unit per rad/s, and Tn.
    pub proportional: f64,
    pub integral_time_s: f64,
    /// TM and Ta.
    pub mechanical_s: Option<f64>,
    pub electrical_s: Option<f64>,
    pub inertia_kg_m2: Option<f64>,
    /// Coulomb torque.
    pub load_torque_n_m: Option<f64>,
}

/// A regulator of the shaft's speed.
pub trait SpeedController: Send {
    /// Key in bench files and on the command line.
    fn id(&self) -> &'static str;

    /// The reference of the cycle that comes and of what follows: a function of the time since its sample, s.
    fn foresee(&mut self, _reference_rad_s: &dyn Fn(f64) -> f64) {}

    /// So long before a change of the reference that it foresees its output begins to change, s.
    fn leads_s(&self) -> f64 {
        0.0
    }

    /// From now on the reference is a planned motion, and what it costs is given beside this controller, which regulates
    /// the error about it. False where it has a model of its own, to which that would be a load.
    fn follow_plan(&mut self) -> bool {
        false
    }

    /// One cycle of `period_s`: the output that is wanted, in the unit of the actuator.
    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64;

    /// What another gives beside this controller's own output in this cycle, before [`Self::applied`] of it; zero where it
    /// is never told.
    fn beside(&mut self, _output: f64) {}

    /// What really leaves of its output after all limits; once after each [`Self::step`].
    fn applied(&mut self, output: f64);

    /// Bumpless start: the shaft turns as measured, and `output` is what holds it there. No memory of before remains.
    fn reset(&mut self, now: &Measured, output: f64);

    /// Why the gains are what they are, one sentence each.
    fn explain(&self) -> Vec<String>;

    /// A change of the gains since the last call, as a line of the log.
    fn news(&mut self) -> Option<String> {
        None
    }

    /// Its gains, and what it knows of the machine, as far as they follow what is identified on line.
    fn adapted(&self) -> Option<Adapted> {
        None
    }

    /// Whether its gains can fall.
    fn softens(&self) -> bool {
        false
    }

    /// Gains at this share of what its tuning says, before the step of the cycle that comes, which has this reference and
    /// this speed.
    fn soften(&mut self, _share: f64, _reference_rad_s: f64, _speed_rad_s: f64, _period_s: f64) {}
}

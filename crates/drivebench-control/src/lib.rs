//! Speed control, host-side: tuning, controllers, limiter, feed-forward. Time is an argument of each cycle.
//!
//! ```text
//! model + timing --> tuning (rule) --> gains, reasons, margins over the spread of the parameters, predicted step
//!                                        |
//! reference, Measured --> SpeedController --> wanted output --> limiter --> output --(applied)--> SpeedController
//!                             ^   PI, ADDC, MRAC, LQ            ^
//!       on-line TM, Ta -------/                                 \-- current, voltage, slew
//! ```
//!
//! A [`LoopWatch`] detects oscillation and saturation of any of them, and has the gains reduced where that is possible.
//!
//! A controller is a function of what is measured; it has no link, file or clock. A new one is one file here and one arm
//! where the `[speed]` of a bench file becomes a controller.

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
mod spread;
#[cfg(test)]
pub(crate) mod testing;
mod timing;
mod trial;
pub mod tuning;
mod watch;

pub use actuator::Actuator;
pub use addc::{Addc, AddcSettings};
pub use feed_forward::{Compensated, FeedForward};
pub use holding::Holding;
pub use limiter::{CurrentLimit, Limiter};
pub use linear_plant::{LinearPlant, PlantError, viscous_n_m_s_per_rad};
pub use loop_shape::{LoopShape, Margins, PiGains, StepPoint};
pub use mrac::{Mrac, MracScales};
pub use notch::Notch;
pub use optimal::{
    LoadObserving, LoadObservingSettings, PaperB, PaperBError, PaperBPlant, PaperBSettings,
};
pub use pi::{AntiWindup, Pi};
pub use response::{Response, SETTLED_SHARE, response};
pub use schedule::{Schedule, Scheduled};
pub use spread::drawn;
pub use timing::LoopTiming;
pub use trial::{SpeedSensor, Trial, TrialMachine, TrialPoint};
pub use watch::{Finding, LoopWatch};

#[cfg(test)]
mod loop_tests;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    pub speed_rad_s: f64,
    /// Where the drive measures it.
    pub current_a: Option<f64>,
    /// Unwrapped, where the drive gives it.
    pub angle_rad: Option<f64>,
    /// A limit of the drive held its output below the command.
    pub limited: bool,
}

impl Measured {
    pub const fn at(speed_rad_s: f64) -> Self {
        Self { speed_rad_s, current_a: None, angle_rad: None, limited: false }
    }
}

/// The step at which new gains begin to act: without it the change of gains would be a step of the output.
#[derive(Clone, Copy, Debug)]
pub struct NextStep {
    pub reference_rad_s: f64,
    pub speed_rad_s: f64,
    pub period_s: f64,
}

/// Gains, and the estimates that they follow. `None`: not known, or not settled.
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

pub trait SpeedController: Send {
    /// The reference of the next cycle and after it: a function of the time since its sample, s.
    fn preview(&mut self, _reference_rad_s: &dyn Fn(f64) -> f64) {}

    /// Time before a previewed change of the reference at which its output begins to change, s.
    fn preview_s(&self) -> f64 {
        0.0
    }

    /// From now on the reference is a planned motion whose output is fed forward: the controller regulates the error about
    /// it. False where it has a model of its own, to which that output would be a load.
    fn follow_plan(&mut self) -> bool {
        false
    }

    /// One cycle of `period_s`: the output that is wanted, in the unit of the actuator.
    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64;

    /// Feed-forward that is added to this controller's output in this cycle; before [`Self::applied`].
    fn fed_forward(&mut self, _output: f64) {}

    /// Its own output after all limits; once after each [`Self::step`].
    fn applied(&mut self, output: f64);

    /// Bumpless start: the shaft turns as measured, and `output` holds it there. All states begin anew.
    fn reset(&mut self, now: &Measured, output: f64);

    /// Why the gains are what they are, one sentence each.
    fn explain(&self) -> Vec<String> {
        Vec::new()
    }

    /// A change of the gains since the last call, as a line of the log.
    fn gain_change(&mut self) -> Option<String> {
        None
    }

    /// `None` where nothing is identified on line.
    fn adapted(&self) -> Option<Adapted> {
        None
    }

    fn can_reduce_gain(&self) -> bool {
        false
    }

    /// Gains at this share of the tuned ones from the next step on.
    fn set_gain_share(&mut self, _share: f64, _next: NextStep) {}
}

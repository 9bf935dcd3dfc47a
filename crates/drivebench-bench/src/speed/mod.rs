//! The speed loop on a live drive.
//!
//! ```text
//! [speed] section --> Reference (refused beyond the limits) ---------------------------\
//! model + measured delay (delay.rs) --> Design --> Regulator (controller, limiter) -----+-> SpeedPilot --> session
//!                                          \--> refused: not physical, another motor,  /        |
//!                                               a loop that would oscillate             report: figures of each step
//!
//! speed, limits --> LoopWatch --> smaller gains, or a trip
//! ```

mod delay;
mod pilot;
mod reference;
mod regulator;
mod report;
mod section;
#[cfg(test)]
mod tests;

pub use delay::{LoopDelay, measure_delay};
pub use pilot::{PilotSettings, SpeedPilot};
pub use reference::{Reference, ReferenceError, ReferencePart, ReferenceStep};
pub use regulator::{Design, Regulator, RegulatorError, check_motor, timing};
pub use report::{GainChange, SpeedReport, StepFigures, Tracking, Watched};
pub use section::{ControllerKind, ForwardUse, GainsSection, SpeedSection};

//! Samples, commands and estimates: the values that all crates exchange.
//!
//! ```text
//! wire bytes -> drive link -> Sample -> session -> Command -> drive link -> wire bytes
//!                               |
//!                            recording -> Run (columns) -> identification, diagnosis
//! ```
//!
//! * [`Channel`] is the table of quantities: CSV header, plot axes and configuration keys come from it.
//! * [`Sample`] is one measured instant; [`Command`] is a request of the host to the drive.
//! * [`Run`] is a recorded data set; [`ParameterEstimate`] is a number with its uncertainty.

mod channel;
mod command;
mod estimate;
mod instant;
mod run;

pub use channel::Channel;
pub use command::{Command, Demand};
pub use estimate::{ParameterEstimate, Reason, TWO_SIDED_95, Verdict};
pub use instant::{Applied, DriveState, Hindrance, Quality, Sample};
pub use run::{LARGEST, Origin, Run, RunError, Sensors, Side, SpeedLag};

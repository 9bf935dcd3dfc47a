//! The true machine of the software drive: what the host has to identify.
//!
//! ```text
//! terminal voltage -> [ armature circuit ] -> current -> [ torque balance ] -> speed -> angle
//!                        ^ voltage effects                 ^ torque effects, stick-slip
//!                                   (effect states advance once per step)
//!       | behind an elastic coupling (shaft.rs) a second inertia
//! true values -> [ delay, filter, noise, offset, quantisation ] -> sensor values
//! change.rs: inertia and load that change at given times
//! path.rs: dead times, filters and offsets of commands and measurements
//! ```
//!
//! The hidden effects have other mathematical forms than the host's catalogue, so that a diagnosis is never tested on its own
//! formulas alone. Their keys have the same meaning, so that truth and fit can be compared.

mod change;
pub mod effect;
mod motor;
mod path;
mod plant;
mod sensors;
mod shaft;

pub use change::Change;
pub use motor::MotorTruth;
pub use path::Path;
pub use plant::{Motion, Plant, Terminals};
pub use sensors::{NoiseConfig, QuantisationConfig, Reading, Sensors};

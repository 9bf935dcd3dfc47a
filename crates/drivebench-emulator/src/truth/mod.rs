//! The true machine behind the software drive: what the host has to find out.
//!
//! ```text
//! terminal voltage -> [ armature circuit ] -> current -> [ torque balance ] -> speed -> angle
//!                        ^ voltage effects                 ^ torque effects, stick-slip
//!                                   (effect states advance once per step)
//!       | behind an elastic coupling (shaft.rs) a second inertia
//! true values -> [ delay, filter, noise, offset, quantisation ] -> what the sensors say
//! change.rs: what turns with the shaft and pulls at it, from instants on
//! path.rs: what lies between command, machine and measurement, for the drive and its sensors
//! ```
//!
//! The hidden effects have another mathematical form than the host's catalogue, so that a diagnosis is never tested on
//! its own formula only. Their keys have the same meaning, so that truth and fit can be compared.

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

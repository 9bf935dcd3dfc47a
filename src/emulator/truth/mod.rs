//! The true machine behind the software drive: what the host has to find out.
//!
//! ```text
//! terminal voltage -> [ armature circuit ] -> current -> [ torque balance ] -> speed -> angle
//!                        ^ voltage effects                 ^ torque effects, stick-slip
//!                                   (effect states advance once per step)
//! true values -> [ noise, quantisation ] -> what the sensors say
//! ```
//!
//! The hidden effects have another mathematical form than the host's catalogue, so that a diagnosis is never tested on
//! its own formula only. Their keys have the same meaning, so that truth and fit can be compared.

pub mod effect;
mod motor;
mod plant;
mod sensors;

pub use motor::MotorTruth;
pub use plant::{Motion, Plant, Terminals};
pub use sensors::{NoiseConfig, QuantisationConfig, Reading, Sensors};

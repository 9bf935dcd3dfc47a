//! Motor, load and effects as equations; a model, its file and its simulation.
//!
//! ```text
//! Motor + [Effect] = Model --(compile)--> Plant --(simulate over a Scenario)--> Trajectory
//!   ^                                                     ^
//!   |  model.toml (model_file)                            |  voltage as applied, true sample times
//! ```
//!
//! Baseline: `L di/dt = u - R i - Ke w`, `J dw/dt = Kt i - Mc sgn(w)`, with true stiction.
//! An effect is one file under `effect/` and one line in its catalogue.

mod commanded_current;
pub mod effect;
mod late_rows;
mod limited;
mod model;
mod model_file;
mod motor;
mod motor_range;
mod restored_speed;
mod run_scales;
mod sampled_edges;
mod sampled_torque;
mod scenario;
mod shaft_angle;
mod simulate;
pub mod testing;
mod torque_map;
mod typical_size;
mod unconfirmed;
mod unknown_input;

pub(crate) use crate::numerics::propagator;
pub use effect::{
    Balance, Card, Coupling, Effect, Enters, Instant, ParameterRole, ParameterSpec, Path,
    SearchRange, ShaftAngle, Sums, Terms,
};
pub use limited::LimitReached;
pub use model::{ActiveEffect, Held, Model, ModelError, Slot};
pub use model_file::{FileHistory, FittedValue, ModelFile};
pub use motor::{Motor, MotorKey};
pub use motor_range::{LEAST_TIME_CONSTANT, motor_range};
pub use run_scales::{Measure, REVERSAL_SHARE, RunScales};
pub use scenario::{Input, REFERENCE_SUPPLY_V, Scenario, ScenarioError};
pub use simulate::{
    Correction, Plant, Reading, Sensors as SensorPath, State, SubStep, Trajectory, Transient,
    starts_from_rest,
};
pub use torque_map::{MapBin, MapTextError, MappedTorque, MappedValue, TorqueMap};
pub use typical_size::typical_size;
pub use unknown_input::UnknownInput;

//! Extended Kalman filter: states, parameters and load torque together, sample by sample.
//!
//! ```text
//! samples, voltage as applied --> filter (EKF, 8 states) --> joint: R, L, Ke, J, Mc with verdicts (Kalman)
//!      |                            |-- transition: exact step of i and w     |
//!      +--> scheme 3 (start) -------|-- covariance: Joseph form               |
//!                                   |-- held_voltage: pieces between samples  |
//!                                   +-- sensor: noise, consistency (NIS) -----+
//!                                   |
//! Model (parameters known) ---------+--> load: load torque over time (LoadTracker, load_torque_trace)
//! ```

mod covariance;
mod filter;
mod friction;
mod held_voltage;
mod joint;
mod load;
mod load_trace;
mod sensor;
#[cfg(test)]
mod testbed;
mod transition;

/// Ids of the effects of `model` that the filters do not subtract.
pub fn effects_left_out(model: &crate::plant::Model) -> Vec<&'static str> {
    friction::KnownEffects::left_out(model)
}

pub use joint::{Kalman, KalmanConfig, identify};
pub use load::{LoadError, LoadPoint, LoadTracker};
pub use load_trace::{LoadOptions, LoadTrace, load_torque_trace};

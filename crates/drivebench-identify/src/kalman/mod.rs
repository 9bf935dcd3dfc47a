//! Extended Kalman filter: states, parameters and load torque together, sample by sample.
//!
//! ```text
//! samples, voltage as applied --> filter (EKF, 8 states) --> joint: R, L, Ke, J, Mc with verdicts (Kalman)
//!      |                            |-- physics: exact step of i and w        |
//!      +--> scheme 3 (start) -------+-- signals: voltage held, noise, NIS -----+
//!                                   |
//! Model (parameters known) ---------+--> load: load torque over time (LoadTracker, load_torque_trace)
//! ```

mod filter;
mod joint;
mod load;
mod physics;
mod signals;

pub use joint::{Kalman, identify};
pub use load::{LoadError, LoadPoint, LoadTrace, load_torque_trace};
pub(crate) use physics::KnownEffects;

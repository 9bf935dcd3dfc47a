//! Torque or current in, speed or angle out: the balance of torques as rows of a regression.
//!
//! ```text
//! Evidence --(torque balance in rows: weak form, and the reference processing beside it)--> Balance
//!    |-> regression  every free parameter by least squares: baseline, and each rung of the ladder
//!    |-> sides       a model on held-out rows, in units of what noise leaves in one
//!    '-> compare     torque by the inverse model, speed in windows of 0.75 s
//! ```
//!
//! Here the free run is no judge: an axis in a closed loop is an integrator, and the least offset runs away. The torque
//! balance is linear in every coefficient, has one row per window, and no start value. The weak form decides; the
//! reference processing of the field stands beside it, because the two weigh frequencies differently.

mod compare;
mod regression;
mod sides;
mod terms;

pub(super) use compare::compare;
pub use compare::{ProcessingError, TorqueComparison};
pub(super) use regression::with_events_of;
pub(super) use sides::Balance;

#[cfg(test)]
mod tests;

//! Diagnosis of runs without a voltage: torque or current in, speed or angle out.
//!
//! ```text
//! Evidence --(torque balance in rows: weak form, and the reference processing beside it)--> Sides
//!    |-> trial      one candidate: forms searched, coefficients by least squares, judged on held-out rows
//!    |-> search     best candidate first, again with it, until nothing more pays; then what is superfluous
//!    |-> diagnose   verdict, statuses, sizes                     ladder   add or remove one effect
//!    '-> compare    torque by the inverse model, speed in windows of 0.75 s
//! ```
//!
//! Here the free run is no judge: an axis in a closed loop is an integrator, and the least offset runs away. The torque
//! balance is linear in every coefficient, has one row per window, and no start value. The weak form decides; the
//! reference processing of the field stands beside it, because the two weigh frequencies differently.

mod candidate;
mod compare;
mod diagnose;
mod ladder;
mod regression;
mod score;
mod search;
mod sides;
mod terms;
mod trial;

pub use compare::{ProcessingError, TorqueComparison, compare};
pub use diagnose::{diagnose, judge_extras};
pub use ladder::{add, remove};
pub use terms::Extra;

/// What a test may turn by a fifth: the answer must not depend on it.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Length of the windows in units of the usual one; the reference processing's cut-off is divided by it.
    pub filter: f64,
    /// Length of the blocks of the paired test in units of the usual one.
    pub block: f64,
    /// z above which one model beats another.
    pub significant: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            filter: 1.0,
            block: 1.0,
            significant: 3.0,
        }
    }
}

#[cfg(test)]
mod tests;

//! The way in which what begins at some moment comes to be there.

use super::{Instant, ParameterSpec};

/// Time over which it builds up, s; a true jump would leave its time without a slope to fit it by.
const RISE_S: f64 = 0.01;
/// Rise times after which it has come, to the last bit.
const SETTLED: f64 = 37.0;

/// The moment, found anew in each run.
pub(super) const TIME: ParameterSpec = ParameterSpec::event_time(
    "time_s",
    &[
        0.08, 0.15, 0.22, 0.29, 0.36, 0.43, 0.5, 0.57, 0.64, 0.71, 0.78, 0.85, 0.92,
    ],
);

/// How much of it is there.
pub(super) fn begun(at: &Instant, time_s: f64) -> f64 {
    let since = (at.time_s - time_s) / RISE_S;
    // Beyond, the exponential is lost in the rounding of the one that it is added to, and costs most of a free run.
    if since > SETTLED {
        1.0
    } else if since < -SETTLED {
        0.0
    } else {
        1.0 / (1.0 + (-since).exp())
    }
}

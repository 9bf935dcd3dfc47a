//! Where the floor is, and what share of the error above it is explained.

use super::evidence::Evidence;

/// Error in units of the floor below which a model explains the run to the noise.
const AT_THE_FLOOR: f64 = 1.1;
/// Share of the explainable error from which a named set is sufficient.
pub(super) const SUFFICIENT: f64 = 0.9;
/// The same below which a run that had no part in the answer does not confirm it.
const EXPLAINS_SOMETHING: f64 = 0.3;

/// Share of the explainable error that is explained: `1 - (v^2 - f^2)/(v0^2 - f^2)`; an error below the floor, which is
/// itself an estimate, explains everything and no more.
pub(super) fn explained(before: f64, after: f64, floor: f64) -> f64 {
    let explainable = before * before - floor * floor;
    if explainable <= 0.0 {
        0.0
    } else {
        (1.0 - (after * after - floor * floor) / explainable).min(1.0)
    }
}

/// Whether an error is no more than the noise.
pub(super) fn at_the_floor(evidence: &Evidence, nrms: f64) -> bool {
    nrms < evidence.floor() * evidence.noise.tolerance(AT_THE_FLOOR)
}

/// Whether a good part of what lies above the floor, raised by what that is uncertain by, is explained.
pub(super) fn explains_something(evidence: &Evidence, before: f64, after: f64) -> bool {
    let highest_floor = evidence.floor() * evidence.noise.tolerance(1.0);
    before <= highest_floor || explained(before, after, highest_floor) >= EXPLAINS_SOMETHING
}

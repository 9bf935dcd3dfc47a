//! Symmetrical optimum (Kessler 1958): the phase margin is largest where the gain is one, for a plant that integrates.

use super::{Found, TuningError, modulus_optimum};
use crate::control::{LinearPlant, LoopTiming, PiGains};

/// Kessler's choice: Tn over the small time constant is its square; a phase margin of 37 degrees at `a` = 2 on a pure
/// integrator. The overshoot of the reference comes from the zero, and the filter takes it.
const A: f64 = 2.4;

pub(super) fn gains(
    plant: &LinearPlant,
    timing: &LoopTiming,
    slower: f64,
) -> Result<Found, TuningError> {
    let integrating = plant.dominant().filter(|dominant| {
        let integral_time_s = A * A * (dominant.small_s + timing.small_time_s());
        dominant
            .large_s
            .is_none_or(|large_s| large_s > integral_time_s)
    });
    let Some(dominant) = integrating else {
        let mut found = modulus_optimum::gains(plant, timing, slower)?;
        found.reasons.insert(
            0,
            "the motor is quicker than the Tn of the symmetrical optimum: to the loop it is no integrator, and the modulus optimum serves".to_owned(),
        );
        return Ok(found);
    };
    let small_time_s = slower * (dominant.small_s + timing.small_time_s());
    let proportional = 1.0 / (A * dominant.rate * small_time_s);
    let integral_time_s = A * A * small_time_s;
    Ok(Found {
        gains: PiGains {
            proportional,
            integral_time_s,
            reference_filter_s: integral_time_s,
        },
        small_time_s,
        reasons: vec![format!(
            "symmetrical optimum with a = {A}: Kp = 1 / (a k Ts) = {proportional:.4}, Tn = a^2 Ts = {integral_time_s:.4} s with the small time constant Ts = {:.2} ms; the reference passes a filter of Tn",
            1e3 * small_time_s
        )],
    })
}

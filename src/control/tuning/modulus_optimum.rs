//! Modulus optimum (Kessler 1955): the large time constant is cancelled, the gain set by the sum of the small ones.

use super::{Found, TuningError};
use crate::control::{LinearPlant, LoopTiming, PiGains};

/// Least Tn of a motor that swings, in dead times.
const LEAST_PROPORTIONAL: f64 = 0.5;

pub(super) fn gains(
    plant: &LinearPlant,
    timing: &LoopTiming,
    slower: f64,
) -> Result<Found, TuningError> {
    let rule = "modulus optimum";
    let integrates = TuningError::Integrates { rule };
    let Some(dominant) = plant.dominant() else {
        return swinging(plant, timing, slower).ok_or(integrates);
    };
    let large_s = dominant.large_s.ok_or(integrates)?;
    let small_time_s = slower * (dominant.small_s + timing.small_time_s());
    let proportional = 1.0 / (2.0 * dominant.rate * small_time_s);
    Ok(Found {
        gains: PiGains {
            proportional,
            integral_time_s: large_s,
            reference_filter_s: 0.0,
        },
        small_time_s,
        reasons: vec![format!(
            "{rule}: Tn = {:.4} s cancels the large time constant, Kp = Tn / (2 K Ts) = {proportional:.4} with the small one Ts = {:.2} ms",
            large_s,
            1e3 * small_time_s
        )],
    })
}

/// The plant's own poles swing: nothing can be cancelled by a real zero. The same condition, gain one up to the fourth
/// power of the frequency, solved for the series of the whole plant with its dead time.
fn swinging(plant: &LinearPlant, timing: &LoopTiming, slower: f64) -> Option<Found> {
    let (sum, product) = plant.denominator()?;
    let gain = plant.gain()?;
    let late = timing.small_time_s();
    // (1 + sum s + product s^2) exp(late s) / gain = c0 + c1 s + c2 s^2 + c3 s^3 + ..
    let c0 = 1.0 / gain;
    let c1 = (sum + late) / gain;
    let c2 = (product + sum * late + late * late / 2.0) / gain;
    let c3 = (product * late + sum * late * late / 2.0 + late.powi(3) / 6.0) / gain;
    let integral = (c1 * c1 - c0 * c2) / (2.0 * (c1 * c2 / c0 - c3)) / slower;
    let best = integral * c1 / c0 - 0.5 * c0;
    // A plant that swings hard wants an integrator alone; a little proportional part keeps the form of the regulator.
    let proportional = best.max(LEAST_PROPORTIONAL * integral * late);
    let integral_time_s = proportional / integral;
    (integral > 0.0).then(|| Found {
        gains: PiGains {
            proportional,
            integral_time_s,
            reference_filter_s: 0.0,
        },
        small_time_s: slower * (late + product / sum),
        reasons: vec![format!(
            "modulus optimum for a motor that swings by itself (TM below four times Ta): Kp = {proportional:.4}, Tn = {integral_time_s:.4} s from the series of the whole plant"
        )],
    })
}

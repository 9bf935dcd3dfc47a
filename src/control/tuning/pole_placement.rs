//! Pole placement: the two slow poles of the loop by natural frequency and damping; the reference's filter takes the zero.

use super::Found;
use crate::control::{LinearPlant, LoopTiming, PiGains};

const DAMPING: f64 = 0.9;
/// Natural frequency times small time constant: what the neglected small time constant leaves of the damping.
const FREQUENCY_TIMES_SMALL: f64 = 0.35;

pub(super) fn gains(plant: &LinearPlant, timing: &LoopTiming, slower: f64) -> Found {
    // The slow part as one time constant (none: an integrator), whatever is quicker as the small one.
    let (rate, decay, small_s) = if let Some(dominant) = plant.dominant() {
        (
            dominant.rate,
            dominant.large_s.map_or(0.0, |large_s| 1.0 / large_s),
            dominant.small_s,
        )
    } else {
        let (sum, product) = plant.denominator().unwrap_or((1.0, 1.0));
        (plant.gain().unwrap_or(1.0) / sum, 1.0 / sum, product / sum)
    };
    let small_time_s = slower * (small_s + timing.small_time_s());
    let natural = FREQUENCY_TIMES_SMALL / small_time_s;
    if decay > DAMPING * natural {
        return quick_motor(rate, decay, natural, small_time_s);
    }
    let integral = natural * natural / rate;
    let proportional = (2.0 * DAMPING * natural - decay) / rate;
    let integral_time_s = proportional / integral;
    Found {
        gains: PiGains {
            proportional,
            integral_time_s,
            reference_filter_s: integral_time_s,
        },
        small_time_s,
        reasons: vec![format!(
            "pole placement: natural frequency {natural:.3} rad/s ({FREQUENCY_TIMES_SMALL} over the small time constant of {:.2} ms), damping {DAMPING}: Kp = {proportional:.4}, Tn = {integral_time_s:.4} s; the reference passes a filter of Tn",
            1e3 * small_time_s
        )],
    }
}

/// A motor that is quicker than the loop would have to be slowed down by a negative gain: its own pole is left to it, and
/// one pole is placed.
fn quick_motor(rate: f64, decay: f64, natural: f64, small_time_s: f64) -> Found {
    let (proportional, integral_time_s) = (natural / rate, 1.0 / decay);
    Found {
        gains: PiGains {
            proportional,
            integral_time_s,
            reference_filter_s: 0.0,
        },
        small_time_s,
        reasons: vec![format!(
            "pole placement for a motor that is quicker than the loop: Tn = {integral_time_s:.4} s leaves it its own pole, Kp = {proportional:.4} places one at {natural:.3} rad/s ({FREQUENCY_TIMES_SMALL} over the small time constant of {:.2} ms)",
            1e3 * small_time_s
        )],
    }
}

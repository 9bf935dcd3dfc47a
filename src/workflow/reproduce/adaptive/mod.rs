//! The adaptive control of paper A: Figures 5 to 7, and every regulator on the same cases.
//!
//! ```text
//! bench (ZK-22FC's circuit, TM = 0.2 s, 10 ms with two cycles of delay) -> steps (Figures 5, 6), figure_7, comparison
//! ```

mod figure_7;
mod steps;
#[cfg(test)]
mod tests;

use serde::Serialize;

pub use figure_7::{Adaptation, Cycle, Figure7, Saturated, Slower};
pub use steps::{Figure5, Figure6, SteppedBy};

use super::loops::{Bench, Comparison, Sizes, comparison};
use super::machine::made_of;
use crate::control::{LoadObservingSettings, LoopTiming, PaperBSettings};
use crate::plant::Model;

/// Mechanical time constants of Figure 6, s; the regulators are made for the first.
pub const MECHANICAL_S: [f64; 3] = [0.2, 0.05, 1.0];
/// Sampling period and delay: a host at 100 Hz behind a link that takes two cycles.
const PERIOD_S: f64 = 0.01;
const DELAY_CYCLES: f64 = 2.0;
/// Steps of the square wave, rad/s, each level held for so long, s.
const LEVELS_RAD_S: [f64; 2] = [90.0, 110.0];
const HALF_S: f64 = 4.0;
/// Forgetting factor of Figure 6.
pub const FORGETTING: f64 = 0.96;
const SIZES: Sizes = Sizes {
    levels_rad_s: LEVELS_RAD_S,
    half_s: HALF_S,
    start_rad_s: 250.0,
    load_n_m: 1.0,
};

/// Figures 5 to 7 of paper A.
#[derive(Clone, Debug, Serialize)]
pub struct AdaptiveLoop {
    pub figure_5: Figure5,
    pub figure_6: Figure6,
    pub figure_7: Figure7,
    pub comparison: Comparison,
}

pub(super) fn adaptive_loop(mut begins: impl FnMut(&str)) -> AdaptiveLoop {
    let bench = bench();
    begins("Figures 5 and 6");
    let (figure_5, figure_6) = (steps::figure_5(&bench), steps::figure_6(&bench));
    begins("Figure 7");
    let figure_7 = figure_7::figure_7(&bench);
    begins("every regulator on the same cases");
    AdaptiveLoop {
        figure_5,
        figure_6,
        figure_7,
        comparison: comparison(&bench, &SIZES),
    }
}

/// What the text leaves open in Figures 5 to 7.
pub(super) fn chosen() -> String {
    format!(
        "Loop of Figures 5 to 7: the text gives TM and beta of Figure 6 and nothing else. Motor: circuit and friction of the ZK-22FC (1.1 ohm, Ta = 9 ms, 0.3538 V.s/rad, 0.455 N.m) with TM = {} s as the regulators know it; T = {:.0} ms with {DELAY_CYCLES:.0} cycles of delay in the tuning, noise of 0.15 rad/s and 30 mA, current limit 10 A. Tuning rule of ADDC: modulus optimum; the paper prints none. Figure 5 has no data in the text: a regulator tuned for TM = {} s on a shaft of {} s, and the adaptation joins in the middle. Figure 7 is a block diagram: what its text says of ADDC and MRAC is measured.",
        MECHANICAL_S[0],
        1e3 * PERIOD_S,
        MECHANICAL_S[0],
        MECHANICAL_S[1]
    )
}

/// The text gives no motor for Figures 5 and 6: the circuit of the ZK-22FC, its friction, and TM of Figure 6.
fn bench() -> Bench {
    Bench {
        name: "paper A's motor behind a link",
        model: Model::baseline(made_of(
            "ZK-22FC at TM = 0.2 s",
            1.1,
            0.3538,
            [0.009, MECHANICAL_S[0]],
            0.455,
        )),
        timing: LoopTiming {
            period_s: PERIOD_S,
            delay_s: DELAY_CYCLES * PERIOD_S,
            filter_s: 0.0,
        },
        current_limit_a: 10.0,
        voltage_limit_v: 110.0,
        speed_noise_rad_s: 0.15,
        current_noise_a: 0.03,
        scale_rad_s: 120.0,
        forgetting: FORGETTING,
        // Paper B's design knows no delay: behind two cycles of it only a slow one holds.
        paper_b: PaperBSettings {
            voltage_cost: 2.0,
            filter_share: 0.3,
            compensation: 0.03,
            ..PaperBSettings::default()
        },
        observer: LoadObservingSettings::default(),
    }
}

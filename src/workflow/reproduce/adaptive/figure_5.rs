//! Figure 5: what a response gains when the adaptation joins. The text gives no data of it.

use serde::Serialize;

use super::{HALF_S, LEVELS_RAD_S, MECHANICAL_S, PERIOD_S, SEED};
use crate::control::{Course, TrialPoint, trial};
use crate::workflow::reproduce::loops::{Bench, Joining, Step, cycles, square, steps};

/// Steps of the reference before the adaptation joins, and in all.
const FIXED_STEPS: usize = 4;
const STEPS: usize = 8;

/// A PI regulator tuned for another inertia; in the middle the adaptation joins.
#[derive(Clone, Debug, Serialize)]
pub struct Figure5 {
    pub tuned_for_s: f64,
    pub mechanical_s: f64,
    pub joins_at_s: f64,
    pub before: Vec<Step>,
    pub after: Vec<Step>,
    #[serde(skip)]
    pub trace: Vec<TrialPoint>,
    /// TM as estimated, s; none before the adaptation joins or where the estimate is not settled.
    #[serde(skip)]
    pub estimate_s: Vec<f64>,
    #[serde(skip)]
    pub proportional: Vec<f64>,
}

pub(super) fn figure_5(bench: &Bench) -> Figure5 {
    let joins_at_s = FIXED_STEPS as f64 * HALF_S;
    let joins_at = cycles(joins_at_s, PERIOD_S);
    let mut controller = Joining::new(bench.pi(), bench.addc(), joins_at);
    let [low, high] = LEVELS_RAD_S;
    let ratio = MECHANICAL_S[1] / MECHANICAL_S[0];
    let course = Course {
        reference_rad_s: &square(HALF_S, high, low),
        inertia_kg_m2: &|_| ratio * bench.inertia(),
        load_n_m: &|_| 0.0,
    };
    let length = cycles(STEPS as f64 * HALF_S, PERIOD_S);
    let (machine, limiter) = (bench.machine(), bench.limiter());
    let trace = trial(&machine, &course, &mut controller, &limiter, length, SEED);
    let mut before = steps(&trace);
    let after = before.split_off(FIXED_STEPS);
    Figure5 {
        tuned_for_s: MECHANICAL_S[0],
        mechanical_s: MECHANICAL_S[1],
        joins_at_s,
        // The first is the start from standstill.
        before: before.split_off(1),
        after,
        trace,
        estimate_s: controller
            .ratios
            .iter()
            .map(|ratio| ratio * MECHANICAL_S[0])
            .collect(),
        proportional: controller.proportional,
    }
}

//! Figures 5 and 6: steps of the reference with fixed gains and with adaptation. In Figure 5, of which the text gives no
//! data, the adaptation joins in the middle; in Figure 6 TM jumps from 0.2 to 0.05 to 1 s.

use serde::Serialize;

use super::{FORGETTING, HALF_S, LEVELS_RAD_S, MECHANICAL_S, PERIOD_S};
use crate::control::TrialPoint;
use crate::numerics::count::whole;
use crate::workflow::reproduce::loops::{Bench, Joining, Step, Trial, cycles, square, steps};

/// Steps of the reference before the adaptation joins, and in all.
const FIXED_STEPS: usize = 4;
const ALL_STEPS: usize = 8;

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
    let length_s = ALL_STEPS as f64 * HALF_S;
    let (trace, controller) = joined(bench, joins_at, length_s, &|_| MECHANICAL_S[1]);
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
        estimate_s: estimates_s(&controller),
        proportional: controller.proportional,
    }
}

/// The square wave over a shaft of this TM under a regulator to which the adaptation joins, and what became of it.
fn joined(
    bench: &Bench,
    joins_at: usize,
    length_s: f64,
    mechanical_s: &dyn Fn(f64) -> f64,
) -> (Vec<TrialPoint>, Joining) {
    let mut controller = Joining::new(bench.pi(), bench.addc(), joins_at);
    let [low, high] = LEVELS_RAD_S;
    let trace = Trial::of(bench, square(HALF_S, high, low))
        .with_inertia_ratio(bench, |t| mechanical_s(t) / MECHANICAL_S[0])
        .run(&mut controller, length_s);
    (trace, controller)
}

/// TM after each cycle as it was estimated, s.
fn estimates_s(controller: &Joining) -> Vec<f64> {
    let ratios = controller.ratios.iter();
    ratios.map(|ratio| ratio * MECHANICAL_S[0]).collect()
}

/// Steps of the reference with each TM.
const STEPS_EACH: usize = 6;
/// What an adapted step may take: this much of the acceleration at the current limit, and so many small time constants.
const ACCELERATION_SHARE: f64 = 1.3;
const SMALL_TIMES: f64 = 5.0;

/// One step of the reference with both regulators.
#[derive(Clone, Debug, Serialize)]
pub struct SteppedBy {
    pub mechanical_s: f64,
    /// 1 for the first step with this TM.
    pub step: usize,
    pub fixed: Step,
    pub adaptive: Step,
    /// 1.3 times the acceleration at the current limit and five small time constants, s.
    pub allowed_settling_s: f64,
    /// TM as estimated at the end of the step, s.
    pub estimate_s: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct Figure6 {
    pub forgetting: f64,
    pub period_s: f64,
    pub delay_s: f64,
    pub steps: Vec<SteppedBy>,
    #[serde(skip)]
    pub fixed: Vec<TrialPoint>,
    #[serde(skip)]
    pub adaptive: Vec<TrialPoint>,
    #[serde(skip)]
    pub mechanical_s: Vec<f64>,
    #[serde(skip)]
    pub estimate_s: Vec<f64>,
    #[serde(skip)]
    pub proportional: [Vec<f64>; 2],
}

impl Figure6 {
    /// Steps with the n-th TM from the second on: one is let to notice.
    pub fn adapted(&self, n: usize) -> impl Iterator<Item = &SteppedBy> {
        let with = move |step: &&SteppedBy| {
            step.step > 1 && step.mechanical_s.to_bits() == MECHANICAL_S[n].to_bits()
        };
        self.steps.iter().filter(with)
    }
}

pub(super) fn figure_6(bench: &Bench) -> Figure6 {
    let each_s = HALF_S * STEPS_EACH as f64;
    let mechanical = |t: f64| {
        let section = MECHANICAL_S.len().min(1 + whole(t / each_s + 1e-9)) - 1;
        MECHANICAL_S[section]
    };
    let run = |joins_at| joined(bench, joins_at, 3.0 * each_s, &mechanical);
    let (fixed, fixed_pi) = run(usize::MAX);
    let (adaptive, adapted) = run(0);
    let estimate_s = estimates_s(&adapted);
    let rows = cycles(HALF_S, PERIOD_S);
    let pairs = steps(&fixed).into_iter().zip(steps(&adaptive));
    let stepped = pairs.enumerate().map(|(n, (fixed, adaptive))| {
        let mechanical_s = mechanical(adaptive.at_s);
        SteppedBy {
            mechanical_s,
            step: n % STEPS_EACH + 1,
            allowed_settling_s: allowed_s(bench, mechanical_s, &adaptive),
            estimate_s: estimate_s[(n + 1) * rows - 1],
            fixed,
            adaptive,
        }
    });
    Figure6 {
        forgetting: FORGETTING,
        period_s: PERIOD_S,
        delay_s: bench.timing.delay_s,
        // The first is the start from standstill.
        steps: stepped.skip(1).collect(),
        mechanical_s: fixed.iter().map(|point| mechanical(point.time_s)).collect(),
        fixed,
        adaptive,
        estimate_s,
        proportional: [fixed_pi.proportional, adapted.proportional],
    }
}

/// By the current that is left for the acceleration; friction helps to brake, the worse way counts.
fn allowed_s(bench: &Bench, mechanical_s: f64, step: &Step) -> f64 {
    let ratio = mechanical_s / MECHANICAL_S[0];
    let machine = bench.machine();
    let torque = machine.torque_n_m_per_a * bench.current_limit_a - machine.friction_n_m;
    let change = (step.to_rad_s - step.from_rad_s).abs();
    let acceleration_s = change * ratio * bench.inertia() / torque;
    ACCELERATION_SHARE * acceleration_s + SMALL_TIMES * bench.tuning(ratio).small_time_s
}

//! The adaptive control of paper A: Figures 5 and 6 (steps of the reference with fixed gains and with adaptation), what the
//! text states about the block diagram of Figure 7 (ADDC against MRAC), and every regulator on the same cases.
//!
//! In Figure 5, of which the text gives no data, the adaptation joins in the middle; in Figure 6 TM jumps from 0.2 to 0.05
//! to 1 s. The text to Figure 7: MRAC adapts sooner, ADDC needs no disconnection in saturation. Both claims are measured.

use serde::Serialize;

use super::loops::{
    Bench, Comparison, Joining, Kind, Named, Sizes, Step, comparison, cycles, error,
    limited_percent, rms, square, steps,
};
use super::machine::made_of;
use drivebench::control::{LoadObservingSettings, LoopTiming, PaperBSettings, TrialPoint};
use drivebench::numerics::count::whole;
use drivebench::plant::Model;

/// Mechanical time constants of Figure 6, s; the regulators are made for the first.
pub const MECHANICAL_S: [f64; 3] = [0.2, 0.05, 1.0];
pub const FORGETTING: f64 = 0.96;
/// Sampling period, s, and delay: a host at 100 Hz behind a link that takes two cycles.
const PERIOD_S: f64 = 0.01;
const DELAY_CYCLES: f64 = 2.0;
const SIZES: Sizes =
    Sizes { levels_rad_s: [90.0, 110.0], half_s: 4.0, start_rad_s: 250.0, load_n_m: 1.0 };

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
    let (figure_5, figure_6) = (figure_5(&bench), figure_6(&bench));
    begins("Figure 7");
    let figure_7 = figure_7(&bench);
    begins("every regulator on the same cases");
    AdaptiveLoop { figure_5, figure_6, figure_7, comparison: comparison(&bench, &SIZES) }
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
        timing: LoopTiming { period_s: PERIOD_S, delay_s: DELAY_CYCLES * PERIOD_S, filter_s: 0.0 },
        current_limit_a: 10.0,
        voltage_limit_v: 110.0,
        speed_noise_rad_s: 0.15,
        current_noise_a: 0.03,
        scale_rad_s: 120.0,
        forgetting: FORGETTING,
        // Paper B's design has no delay: behind two cycles of it only a slow one holds.
        paper_b: PaperBSettings {
            voltage_cost: 2.0,
            filter_share: 0.3,
            compensation: 0.03,
            ..PaperBSettings::default()
        },
        observer: LoadObservingSettings::default(),
    }
}

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
    // Four steps of the reference before the adaptation joins, and four after it.
    let joins_at_s = 4.0 * SIZES.half_s;
    let joins_at = cycles(joins_at_s, PERIOD_S);
    let (trace, controller) = joined(bench, joins_at, 2.0 * joins_at_s, &|_| MECHANICAL_S[1]);
    let mut before = steps(&trace);
    let after = before.split_off(4);
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

/// The trace of the square wave with this TM, and the regulator, whose adaptation starts at cycle `joins_at`.
fn joined(
    bench: &Bench,
    joins_at: usize,
    length_s: f64,
    mechanical_s: &dyn Fn(f64) -> f64,
) -> (Vec<TrialPoint>, Joining) {
    let mut controller = Joining::new(bench.pi(), bench.addc(), joins_at);
    let [low, high] = SIZES.levels_rad_s;
    let trace = (bench.trial(square(SIZES.half_s, high, low)))
        .with_inertia(|t| bench.inertia() * (mechanical_s(t) / MECHANICAL_S[0]))
        .run(&mut controller, length_s);
    (trace, controller)
}

/// TM after each cycle as it was estimated, s.
fn estimates_s(controller: &Joining) -> Vec<f64> {
    let ratios = controller.ratios.iter();
    ratios.map(|ratio| ratio * MECHANICAL_S[0]).collect()
}

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
    // Steps of the reference with each TM.
    let steps_each: u32 = 6;
    let each_s = SIZES.half_s * f64::from(steps_each);
    let mechanical = |t: f64| {
        let section = MECHANICAL_S.len().min(1 + whole(t / each_s + 1e-9)) - 1;
        MECHANICAL_S[section]
    };
    let run = |joins_at| joined(bench, joins_at, 3.0 * each_s, &mechanical);
    let (fixed, fixed_pi) = run(usize::MAX);
    let (adaptive, adapted) = run(0);
    let estimate_s = estimates_s(&adapted);
    let rows = cycles(SIZES.half_s, PERIOD_S);
    let pairs = steps(&fixed).into_iter().zip(steps(&adaptive));
    let stepped = pairs.enumerate().map(|(n, (fixed, adaptive))| {
        let mechanical_s = mechanical(adaptive.at_s);
        SteppedBy {
            mechanical_s,
            step: n % steps_each as usize + 1,
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

/// 1.3 times the acceleration by the current that friction leaves for it (it helps to brake: the worse way counts), and five
/// small time constants.
fn allowed_s(bench: &Bench, mechanical_s: f64, step: &Step) -> f64 {
    let ratio = mechanical_s / MECHANICAL_S[0];
    let machine = bench.machine();
    let torque = machine.torque_n_m_per_a * bench.current_limit_a - machine.friction_n_m;
    let change = (step.to_rad_s - step.from_rad_s).abs();
    let acceleration_s = change * ratio * bench.inertia() / torque;
    1.3 * acceleration_s + 5.0 * bench.tuning(ratio).small_time_s
}

/// Start and brake to full speed, and the jumps of TM.
struct Figure7Settings {
    /// Start and brake: standstill to full speed and back, each step for `full_half_s`.
    full_rad_s: f64,
    full_half_s: f64,
    full_steps: f64,
    /// End of each of these steps over which its error counts.
    counted_s: f64,
    /// Heights of the steps with which the adaptation is compared, about the middle.
    heights_rad_s: [f64; 4],
    middle_rad_s: f64,
    small_half_s: f64,
    steps_before: usize,
    steps_after: usize,
    /// A shaft is where an adapted regulator would have it within this share of the step's height.
    adapted_share: f64,
}

const JUMPS: Figure7Settings = Figure7Settings {
    full_rad_s: 250.0,
    full_half_s: 5.0,
    full_steps: 12.0,
    counted_s: 2.0,
    heights_rad_s: [1.0, 4.0, 10.0, 20.0],
    middle_rad_s: 100.0,
    small_half_s: 4.0,
    steps_before: 6,
    steps_after: 12,
    adapted_share: 0.1,
};

/// One start or brake.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Cycle {
    pub to_rad_s: f64,
    /// Root mean square error over the last 2 s.
    pub error_rad_s: f64,
    pub limited_percent: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct Saturated {
    pub controller: Kind,
    pub cycles: Vec<Cycle>,
    #[serde(skip)]
    pub trace: Vec<TrialPoint>,
}

impl Saturated {
    /// Largest error of the last four.
    pub fn end_error_rad_s(&self) -> f64 {
        let from = self.cycles.len().saturating_sub(4);
        let errors = self.cycles[from..].iter().map(|cycle| cycle.error_rad_s);
        errors.fold(0.0, f64::max)
    }
}

/// How a regulator gets over a jump of TM, against the same regulator made for the new TM on a shaft that always had it.
#[derive(Clone, Debug, Serialize)]
pub struct Adaptation {
    pub controller: Kind,
    pub mechanical_s: f64,
    pub height_rad_s: f64,
    /// With the sensors' noise.
    pub noise: bool,
    /// Integral of the absolute error to the reference over the first step after the jump, over its height, s.
    pub error_s: f64,
    /// The same for the regulator that is made for the new TM.
    pub adapted_error_s: f64,
    /// Integral of the absolute difference between the two, over the height, s: of the first step and of the last.
    pub first_deviation_s: f64,
    pub last_deviation_s: f64,
    /// After which the difference stays below 10 % of the height, s; `None` if not before the last step.
    pub adapted_after_s: Option<f64>,
    /// Cycles of the first step in which a limit held the output.
    pub limited_percent: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct Figure7 {
    pub full_rad_s: f64,
    pub saturated: Vec<Saturated>,
    pub adaptation: Vec<Adaptation>,
    /// ADDC, and ADDC by forgetting alone, against MRAC.
    pub addc_slower: [Slower; 2],
    /// The jump to 0.05 s at the largest height that saturates neither, without noise.
    pub shown: Vec<Named>,
    pub shown_height_rad_s: f64,
}

impl Figure7 {
    /// ADDC, ADDC by forgetting alone and MRAC in the same case.
    fn cases(&self) -> impl Iterator<Item = [&Adaptation; 3]> {
        let cases = self.adaptation.chunks_exact(RIVALS.len());
        cases.map(|case| [&case[0], &case[1], &case[2]])
    }

    /// Jumps without noise in whose first step no limit was met.
    pub fn fair(&self) -> impl Iterator<Item = [&Adaptation; 3]> {
        let is_fair = |one: &&Adaptation| !one.noise && one.limited_percent == 0.0;
        self.cases().filter(move |case| case.iter().all(is_fair))
    }

    /// Where ADDC is the slower one.
    fn slower(&self, which: usize) -> Slower {
        let late = |found: &Adaptation| found.adapted_after_s.unwrap_or(f64::INFINITY);
        let count = |is: &dyn Fn(&Adaptation, &Adaptation) -> bool| {
            self.fair().filter(|case| is(case[which], case[2])).count()
        };
        Slower {
            jumps: self.fair().count(),
            by_first_step: count(&|addc, mrac| addc.error_s > mrac.error_s),
            by_straying: count(&|addc, mrac| addc.first_deviation_s > mrac.first_deviation_s),
            by_end: count(&|addc, mrac| late(addc) > late(mrac)),
        }
    }
}

/// In how many of the fair jumps a form of ADDC is slower than MRAC, by three measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Slower {
    pub jumps: usize,
    /// Integral of the absolute error over the first step after the jump.
    pub by_first_step: usize,
    /// Distance of the first step from that of an adapted regulator.
    pub by_straying: usize,
    /// Time until it is back where an adapted regulator would have the shaft.
    pub by_end: usize,
}

const RIVALS: [Kind; 3] = [Kind::Addc, Kind::AddcForgetting, Kind::MracDisconnected];

pub(super) fn figure_7(bench: &Bench) -> Figure7 {
    let kinds = [Kind::Addc, Kind::MracDisconnected, Kind::MracConnected];
    let mut adaptation = Vec::new();
    let mut shown = (0.0, Vec::new());
    for noise in [false, true] {
        for mechanical_s in [MECHANICAL_S[1], MECHANICAL_S[2]] {
            for height_rad_s in JUMPS.heights_rad_s {
                let found = RIVALS.map(|kind| jump(bench, kind, mechanical_s, height_rad_s, noise));
                let is_fair = found.iter().all(|(found, _)| found.limited_percent == 0.0);
                if is_fair && !noise && mechanical_s < MECHANICAL_S[0] {
                    let traces = found
                        .iter()
                        .map(|(found, trace)| Named::new(found.controller.name(), trace.clone()));
                    shown = (height_rad_s, traces.collect());
                }
                adaptation.extend(found.map(|(found, _)| found));
            }
        }
    }
    let mut figure = Figure7 {
        full_rad_s: JUMPS.full_rad_s,
        saturated: kinds.map(|kind| start_and_brake(bench, kind)).into(),
        adaptation,
        addc_slower: [Slower::default(); 2],
        shown: shown.1,
        shown_height_rad_s: shown.0,
    };
    figure.addc_slower = [0, 1].map(|which| figure.slower(which));
    figure
}

fn start_and_brake(bench: &Bench, kind: Kind) -> Saturated {
    let seconds = JUMPS.full_half_s * JUMPS.full_steps;
    let trial = bench.trial(square(JUMPS.full_half_s, 0.0, JUMPS.full_rad_s));
    let trace = trial.run(&mut *bench.controller(kind), seconds);
    let rows = cycles(JUMPS.full_half_s, PERIOD_S);
    let counted = cycles(JUMPS.counted_s, PERIOD_S);
    let cycle = |chunk: &[TrialPoint]| Cycle {
        to_rad_s: chunk[0].reference_rad_s,
        error_rad_s: rms(chunk[rows - counted..].iter().map(error)),
        limited_percent: limited_percent(chunk),
    };
    Saturated { controller: kind, cycles: trace.chunks(rows).map(cycle).collect(), trace }
}

/// How a regulator gets over a jump of TM that comes with a step of the reference, and its trace about the jump.
fn jump(
    bench: &Bench,
    kind: Kind,
    mechanical_s: f64,
    height_rad_s: f64,
    noise: bool,
) -> (Adaptation, Vec<TrialPoint>) {
    let half = 0.5 * height_rad_s;
    let jump_s = JUMPS.steps_before as f64 * JUMPS.small_half_s;
    let ratio = mechanical_s / MECHANICAL_S[0];
    let run = |regulators: &Bench, ratio: &dyn Fn(f64) -> f64| {
        let reference =
            square(JUMPS.small_half_s, JUMPS.middle_rad_s + half, JUMPS.middle_rad_s - half);
        let mut trial = bench.trial(reference).with_inertia(|t| bench.inertia() * ratio(t));
        if !noise {
            trial.machine.speed_noise_rad_s = 0.0;
            trial.machine.current_noise_a = 0.0;
        }
        let seconds = (JUMPS.steps_before + JUMPS.steps_after) as f64 * JUMPS.small_half_s;
        trial.run(&mut *regulators.controller(kind), seconds)
    };
    let trace = run(bench, &|t| if t >= jump_s - 1e-9 { ratio } else { 1.0 });
    // The same regulator made for the new TM, on a shaft that always had it.
    let adapted = run(&bench.with_inertia_ratio(ratio), &|_| ratio);
    let rows = cycles(JUMPS.small_half_s, PERIOD_S);
    let after = JUMPS.steps_before * rows..;
    let pairs = trace[after.clone()].iter().zip(&adapted[after]);
    let away: Vec<f64> =
        pairs.map(|(now, adapted)| (now.speed_rad_s - adapted.speed_rad_s).abs()).collect();
    let over_height = |sum: f64| PERIOD_S * sum / height_rad_s;
    let outside = |away: &f64| *away > JUMPS.adapted_share * height_rad_s;
    let back = away.iter().rposition(outside).map_or(0, |last| last + 1);
    let step = |trace: &[TrialPoint]| steps(trace).swap_remove(JUMPS.steps_before);
    let (first, adapted_first) = (step(&trace), step(&adapted));
    let cost = |step: &Step| step.response.absolute_error_rad / height_rad_s;
    let adaptation = Adaptation {
        controller: kind,
        mechanical_s,
        height_rad_s,
        noise,
        error_s: cost(&first),
        adapted_error_s: cost(&adapted_first),
        first_deviation_s: over_height(away[..rows].iter().sum()),
        last_deviation_s: over_height(away[away.len() - rows..].iter().sum()),
        adapted_after_s: (back < away.len() - rows).then_some(PERIOD_S * back as f64),
        limited_percent: first.limited_percent,
    };
    let from_s = jump_s - 2.0 * JUMPS.small_half_s;
    let shown = trace.into_iter().filter(|point| point.time_s >= from_s);
    (adaptation, shown.collect())
}

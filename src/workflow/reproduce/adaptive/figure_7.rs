//! ADDC against MRAC. Figure 7 of the paper is a block diagram; what its text says of both is measured here: MRAC adapts
//! sooner, ADDC needs no disconnection in saturation.

use serde::Serialize;

use super::{MECHANICAL_S, PERIOD_S};
use crate::control::TrialPoint;
use crate::workflow::reproduce::loops::{
    Bench, Kind, Named, Step, Trial, cycles, error, limited_percent, rms, square, steps,
};

/// Start and brake: standstill to full speed and back, each for so long, s.
const FULL_RAD_S: f64 = 250.0;
const FULL_HALF_S: f64 = 5.0;
const FULL_STEPS: usize = 12;
/// End of each step over which its error counts, s.
const COUNTED_S: f64 = 2.0;

/// Heights of the steps with which the adaptation is compared, rad/s about this speed.
const HEIGHTS_RAD_S: [f64; 4] = [1.0, 4.0, 10.0, 20.0];
const MIDDLE_RAD_S: f64 = 100.0;
const SMALL_HALF_S: f64 = 4.0;
/// Steps before the jump and after it.
const STEPS_BEFORE: usize = 6;
const STEPS_AFTER: usize = 12;
/// A shaft is where an adapted regulator would have it within this share of the step's height.
const ADAPTED_SHARE: f64 = 0.1;

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
    pub fn saturated_of(&self, kind: Kind) -> Option<&Saturated> {
        self.saturated.iter().find(|run| run.controller == kind)
    }

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
            for height_rad_s in HEIGHTS_RAD_S {
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
        full_rad_s: FULL_RAD_S,
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
    let seconds = FULL_HALF_S * FULL_STEPS as f64;
    let trial = Trial::of(bench, square(FULL_HALF_S, 0.0, FULL_RAD_S));
    let trace = trial.run(&mut *bench.controller(kind), seconds);
    let rows = cycles(FULL_HALF_S, PERIOD_S);
    let counted = cycles(COUNTED_S, PERIOD_S);
    let cycle = |chunk: &[TrialPoint]| Cycle {
        to_rad_s: chunk[0].reference_rad_s,
        error_rad_s: rms(chunk[rows - counted..].iter().map(error)),
        limited_percent: limited_percent(chunk),
    };
    Saturated {
        controller: kind,
        cycles: trace.chunks(rows).map(cycle).collect(),
        trace,
    }
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
    let jump_s = STEPS_BEFORE as f64 * SMALL_HALF_S;
    let ratio = mechanical_s / MECHANICAL_S[0];
    let run = |bench_told: &Bench, ratio: &dyn Fn(f64) -> f64| {
        let reference = square(SMALL_HALF_S, MIDDLE_RAD_S + half, MIDDLE_RAD_S - half);
        let mut trial = Trial::of(bench, reference).with_inertia_ratio(bench, ratio);
        if !noise {
            trial.machine.speed_noise_rad_s = 0.0;
            trial.machine.current_noise_a = 0.0;
        }
        let seconds = (STEPS_BEFORE + STEPS_AFTER) as f64 * SMALL_HALF_S;
        trial.run(&mut *bench_told.controller(kind), seconds)
    };
    let trace = run(bench, &|t| if t >= jump_s - 1e-9 { ratio } else { 1.0 });
    // The same regulator made for the new TM, on a shaft that always had it.
    let adapted = run(&bench.with_inertia_ratio(ratio), &|_| ratio);
    let rows = cycles(SMALL_HALF_S, PERIOD_S);
    let after = STEPS_BEFORE * rows..;
    let pairs = trace[after.clone()].iter().zip(&adapted[after]);
    let away: Vec<f64> = pairs
        .map(|(now, adapted)| (now.speed_rad_s - adapted.speed_rad_s).abs())
        .collect();
    let over_height = |sum: f64| PERIOD_S * sum / height_rad_s;
    let outside = |away: &f64| *away > ADAPTED_SHARE * height_rad_s;
    let back = away.iter().rposition(outside).map_or(0, |last| last + 1);
    let step = |trace: &[TrialPoint]| steps(trace).swap_remove(STEPS_BEFORE);
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
    let from_s = jump_s - 2.0 * SMALL_HALF_S;
    let shown = trace.into_iter().filter(|point| point.time_s >= from_s);
    (adaptation, shown.collect())
}

//! Pairs that one run does not distinguish: the recommended run is made, and separates them as expected.

use super::*;
use crate::kit::{held, nameplate, truth as with};
use crate::{Diagnosis, DiagnosisVerdict, diagnose};
use drivebench_identify::output_error::{self, FreeRun};
use drivebench_model::excitation::{Output, Program};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::levenberg_marquardt::{Options, Problem, minimise};
use drivebench_model::plant::{Model, testing};

const LIMITS: ExperimentLimits = ExperimentLimits {
    voltage_v: 110.0,
    current_a: 13.0,
    speed_rad_s: 340.0,
    rms_current_a: 5.7,
    travel_rad: None,
    duration_s: 30.0,
    slew_v_per_s: f64::INFINITY,
    period_s: PERIOD_S,
};
const PERIOD_S: f64 = 0.004;

/// The commands of a recipe in steps of `period_s`, and how long they take.
fn commands(recipe: &Recipe, period_s: f64) -> (Vec<(f64, f64)>, f64) {
    let program = Program::new(&recipe.segments, recipe.slew_v_per_s).unwrap();
    let command = |row: usize| {
        let time_s = row as f64 * period_s;
        match program.value_at(time_s) {
            Output::Voltage(volts) => (time_s, volts),
            Output::Coast => panic!("no recipe coasts"),
        }
    };
    let rows = whole(program.duration_s() / period_s);
    ((0..rows).map(command).collect(), program.duration_s())
}

/// The run of a recipe on the machine `truth`.
fn made(truth: &Model, recipe: &Recipe, seed: u64) -> Scenario {
    let (events, seconds) = commands(recipe, PERIOD_S);
    testing::record(truth, events, PERIOD_S, seconds, seed)
}

/// Joint fit of one model to the old data and the new.
struct Both<'a> {
    old: FreeRun<'a>,
    new: &'a Scenario,
    evidence: &'a Evidence,
}

impl Problem for Both<'_> {
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
        let rows = self.old.residual_len();
        let model = self.old.model_at(x);
        let new = FreeRun::new(&model, self.new, self.evidence.noise).unwrap();
        let there = new.start();
        new.residual(&there, &mut out[rows..]) && self.old.residual(x, &mut out[..rows])
    }

    fn residual_len(&self) -> usize {
        self.old.residual_len() + 2 * self.new.samples()
    }

    fn difference_step(&self, index: usize) -> f64 {
        self.old.difference_step(index)
    }

    fn clamp(&self, x: &mut [f64]) {
        self.old.clamp(x);
    }
}

fn chi2_of_both(model: &Model, evidence: &Evidence, new: &Scenario) -> f64 {
    let old = FreeRun::new(model, &evidence.training, evidence.noise).unwrap();
    let start = old.start();
    let both = Both { old, new, evidence };
    minimise(&both, &start, Options::default()).unwrap().cost
}

/// A case: the truth, its rival, and the run in hand.
struct Case {
    truth: Model,
    rival: Model,
    events: Vec<(f64, f64)>,
    seconds: f64,
}

struct Answer {
    next: NextExperiment,
    obtained: f64,
    again: Diagnosis,
}

/// Recommends, makes the run, and diagnoses it.
fn answer(case: &Case) -> Answer {
    let events = || case.events.clone();
    let run = |seed| testing::record(&case.truth, events(), PERIOD_S, case.seconds, seed);
    let evidence = Evidence::new(run(1), Some(run(2)), None);
    let fitted = |model: &Model| {
        let start = std::slice::from_ref(model);
        output_error::fit(start, &evidence.training, &evidence.noise).unwrap().model
    };
    let (truth, rival) = (fitted(&case.truth), fitted(&case.rival));
    let next = next_experiment([&truth, &rival], &evidence, &LIMITS).unwrap().unwrap();
    let recipe =
        next.recipe.clone().unwrap_or_else(|| panic!("{:?} {:?}", next.finding, next.menu));
    let new = made(&case.truth, &recipe, 3);
    let obtained = chi2_of_both(&rival, &evidence, &new) - chi2_of_both(&truth, &evidence, &new);
    println!(
        "{:?}: {} expected {:.0} obtained {obtained:.0}\n  {:?}",
        next.pair, recipe.id, next.expected_separation, next.menu
    );
    let again = Evidence::new(new, Some(made(&case.truth, &recipe, 4)), None);
    Answer { next, obtained, again: diagnose(&nameplate(), again).unwrap() }
}

fn entry(next: &NextExperiment, program: &str) -> f64 {
    next.menu.iter().find(|entry| entry.program == program).unwrap().expected_separation
}

/// The run is expected to separate, does so to the same order, and its diagnosis names the truth alone.
/// A `useless` run is expected to separate hardly.
fn separated(case: &Case, best: &[&str], useless: &str) -> NextExperiment {
    let Answer { next, obtained, again } = answer(case);
    let expected = next.expected_separation;
    assert!(expected > SEPARATED && next.finding == Recommendation::Distinguishes, "{expected}");
    // Menu and decision need the same separation.
    let recommended = next.recipe.as_ref().unwrap().id;
    let chosen = next.menu.iter().find(|entry| entry.program == recommended).unwrap();
    assert!(chosen.is_separated(), "{chosen:?}");
    assert_eq!(chosen.needed.to_bits(), next.pairs[0].needed.to_bits());
    let ratio = obtained / expected;
    assert!((0.3..30.0).contains(&ratio), "{ratio}");
    let id = case.truth.effects[0].id();
    assert_eq!((again.verdict, &again.effects[..]), (DiagnosisVerdict::Effect, &[id][..]));
    let useless = entry(&next, useless);
    assert!(useless < 0.01 * expected, "{useless} of {expected}");
    assert!(best.contains(&recommended), "{recommended}");
    next
}

#[test]
fn a_drag_law_needs_the_whole_range_of_speeds() {
    let events = held(&[38.0, 45.0, 41.0, 52.0, 47.0, 55.0, 40.0, 50.0], 0.7);
    let case = Case {
        truth: with("quadratic_load", &[1.5e-6]),
        rival: with("viscous_friction", &[4e-4]),
        events,
        seconds: 6.5,
    };
    let next = separated(&case, &["slow_ramp", "rich"], "standstill");
    assert!(entry(&next, "standstill") < 1.0);
    assert!(entry(&next, "slow_ramp") > 10.0 * entry(&next, "steady_hold"));
}

#[test]
fn a_delay_and_a_filter_of_the_speed_need_a_fast_dither() {
    // Up, down and back: slow ramps, which show a lag but not its kind.
    let command = |k| {
        let time_s = 0.004 * f64::from(k);
        let legs = (time_s - 0.5).max(0.0) / 1.375;
        (time_s, 40.0 * (1.0 - (legs - 1.0).abs().min(2.0) + (legs - 3.0).max(0.0)))
    };
    let case = Case {
        truth: with("speed_delay", &[0.004]),
        rival: with("speed_filter", &[0.004]),
        events: (0..1500).map(command).collect(),
        seconds: 6.0,
    };
    separated(&case, &["fast_dither"], "standstill");
}

#[test]
fn offsets_of_voltage_and_current_need_both_directions() {
    let case = Case {
        truth: with("voltage_offset", &[0.5]),
        rival: with("current_offset", &[0.3]),
        events: held(&[20.0, 60.0, 35.0, 80.0, 50.0, 70.0, 30.0], 0.7),
        seconds: 6.0,
    };
    let best = ["hard_cycling", "heat_and_repeat", "slow_ramp", "rich", "random_levels"];
    separated(&case, &best, "steady_hold");
}

#[test]
fn a_sag_and_a_saturation_need_large_currents_at_several_duties() {
    let case = Case {
        truth: with("supply_sag", &[0.3]),
        rival: with("flux_saturation", &[4e-4]),
        events: held(&[30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0], 0.7),
        seconds: 6.0,
    };
    let best = ["hard_cycling", "dither_at_speed", "rich"];
    separated(&case, &best, "standstill");
}

#[test]
fn the_slew_of_the_bench_is_kept_and_a_faster_run_is_named() {
    let case = [with("speed_delay", &[0.008]), with("speed_filter", &[0.008])];
    let run = |seed| testing::record(&case[0], held(&[20.0, -20.0, 30.0], 0.7), 0.01, 2.6, seed);
    let evidence = Evidence::new(run(1), Some(run(2)), None);
    let slow = ExperimentLimits { slew_v_per_s: 200.0, period_s: 0.01, ..LIMITS };
    for recipe in menu_within(&case[0], &slow) {
        assert!(recipe.slew_v_per_s <= 200.0, "{recipe:?}");
        for pair in commands(&recipe, 0.01).0.windows(2) {
            let change_v = (pair[1].1 - pair[0].1).abs();
            assert!(change_v <= 2.0 + 1e-9, "{}: {change_v} V in 10 ms", recipe.id);
        }
    }
    let recommended = |limits: &ExperimentLimits| {
        next_experiment([&case[0], &case[1]], &evidence, limits).unwrap().unwrap()
    };
    let slowly = recommended(&slow);
    assert!(slowly.recipe.is_none(), "{slowly:?}");
    let has_faster =
        matches!(slowly.finding, Recommendation::CannotDistinguish { faster: Some(_) });
    assert!(has_faster, "{:?}", slowly.finding);
    let freely = recommended(&ExperimentLimits { slew_v_per_s: f64::INFINITY, ..slow });
    assert_eq!(freely.recipe.unwrap().id, "fast_dither");
}

#[test]
fn limits_are_kept_and_a_pair_may_stay_ambiguous_within_them() {
    let evidence_of = |truth: &Model| {
        let events = held(&[38.0, 55.0], 0.7);
        let run = |seed| testing::record(truth, events.clone(), PERIOD_S, 2.0, seed);
        Evidence::new(run(1), Some(run(2)), None)
    };
    let truth = with("quadratic_load", &[1.5e-6]);
    let rival = with("viscous_friction", &[4e-4]);
    let tight = ExperimentLimits { voltage_v: 3.0, current_a: 2.5, ..LIMITS };
    let next = next_experiment([&truth, &rival], &evidence_of(&truth), &tight).unwrap().unwrap();
    assert!(next.recipe.is_none() && next.peaks.is_none());
    assert!(next.expected_separation < SEPARATED);
    assert_eq!(next.finding, Recommendation::CannotDistinguish { faster: None });
    // Offsets are separated within the peaks of the runs in hand.
    let truth = with("voltage_offset", &[0.5]);
    let rival = with("current_offset", &[0.3]);
    let evidence = evidence_of(&truth);
    let seen = ExperimentLimits::seen_in(&evidence);
    let runs = [&evidence.training, &evidence.holdout];
    let hottest_a = runs.map(|run| mean_square(&run.current_a).sqrt());
    assert!(seen.rms_current_a <= hottest_a[0].max(hottest_a[1]));
    let unknown = ExperimentLimits { current_a: f64::INFINITY, ..LIMITS };
    assert!(!menu_within(&truth, &LIMITS).is_empty() && menu_within(&truth, &unknown).is_empty());
    let next = next_experiment([&truth, &rival], &evidence, &seen);
    let peaks = next.unwrap().unwrap().peaks.unwrap();
    assert!(peaks.voltage_v <= 55.0 && peaks.current_a <= seen.current_a, "{peaks:?}");
    assert!(peaks.rms_current_a <= seen.rms_current_a, "{peaks:?}");
}

#[test]
fn an_empty_menu_is_no_finding() {
    let run = |seed| testing::record(&nameplate(), held(&[38.0, 55.0], 0.7), PERIOD_S, 2.0, seed);
    let evidence = Evidence::new(run(1), Some(run(2)), None);
    let found = diagnose(&nameplate(), evidence.clone()).unwrap();
    let next = |limits: &ExperimentLimits| recommend(&found, &evidence, limits).unwrap();
    let open = next(&LIMITS).unwrap();
    assert!(open.pair.is_none() && !open.menu.is_empty(), "{open:?}");
    // No run is planned without a limit of the current.
    let unknown =
        ExperimentLimits { current_a: f64::INFINITY, rms_current_a: f64::INFINITY, ..LIMITS };
    let none = next(&unknown).map(|next| next.finding);
    assert_eq!(none, None);
}

//! Diagnosis over a faulty line: a hidden effect is named all the same where replies come late, twice or not at all.

use super::witness::drive::{BENCH, Drive};
use super::witness::fault::{Act, Way};
use super::witness::motor::Hidden;
use super::{BenchFile, trial_of};
use drivebench_diagnose::{Diagnosis, DiagnosisVerdict, Evidence, diagnose};
use drivebench_model::plant::{Model, Scenario};

/// Of each kind of spoilt reply so many in a thousand; late ones by this much, s.
const SPOILT: u32 = 10;
const LATE_S: f64 = 0.03;

/// What is hidden, by the name that it has to be given.
const HIDDEN: [(&str, Hidden); 4] = [
    ("viscous_friction", Hidden::Viscous(2.5e-3)),
    ("quadratic_load", Hidden::Fan(1e-5)),
    ("voltage_drop", Hidden::Brushes(1.5)),
    ("stribeck_friction", Hidden::Stribeck(0.2, 12.0)),
];
const MACHINES: u64 = 20;
/// Five spoilt replies within the silence that ends a run end it, once in some ten minutes; such a run is made again.
const MOST_AGAIN: u64 = 2;
/// Where the host stamps commands, the time that a write takes may be named beside it: that is there as well.
const OF_THE_LINE: &str = "command_delay";
/// Standard deviations that hold 95 % of the values, and those that one of some hundred reaches.
const TWO_SIDED_95: f64 = 1.96;
const OUTERMOST: f64 = 3.5;

/// The steps of the bench, at more speeds: a torque in proportion to the speed is to be told from one of its square.
fn bench() -> String {
    let few = "levels_v = [55.0, 0.0, -55.0, 40.0, -30.0, 0.0], hold_s = 0.7";
    let many = "levels_v = [57.0, 15.0, 40.0, -25.0, -57.0, -10.0, 50.0, 25.0, 0.0], hold_s = 0.8";
    assert!(BENCH.contains(few));
    BENCH.replace(few, many)
}

/// `None`: the link was lost.
fn answer(hidden: Hidden, act: Act, seed: u64) -> Option<Diagnosis> {
    let text = bench();
    let drive = Drive::new(act, seed).hiding(hidden);
    let trial = trial_of(&text, drive, None, Way::Commission);
    if trial.status == 3 && trial.said.contains("link silent") {
        return None;
    }
    assert_eq!(trial.status, 0, "seed {seed}: {}", trial.said);
    let records = trial.records.iter();
    let mut runs = records.map(|run| Scenario::from_run(run).unwrap());
    let evidence = Evidence::new(runs.next().unwrap(), runs.next(), runs.next());
    let motor = BenchFile::parse("bench.toml", &text).unwrap().motor.motor();
    Some(diagnose(&Model::baseline(motor), evidence).unwrap())
}

/// By how many standard deviations the motor's parameters lie apart.
fn moves(a: &Diagnosis, b: &Diagnosis) -> Vec<f64> {
    let of = |diagnosis: &Diagnosis| {
        let all = diagnosis.model.parameters.clone().into_iter();
        all.filter(|estimate| !estimate.key.contains('.'))
            .filter_map(|estimate| Some((estimate.key, estimate.value?, estimate.std?)))
    };
    let mut moves = Vec::new();
    for (key, value, std) in of(a) {
        let other = of(b).find(|(other, ..)| *other == key);
        moves.extend(other.map(|(_, other, other_std)| (value - other) / std.hypot(other_std)));
    }
    moves
}

/// What came of one machine: what is wrong, how far its parameters moved, and the runs that were made again.
#[derive(Default)]
struct Outcome {
    wrong: Option<String>,
    moves: Vec<f64>,
    again: u64,
}

fn machine(seed: u64) -> Outcome {
    let (name, hidden) = HIDDEN[usize::try_from(seed).unwrap() % HIDDEN.len()];
    let line = Act::PoorLine(LATE_S, SPOILT);
    let spoilt = (0..=MOST_AGAIN)
        .find_map(|time| Some((time, answer(hidden, line, seed + time * MACHINES)?)));
    let (again, spoilt) = spoilt.unwrap();
    let clean = answer(hidden, Act::Nothing, seed).unwrap();
    let effects = spoilt.effects.iter().filter(|id| **id != OF_THE_LINE);
    let named = spoilt.verdict == DiagnosisVerdict::Effect && effects.eq([&name]);
    let wrong = format!("{seed}, {name}: {} (clean: {})", spoilt.sentence, clean.sentence);
    Outcome { wrong: (!named).then_some(wrong), moves: moves(&spoilt, &clean), again }
}

#[test]
fn the_hidden_effect_is_named_over_a_poor_line() {
    let outcomes: Vec<Outcome> = std::thread::scope(|scope| {
        let half = |first: u64| (first..MACHINES).step_by(2).map(machine).collect();
        let halves: [_; 2] = [0, 1].map(|first| scope.spawn(move || half(first)));
        let joined = |half: std::thread::ScopedJoinHandle<'_, Vec<Outcome>>| half.join().unwrap();
        halves.into_iter().flat_map(joined).collect()
    });
    let wrong: Vec<&str> = outcomes.iter().filter_map(|o| o.wrong.as_deref()).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(outcomes.iter().map(|o| o.again).sum::<u64>() <= MOST_AGAIN);
    let apart: Vec<f64> = outcomes.iter().flat_map(|o| o.moves.clone()).collect();
    let beyond = |sigmas: f64| apart.iter().filter(|by| by.abs() > sigmas).count();
    assert!(apart.len() > 50, "{}", apart.len());
    assert!(beyond(TWO_SIDED_95) <= apart.len() / 20, "{apart:?}");
    assert_eq!(beyond(OUTERMOST), 0, "{apart:?}");
}

//! Diagnosis over a faulty line: a hidden effect is found where replies come late, twice or not at all.
//!
//! Two machines for each effect; `DRIVEBENCH_MACHINES` sets their number.

use super::witness::drive::{BENCH, Drive};
use super::witness::fault::{Act, Way};
use super::witness::motor::Hidden;
use super::witness::trials;
use super::{BenchFile, trial_of};
use drivebench_diagnose::{Diagnosis, DiagnosisVerdict, Evidence, diagnose};
use drivebench_model::plant::{Model, Scenario};

/// Ten faulty replies of each kind in a thousand; late ones by 30 ms.
const LINE: Act = Act::PoorLine(0.03, 10);

/// Hidden effects, with their ids in the diagnosis.
const HIDDEN: [(&str, Hidden); 4] = [
    ("viscous_friction", Hidden::Viscous(2.5e-3)),
    ("quadratic_load", Hidden::Fan(1e-5)),
    ("voltage_drop", Hidden::Brushes(1.5)),
    ("stribeck_friction", Hidden::Stribeck(0.2, 12.0)),
];
/// Seeds of repeated runs lie this far apart.
const MOST_MACHINES: u64 = 100;
/// Five faulty replies within the allowed silence end a run, once in some ten minutes; such a run is repeated.
const MOST_REPEATED: u64 = 2;

/// The steps of the bench, at more speeds, which distinguish a torque in proportion to the speed from one of its square.
fn bench() -> String {
    let few = "levels_v = [55.0, 0.0, -55.0, 40.0, -30.0, 0.0], hold_s = 0.7";
    let many = "levels_v = [57.0, 15.0, 40.0, -25.0, -57.0, -10.0, 50.0, 25.0, 0.0], hold_s = 0.8";
    assert!(BENCH.contains(few));
    BENCH.replace(few, many)
}

/// `None`: the link was lost.
fn answer(hidden: Hidden, act: Act, seed: u64) -> Option<Diagnosis> {
    let text = bench();
    let trial = trial_of(&text, Drive::new(act, seed).hiding(hidden), None, Way::Commission);
    if trial.status == 3 && trial.output.contains("link silent") {
        return None;
    }
    assert_eq!(trial.status, 0, "seed {seed}: {}", trial.output);
    let mut runs = trial.records.iter().map(|run| Scenario::from_run(run).unwrap());
    let evidence = Evidence::new(runs.next().unwrap(), runs.next(), runs.next());
    let motor = BenchFile::parse("bench.toml", &text).unwrap().motor.motor();
    Some(diagnose(&Model::baseline(motor), evidence).unwrap())
}

/// Differences of the motor's parameters in standard deviations.
fn moves(a: &Diagnosis, b: &Diagnosis) -> Vec<f64> {
    let of = |diagnosis: &Diagnosis| {
        (diagnosis.model.parameters.clone().into_iter())
            .filter(|estimate| !estimate.key.contains('.'))
            .filter_map(|estimate| Some((estimate.key, estimate.value?, estimate.std?)))
    };
    let mut moves = Vec::new();
    for (key, value, std) in of(a) {
        let other = of(b).find(|(other, ..)| *other == key);
        moves.extend(other.map(|(_, other, other_std)| (value - other) / std.hypot(other_std)));
    }
    moves
}

/// One machine: the wrong diagnosis, the differences of its parameters, and the repeated runs.
#[derive(Default)]
struct Outcome {
    wrong: Option<String>,
    moves: Vec<f64>,
    repeated: u64,
}

fn machine(seed: u64) -> Outcome {
    let (name, hidden) = HIDDEN[usize::try_from(seed).unwrap() % HIDDEN.len()];
    let spoilt = (0..=MOST_REPEATED)
        .find_map(|time| Some((time, answer(hidden, LINE, seed + time * MOST_MACHINES)?)));
    let (repeated, spoilt) = spoilt.unwrap();
    let clean = answer(hidden, Act::Nothing, seed).unwrap();
    // Where the host stamps commands, the time of a write is there as well, and may be named.
    let effects = spoilt.effects.iter().filter(|id| **id != "command_delay");
    let named = spoilt.verdict == DiagnosisVerdict::Effect && effects.eq([&name]);
    let named_too = (&spoilt.effects, &clean.effects);
    let wrong = format!("{seed}, {name}: {:?}, {named_too:?}", spoilt.answer());
    Outcome { wrong: (!named).then_some(wrong), moves: moves(&spoilt, &clean), repeated }
}

#[test]
fn the_hidden_effect_is_named_over_a_poor_line() {
    let given = std::env::var("DRIVEBENCH_MACHINES").ok();
    let machines = given.map_or(8, |given| given.parse().unwrap()).min(MOST_MACHINES);
    let seeds: Vec<u64> = (0..machines).collect();
    let outcomes = trials::at_once(2, &seeds, |seed| machine(*seed));
    let wrong: Vec<&str> = outcomes.iter().filter_map(|o| o.wrong.as_deref()).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(outcomes.iter().map(|o| o.repeated).sum::<u64>() <= MOST_REPEATED);
    let apart: Vec<f64> = outcomes.iter().flat_map(|o| o.moves.clone()).collect();
    let beyond = |sigmas: f64| apart.iter().filter(|by| by.abs() > sigmas).count();
    assert!(apart.len() as u64 > 3 * machines, "{}", apart.len());
    // 5 % of normal values, and none of some hundred.
    assert!(beyond(1.96) <= apart.len() / 20, "{apart:?}");
    assert_eq!(beyond(3.5), 0, "{apart:?}");
}

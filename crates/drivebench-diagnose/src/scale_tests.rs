//! An answer does not depend on the units of a machine: a record with every voltage, current, speed and time multiplied by a
//! constant has the same verdict and names, and sizes that are multiplied likewise.

use std::panic::{self, AssertUnwindSafe};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::kit::{nameplate, record};
use super::*;
use drivebench_model::plant::effect::CATALOGUE;
use drivebench_model::plant::{
    ActiveEffect, Effect, Model, Motor, MotorKey, ParameterRole, ParameterSpec, effect, testing,
    typical_size,
};

/// Factors of voltage, current, speed and time.
type Factors = [f64; 4];

fn motor([v, a, w, s]: Factors) -> Model {
    let torque = v * a / w;
    let factors = [
        (MotorKey::Resistance, v / a),
        (MotorKey::Inductance, v * s / a),
        (MotorKey::BackEmf, v / w),
        (MotorKey::Inertia, torque * s / w),
        (MotorKey::LoadTorque, torque),
    ];
    let given = nameplate().motor;
    let scaled = factors.iter().fold(Motor::new("scaled"), |motor, (key, factor)| {
        motor.with(*key, factor * given.get(*key).unwrap())
    });
    Model::baseline(scaled)
}

/// Factor of a parameter by its unit.
fn of_unit(unit: &str, [v, a, w, s]: Factors) -> f64 {
    let torque = v * a / w;
    match unit {
        "V" => v,
        "A" => a,
        "rad/s" => w,
        "s" => s,
        "Hz" | "1/s" => 1.0 / s,
        "rad" => w * s,
        "ohm" => v / a,
        "N.m" => torque,
        "N.m.s/rad" => torque / w,
        "N.m.s2/rad2" => torque / (w * w),
        "1/A2" => 1.0 / (a * a),
        "1/(A2.s)" => 1.0 / (a * a * s),
        "-" | "1/turn" => 1.0,
        other => panic!("no factor of {other}"),
    }
}

/// Twice the typical size or more of an effect: some ten per cent of torque or voltage.
fn truth(effect: &'static dyn Effect) -> Model {
    let run = record(&nameplate(), 0, 1);
    let value = |(index, spec): (usize, &ParameterSpec)| match spec.role {
        ParameterRole::Coefficient => 2.5 * typical_size(effect, index, &nameplate(), &run),
        ParameterRole::Choice => 6.0,
        ParameterRole::EventTime => 3.1,
        ParameterRole::Shape => spec.guess(),
    };
    let values: Vec<f64> = effect.parameters().iter().enumerate().map(value).collect();
    let mut model = nameplate();
    model.effects.push(ActiveEffect::with(effect, &values));
    model
}

fn answer(truth: &Model, factors: Factors) -> Diagnosis {
    let run = |shift: usize| testing::scaled(&record(truth, shift, 31 + shift as u64), factors);
    diagnose(&motor(factors), Evidence::new(run(0), Some(run(1)), None)).unwrap()
}

#[track_caller]
fn is_the_same(effect: &'static dyn Effect, here: &Diagnosis, there: &Diagnosis, factors: Factors) {
    let id = effect.card().id;
    let names = |found: &Diagnosis| (found.verdict, found.effects.clone());
    assert_eq!(names(here), names(there), "{id} {factors:?}");
    // A turn is no unit: a shaft that turns through more of them within a sample shows no wave over the angle.
    let turns_alike = (factors[2] * factors[3] - 1.0).abs() < 1e-9;
    let is_judged =
        |own: &&Candidate| turns_alike || !effect::find(own.effect).unwrap().card().needs_angle;
    let statuses = |found: &Diagnosis| {
        let all = found.candidates.iter().filter(is_judged);
        let mut all: Vec<_> = all.map(|own| (own.effect, own.status)).collect();
        all.sort_by_key(|own| own.0);
        all
    };
    assert_eq!(statuses(here), statuses(there), "{id} {factors:?}");
    for own in &here.candidates {
        let other = there.candidates.iter().find(|other| other.effect == own.effect).unwrap();
        for (a, b) in own.parameters.iter().zip(&other.parameters) {
            if let (Some(a_value), Some(b_value)) = (a.value, b.value) {
                // A sag is referred to one supply voltage, whatever the machine's is.
                let of_supply = if a.key.ends_with("sag_ohm") { factors[0].powi(-2) } else { 1.0 };
                let ratio = b_value / (a_value * of_supply * of_unit(a.unit, factors));
                assert!((ratio - 1.0).abs() < 0.01, "{id} {}: {ratio} {factors:?}", a.key);
            }
        }
    }
}

/// Factors between a hundredth and a hundred; with an effect over the angle those under which the shaft turns through the same.
fn draw(effect: &dyn Effect, seed: u64) -> Factors {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut factor = || 10f64.powf(rng.random_range(-2.0..2.0));
    let [v, a, w, s] = [(); 4].map(|()| factor());
    if effect.card().needs_angle { [v, a, w, 1.0 / w] } else { [v, a, w, s] }
}

fn holds(effect: &'static dyn Effect, draws: u64) {
    let truth = truth(effect);
    let here = answer(&truth, [1.0; 4]);
    for seed in 0..draws {
        let factors = draw(effect, seed);
        is_the_same(effect, &here, &answer(&truth, factors), factors);
    }
}

#[test]
fn an_answer_does_not_depend_on_the_units_of_a_machine() {
    for id in ["stribeck_friction", "voltage_drop", "load_step"] {
        holds(effect::find(id).unwrap(), 1);
    }
}

#[test]
#[ignore = "eight minutes: all effects, 20 draws each; 31 of 660 draws differ"]
fn no_answer_depends_on_the_units_of_a_machine() {
    // Every draw is judged, whatever another one does.
    let fails = |id: &'static str| {
        let (effect, truth) = (effect::find(id).unwrap(), truth(effect::find(id).unwrap()));
        let here = answer(&truth, [1.0; 4]);
        let differs = move |seed: &u64| {
            let factors = draw(effect, *seed);
            let there = answer(&truth, factors);
            let judged = || is_the_same(effect, &here, &there, factors);
            panic::catch_unwind(AssertUnwindSafe(judged)).is_err()
        };
        (0..20).filter(differs).map(move |seed| (id, seed))
    };
    let failed: Vec<(&str, u64)> =
        CATALOGUE.iter().flat_map(|effect| fails(effect.card().id)).collect();
    assert!(failed.is_empty(), "{failed:?}");
}

//! Models that lack something, fitted to records of a motor whose truth is known.

use super::*;
use crate::scheme::Identified;
use crate::testing::*;
use crate::weak_form;
use drivebench_model::plant::{Input, Model};
use drivebench_model::sample::Run;

/// A small brushed motor: L/R 0.5 ms, R J/Ke^2 19 ms.
const BRUSHED: Truth = [1.2, 6e-4, 0.05, 4e-5, 0.012];
const KEY: [&str; 5] = [
    "resistance_ohm",
    "inductance_h",
    "back_emf_v_s_per_rad",
    "inertia_kg_m2",
    "load_torque_n_m",
];

fn brushed() -> Model {
    Model::baseline(motor(&BRUSHED))
}

fn brushed_with(id: &str, values: &[f64]) -> Model {
    let mut model = brushed().with_effect(id).unwrap();
    model.effects[0].values = values.iter().copied().map(Some).collect();
    model
}

/// Steps up to 12 V in both directions after a rest, sampled at 500 Hz; each falls on a sample.
fn record_of(model: &Model, seconds: f64) -> Run {
    recorded(&record(
        model,
        steps(0.3, seconds, 12.0 / 70.0, 0.2),
        0.002,
        seconds,
        3,
    ))
}

/// Each parameter is within three of its deviations of the truth, or is not called settled; the misfit is given.
#[track_caller]
fn honest(run: &Run, truth: &[f64]) -> Identified {
    let found = identify("output-error", run, &unknown()).unwrap();
    let known = || KEY.iter().zip(truth).filter(|known| known.1.is_finite());
    for (key, truth) in known() {
        let own = of(&found.parameters, key);
        let is_settled = own.verdict == Verdict::Settled;
        assert!(!is_settled || covers(own, *truth, 3.0), "{own:?} {truth}");
    }
    found
}

#[test]
fn a_model_that_lacks_nothing_keeps_its_intervals_and_its_verdicts() {
    let found = honest(&record_of(&brushed(), 4.0), &BRUSHED);
    let misfit = found.misfit.unwrap();
    assert_eq!(misfit.0.len(), 2);
    for left in &misfit.0 {
        assert!((0.9..1.1).contains(&left.times_noise.unwrap()), "{left:?}");
        assert!(left.common_share < 0.1, "{left:?}");
    }
    for key in KEY {
        judged(&found.parameters, key, Verdict::Settled);
    }
}

#[test]
fn a_late_speed_is_no_settled_resistance() {
    let mut run = record_of(&brushed(), 4.0);
    let speed = run.column(Channel::Speed).unwrap().to_vec();
    let late = (0..speed.len())
        .map(|row| speed[row.saturating_sub(6)])
        .collect();
    put(&mut run, Channel::Speed, late);
    let found = honest(&run, &BRUSHED);
    // What the held levels say of it.
    let resistance = judged(&found.parameters, KEY[0], Verdict::Searching);
    assert_covers(resistance, 1.2, 0.05, 3.0);
    let inertia = judged(&found.parameters, KEY[3], Verdict::Searching);
    assert_says(inertia, &["times the noise of"]);
}

#[test]
fn a_long_record_without_its_viscous_friction_is_not_settled_far_off() {
    let truth = brushed_with("viscous_friction", &[1.5e-5]);
    honest(&record_of(&truth, 30.0), &BRUSHED);
}

#[test]
fn a_motor_that_warms_up_has_no_settled_back_emf() {
    // The resistance itself changes: what it was is any of its values.
    let truth = brushed_with("winding_heating", &[2e-3, 20.0]);
    let mut known = BRUSHED;
    known[0] = f64::NAN;
    honest(&record_of(&truth, 20.0), &known);
}

/// The torque balance of a record without a voltage.
fn balance_of(model: &Model, scenario: &Scenario) -> Vec<ParameterEstimate> {
    let mut model = model.clone();
    model.motor.set(MotorKey::TorqueConstant, BRUSHED[2]);
    let balances = weak_form::fit(&model, scenario).into_iter();
    balances.flat_map(|own| own.parameters).collect()
}

#[test]
fn a_balance_that_lacks_viscous_friction_is_no_settled_friction() {
    let model = brushed_with("viscous_friction", &[1.5e-5]);
    let mut scenario = record(&model, steps(0.3, 4.0, 12.0 / 70.0, 0.2), 0.002, 4.0, 3);
    scenario.input = Input::Current;
    let mut found = balance_of(&unknown(), &scenario);
    assert!(!covers(of(&found, KEY[4]), BRUSHED[4], 3.0), "{found:?}");
    widen_by_forms_of_torque(&mut found, 500, |form| {
        Some(balance_of(&unknown().with_effect(form).ok()?, &scenario))
    });
    let friction = judged(&found, KEY[4], Verdict::Searching);
    assert!(covers(friction, BRUSHED[4], 1.5), "{friction:?}");
    assert_says(friction, &["viscous_friction, if it acts"]);
}

#[test]
fn a_balance_that_lacks_nothing_keeps_its_verdicts() {
    let mut scenario = record(&brushed(), steps(0.3, 4.0, 12.0 / 70.0, 0.2), 0.002, 4.0, 3);
    scenario.input = Input::Current;
    let before = balance_of(&unknown(), &scenario);
    let mut found = before.clone();
    widen_by_forms_of_torque(&mut found, 500, |form| {
        Some(balance_of(&unknown().with_effect(form).ok()?, &scenario))
    });
    judged(&found, KEY[4], Verdict::Settled);
    for place in [3, 4] {
        let [before, after] = [&before, &found].map(|all| of(all, KEY[place]));
        assert_eq!(before.verdict, after.verdict, "{after:?}");
        assert!(covers(after, BRUSHED[place], 3.0), "{after:?}");
        assert!(after.std.unwrap() < 1.3 * before.std.unwrap(), "{after:?}");
    }
}

//! Models that lack something, fitted to records of a motor whose truth is known.

use super::*;
use crate::scheme::Identified;
use crate::testing::*;
use crate::weak_form;
use drivebench_model::plant::{Input, Model, MotorKey};
use drivebench_model::sample::Run;

/// Steps up to 12 V in both directions after a rest, sampled at 500 Hz; each falls on a sample.
fn record_of(model: &Model, seconds: f64) -> Run {
    recorded(&scenario_of(model, seconds))
}

fn scenario_of(model: &Model, seconds: f64) -> Scenario {
    let events = steps(0.3, seconds, 12.0 / 70.0, 0.2);
    record(model, events, 0.002, seconds, 3)
}

/// Each parameter is within three of its deviations of the truth, or is not called settled; the misfit is given.
#[track_caller]
fn honest(run: &Run, truth: &[f64]) -> Identified {
    let found = identify("output-error", run, &unknown()).unwrap();
    for (key, truth) in KEYS.iter().zip(truth).filter(|known| known.1.is_finite()) {
        let own = of(&found.parameters, key.key());
        let is_settled = own.verdict == Verdict::Settled;
        assert!(!is_settled || covers(own, *truth, 3.0), "{own:?} {truth}");
    }
    found
}

#[test]
fn a_model_that_lacks_nothing_keeps_its_intervals() {
    let found = honest(&record_of(&brushed(), 4.0), &BRUSHED);
    let misfit = found.misfit.unwrap();
    assert_eq!(misfit.0.len(), 2);
    for left in &misfit.0 {
        assert!((0.9..1.1).contains(&left.times_noise.unwrap()), "{left:?}");
        assert!(left.common_share < 0.1, "{left:?}");
    }
    for key in KEYS {
        judged(&found.parameters, key.key(), Verdict::Settled);
    }
}

#[test]
fn a_late_speed_is_no_settled_resistance() {
    let mut run = record_of(&brushed(), 4.0);
    let speed = run.column(Channel::Speed).unwrap().to_vec();
    let late = (0..speed.len()).map(|row| speed[row.saturating_sub(6)]).collect();
    put(&mut run, Channel::Speed, late);
    let found = honest(&run, &BRUSHED);
    // What the held levels say of it.
    assert_covers(judged(&found.parameters, KEYS[0].key(), Verdict::Searching), 1.2, 0.05, 3.0);
    let inertia = judged(&found.parameters, KEYS[3].key(), Verdict::Searching);
    assert_says(inertia, &["times the noise of"]);
}

#[test]
fn parameters_that_an_effect_bends_are_not_settled_far_off() {
    honest(&record_of(&with(&brushed(), "viscous_friction", &[1.5e-5]), 30.0), &BRUSHED);
    // The resistance itself changes: what it was is any of its values.
    let heating = with(&brushed(), "winding_heating", &[2e-3, 20.0]);
    let mut known = BRUSHED;
    known[0] = f64::NAN;
    honest(&record_of(&heating, 20.0), &known);
}

/// The torque balance of a record without a voltage, before and after it is widened by the forms that it may lack.
fn balances_of(truth: &Model) -> [Vec<ParameterEstimate>; 2] {
    let mut scenario = scenario_of(truth, 4.0);
    scenario.input = Input::Current;
    let fitted = |mut model: Model| {
        model.motor.set(MotorKey::TorqueConstant, BRUSHED[2]);
        weak_form::fit(&model, &scenario).into_iter().flat_map(|own| own.parameters).collect()
    };
    let before: Vec<ParameterEstimate> = fitted(unknown());
    let mut after = before.clone();
    widen_by_forms_of_torque(&mut after, 500, |form| {
        Some(fitted(unknown().with_effect(form).ok()?))
    });
    [before, after]
}

#[test]
fn a_torque_balance_is_widened_where_it_lacks_a_form() {
    let viscous = with(&brushed(), "viscous_friction", &[1.5e-5]);
    let [before, after] = balances_of(&viscous).map(|found| of(&found, KEYS[4].key()).clone());
    assert!(!covers(&before, BRUSHED[4], 3.0), "{before:?}");
    assert_eq!(after.verdict, Verdict::Searching, "{after:?}");
    assert!(covers(&after, BRUSHED[4], 1.5), "{after:?}");
    assert_says(&after, &["viscous_friction, if present"]);
    let found = balances_of(&brushed());
    judged(&found[1], KEYS[4].key(), Verdict::Settled);
    for place in [3, 4] {
        let [before, after] = [0, 1].map(|own| of(&found[own], KEYS[place].key()));
        assert_eq!(before.verdict, after.verdict, "{after:?}");
        assert!(covers(after, BRUSHED[place], 3.0), "{after:?}");
        assert!(after.std.unwrap() < 1.3 * before.std.unwrap(), "{after:?}");
    }
}

#[test]
fn an_inertia_by_a_sampled_current_is_as_uncertain_as_the_samples() {
    let step_s = 0.005;
    let model = brushed();
    let motor = &model.motor;
    let value = |key| motor.get(key).unwrap();
    let (l, r) = (value(MotorKey::Inductance), value(MotorKey::Resistance));
    let (ke, kt) = (value(MotorKey::BackEmf), motor.torque_constant().unwrap());
    // A ramp of voltage in steps at the samples, followed from the begin: the mean of the current and its samples, once settled.
    let (mut current_a, mut speed, mut voltage_v) = (0.0, 0.0, 0.0);
    let (mut excess_a, mut rate) = (0.0, 0.0);
    let (steps, inertia) = (2000, value(MotorKey::Inertia));
    for _ in 0..400 {
        voltage_v += 0.01;
        let (sample_a, before) = (current_a, speed);
        let mut mean_a = 0.0;
        for _ in 0..steps {
            let dt = step_s / f64::from(steps);
            mean_a += current_a / f64::from(steps);
            current_a += dt * (voltage_v - r * current_a - ke * speed) / l;
            speed += dt * kt * current_a / inertia;
        }
        (excess_a, rate) = (mean_a - sample_a, (speed - before) / step_s);
    }
    let error = kt * excess_a / rate;
    let mut scenario = scenario_of(&model, 4.0);
    scenario.sample_time_s = (0..800).map(|k| f64::from(k) * step_s).collect();
    let found = |input: Channel, motor: &Motor, scenario: &mut Scenario| {
        scenario.input_channel = input;
        let own = ParameterEstimate::found(MotorKey::Inertia.key(), "kg.m2", inertia, 0.0, None);
        let mut found = vec![own];
        widen_by_sampled_current(&mut found, motor, scenario);
        found.remove(0).std.unwrap()
    };
    let wide = found(Channel::Current, motor, &mut scenario);
    assert!((0.9..1.5).contains(&(wide / error)), "{wide} {error}");
    assert!(found(Channel::VoltageCmd, motor, &mut scenario) < 1e-12 * inertia);
    assert!(found(Channel::Current, &Motor::new("no armature"), &mut scenario) < 1e-12 * inertia);
}

use super::*;
use crate::plant::{ActiveEffect, Input, Model, Motor, ParameterRole, Plant, Scenario, State};
use crate::sample::Channel;

fn defined(text: &str) -> Defined {
    define("custom", &text.parse::<toml::Table>().unwrap())
}

fn text(equation: &str, expression: &str, parameters: &str) -> String {
    format!("equation = \"{equation}\"\nexpression = \"{expression}\"\nparameters = {parameters}")
}

fn torque(expression: &str, parameters: &str) -> &'static dyn Effect {
    defined(&text("torque", expression, parameters)).unwrap().0
}

/// Sums of an effect whose parameters have these values by their keys, at a speed and a current.
fn sums(effect: &dyn Effect, values: &[(&str, f64)], speed_rad_s: f64, current_a: f64) -> Sums {
    let value = |spec: &ParameterSpec| values.iter().find(|own| own.0 == spec.key).unwrap().1;
    let values: Vec<f64> = effect.parameters().iter().map(value).collect();
    let at = Instant { current_a, speed_rad_s, ..Instant::default() };
    effect.terms(&values).sums(&at, &[])
}

#[test]
fn linear_parameters_are_coefficients_and_come_first() {
    use ParameterRole::{Coefficient, Shape};
    for (expression, parameters, roles) in [
        ("z*exp(-(w/b)^2)*sgn(w)", "{ b = 9.0, z = {} }", [("z", Coefficient), ("b", Shape)]),
        // Either could be the coefficient of a product; both at once could not.
        ("a*(w + b*w^2)", "{ a = {}, b = 0.01 }", [("a", Coefficient), ("b", Shape)]),
        ("(1 + a*w)*z", "{ a = 0.01, z = {} }", [("z", Coefficient), ("a", Shape)]),
    ] {
        let specs = torque(expression, parameters).parameters();
        assert!(specs.iter().map(|spec| (spec.key, spec.role)).eq(roles), "{expression}");
        let guess = specs[1].guess();
        assert!(specs[1].logarithmic && parameters.contains(&format!("{guess:?}")));
    }
}

#[test]
fn the_factor_of_the_sign_of_the_speed_is_friction() {
    let effect = torque("a*w + b*sgn(w)*(1 + c*abs(i))", "{ a = {}, b = {}, c = 0.5 }");
    let found = sums(effect, &[("a", 0.01), ("b", 0.2), ("c", 0.5)], -3.0, -2.0);
    assert!((found.torque_n_m + 0.03).abs() < 1e-12, "{found:?}");
    assert!((found.friction_n_m - 0.4).abs() < 1e-12, "{found:?}");
    // In the voltage balance it is a voltage.
    let (drop, _) = defined(&text("voltage", "a*sgn(w)", "[\"a\"]")).unwrap();
    let found = sums(drop, &[("a", 0.5)], -3.0, -2.0);
    assert!((found.voltage_v + 0.5).abs() < 1e-12 && found.friction_n_m.abs() < 1e-300);
    // The part that falls below zero is a torque: both together as a simulation adds them up.
    let effect = torque("(b + a*w)*sgn(w)", "{ a = {}, b = {} }");
    for (speed_rad_s, expected) in [(30.0, 0.7), (3.0, 0.16), (-3.0, -0.04), (-30.0, 0.5)] {
        let found = sums(effect, &[("a", 0.02), ("b", 0.1)], speed_rad_s, 0.0);
        let total = found.torque_n_m + speed_rad_s.signum() * found.friction_n_m.max(0.0);
        assert!((total - expected).abs() < 1e-12, "{speed_rad_s}: {total}");
        assert!((found.friction_n_m - 0.1).abs() < 1e-12, "{found:?}");
    }
    let nested = format!("a*{}i{}", "sgn(".repeat(60), ")".repeat(60));
    let found = sums(torque(&nested, "[\"a\"]"), &[("a", 0.3)], 0.0, -2.0);
    assert!((found.torque_n_m + 0.3).abs() < 1e-12);
}

#[test]
fn a_custom_coulomb_friction_holds_the_shaft_as_the_baseline() {
    // 0.3 N.m holds against 0.8 A times 0.3538, and not against 4 A.
    let events = vec![(0.0, 0.8 * 1.1), (1.0, 12.0), (2.0, 0.5)];
    let times = (0..3000).map(|k| f64::from(k) * 0.001).collect();
    let scenario = Scenario::planned("r", Input::Voltage, Channel::Voltage, events, times);
    let run = |level: f64, own: f64| {
        let motor = Motor::zk_22fc().with(crate::plant::MotorKey::LoadTorque, level);
        let mut model = Model::baseline(motor);
        let friction = torque("level*sgn(w)", "[\"level\"]");
        model.effects.push(ActiveEffect::with(friction, &[own]));
        Plant::new(&model, Input::Voltage).unwrap().simulate(&scenario, State::default())
    };
    let (baseline, own) = (run(0.3, 0.0), run(0.0, 0.3));
    for (a, b) in baseline.speed_rad_s.iter().zip(&own.speed_rad_s) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
    assert!(own.speed_rad_s[..1000].iter().all(|speed| speed.abs() < 1e-12));
    assert!(own.speed_rad_s[1900] > 10.0);
}

#[test]
fn a_definition_is_kept_once_whatever_its_values() {
    let drag = |equation, parameters| defined(&text(equation, "a*w", parameters)).unwrap();
    let (one, _) = drag("torque", "{ a = 1 }");
    let (same, values) = drag("torque", "{ a = 2.5 }");
    assert!(std::ptr::addr_eq(one, same));
    assert_eq!(values, [Some(2.5)]);
    let (other, _) = drag("voltage", "[\"a\"]");
    assert!(!std::ptr::addr_eq(one, other));
}

#[test]
fn wrong_definitions_are_named() {
    for (from, to, key, part) in [
        ("a*w", "a*q", "expression", "unknown name `q`"),
        ("a*w", "w", "parameters", "is not in the expression"),
        ("a*w", "exp(a*w)", "expression", "linear in none"),
        ("a*w", "0.1 + a*w", "expression", "without a parameter"),
        ("a = 1.0", "w = 1.0", "w", "meaning already"),
        ("a = 1.0", "a = true", "a", "expected a number"),
        ("a = 1.0", "a = nan", "a", "not allowed"),
        ("a = 1.0", "a = { size = 2.0 }", "a", "unknown key"),
        ("a = 1.0", "a = { unit = 2.0 }", "a", "unit of `a` is not a text"),
        ("a = 1.0", "a = { value = 3.0, max = 2.0 }", "a", "outside"),
        ("a = 1.0", "a = { min = 3.0, max = 2.0 }", "a", "min of `a` is 3"),
        ("{ a = 1.0 }", "[\"a\", \"a\"]", "parameters", "twice"),
        ("{ a = 1.0 }", "7", "parameters", "a table or a list"),
        ("{ a = 1.0 }", "{ \"1a\" = 1.0 }", "1a", "not a name"),
        ("torque", "power", "equation", "power"),
        ("equation", "equatoin", "equatoin", "unknown key"),
    ] {
        let wrong = text("torque", "a*w", "{ a = 1.0 }").replace(from, to);
        let error = defined(&wrong).err().unwrap();
        assert_eq!(error.key, key, "{error}");
        assert!(error.message.contains(part), "{error}");
        assert!(!error.help.is_empty());
    }
    for (parameters, part) in
        [("[\"a\", \"b\"]", "needs a guess"), ("{ a = {}, b = 0 }", "no size")]
    {
        let error = defined(&text("torque", "a*sin(b*t)", parameters)).err().unwrap();
        assert!(error.key == "b" && error.message.contains(part), "{error}");
    }
}

use super::*;
use crate::plant::{ActiveEffect, Input, Model, Motor, ParameterRole, Plant, Scenario, State};
use crate::sample::Channel;

fn defined(text: &str) -> Result<(&'static dyn Effect, Vec<Option<f64>>), DefinitionError> {
    define("custom", &text.parse::<toml::Table>().unwrap())
}

fn torque(expression: &str, parameters: &str) -> &'static dyn Effect {
    defined(&format!(
        "equation = \"torque\"\nexpression = \"{expression}\"\nparameters = {parameters}"
    ))
    .unwrap()
    .0
}

#[test]
fn a_parameter_that_enters_linearly_is_a_coefficient_and_comes_first() {
    let effect = torque("z*exp(-(w/b)^2)*sgn(w)", "{ b = 9.0, z = {} }");
    let [size, shape] = effect.parameters() else {
        panic!("two parameters");
    };
    assert_eq!((size.key, size.role), ("z", ParameterRole::Coefficient));
    assert_eq!((shape.key, shape.role), ("b", ParameterRole::Shape));
    assert!((shape.guess() - 9.0).abs() < 1e-12 && shape.logarithmic);
    // Either could be the coefficient of a product; both at once could not.
    let product = torque("a*(w + b*w^2)", "{ a = {}, b = 0.01 }");
    let roles: Vec<ParameterRole> = product.parameters().iter().map(|spec| spec.role).collect();
    assert_eq!(roles, [ParameterRole::Coefficient, ParameterRole::Shape]);
}

#[test]
fn what_stands_with_the_sign_of_the_speed_is_friction() {
    let effect = torque(
        "a*w + b*sgn(w)*(1 + c*abs(i))",
        "{ a = {}, b = {}, c = 0.5 }",
    );
    let values: Vec<f64> = effect
        .parameters()
        .iter()
        .map(|spec| match spec.key {
            "a" => 0.01,
            "b" => 0.2,
            _ => 0.5,
        })
        .collect();
    let at = Instant {
        speed_rad_s: -3.0,
        current_a: -2.0,
        ..Instant::default()
    };
    let sums = effect.terms(&values).sums(&at, &[]);
    assert!((sums.torque_n_m + 0.03).abs() < 1e-12, "{sums:?}");
    assert!((sums.friction_n_m - 0.4).abs() < 1e-12, "{sums:?}");
    // In the voltage balance it is a voltage.
    let drop = "equation = \"voltage\"\nexpression = \"a*sgn(w)\"\nparameters = [\"a\"]";
    let sums = defined(drop).unwrap().0.terms(&[0.5]).sums(&at, &[]);
    assert!((sums.voltage_v + 0.5).abs() < 1e-12 && sums.friction_n_m.abs() < 1e-300);
}

#[test]
fn what_falls_below_zero_beside_the_sign_of_the_speed_still_pushes() {
    let effect = torque("(b + a*w)*sgn(w)", "{ a = {}, b = {} }");
    let values: Vec<f64> = effect
        .parameters()
        .iter()
        .map(|spec| if spec.key == "a" { 0.02 } else { 0.1 })
        .collect();
    for (speed_rad_s, expected) in [(30.0, 0.7), (3.0, 0.16), (-3.0, -0.04), (-30.0, 0.5)] {
        let at = Instant {
            speed_rad_s,
            ..Instant::default()
        };
        let sums = effect.terms(&values).sums(&at, &[]);
        // As a simulation adds it up, with nothing but this friction.
        let total = sums.torque_n_m + speed_rad_s.signum() * sums.friction_n_m.max(0.0);
        assert!((total - expected).abs() < 1e-12, "{speed_rad_s}: {total}");
        assert!((sums.friction_n_m - 0.1).abs() < 1e-12, "{sums:?}");
    }
}

#[test]
fn a_parameter_that_leaves_a_part_at_zero_gives_no_size() {
    let effect = torque("(1 + a*w)*z", "{ a = 0.01, z = {} }");
    let [size, shape] = [0, 1].map(|n| (effect.parameters()[n].key, effect.parameters()[n].role));
    assert_eq!(size, ("z", ParameterRole::Coefficient));
    assert_eq!(shape, ("a", ParameterRole::Shape));
    let text = "equation = \"torque\"\nexpression = \"0.1 + a*w\"\nparameters = [\"a\"]";
    let error = defined(text).err().unwrap();
    assert!(error.message.contains("stands without one"), "{error}");
}

#[test]
fn signs_within_signs_are_read_at_once() {
    let nested = format!("a*{}i{}", "sgn(".repeat(60), ")".repeat(60));
    let effect = torque(&nested, "[\"a\"]");
    let at = Instant {
        current_a: -2.0,
        ..Instant::default()
    };
    assert!((effect.terms(&[0.3]).sums(&at, &[]).torque_n_m + 0.3).abs() < 1e-12);
}

#[test]
fn its_own_coulomb_friction_holds_the_shaft_as_the_baseline_does() {
    // 0.3 N.m holds against 0.8 A times 0.3538, and not against 4 A.
    let events = vec![(0.0, 0.8 * 1.1), (1.0, 12.0), (2.0, 0.5)];
    let times = (0..3000).map(|k| f64::from(k) * 0.001).collect();
    let scenario = Scenario::planned("r", Input::Voltage, Channel::Voltage, events, times);
    let run = |level: f64, own: f64| {
        let motor = Motor::zk_22fc().with(crate::plant::MotorKey::LoadTorque, level);
        let mut model = Model::baseline(motor);
        let friction = torque("level*sgn(w)", "[\"level\"]");
        model.effects.push(ActiveEffect::with(friction, &[own]));
        let mut plant = Plant::new(&model, Input::Voltage).unwrap();
        plant.simulate(&scenario, State::default())
    };
    let (baseline, own) = (run(0.3, 0.0), run(0.0, 0.3));
    for (a, b) in baseline.speed_rad_s.iter().zip(&own.speed_rad_s) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
    let mut at_rest = own.speed_rad_s[..1000].iter();
    assert!(at_rest.all(|speed| speed.abs() < 1e-12));
    assert!(own.speed_rad_s[1900] > 10.0);
}

#[test]
fn a_definition_is_kept_once_whatever_its_values() {
    let drag = |equation: &str, parameters: &str| {
        let text = "expression = \"a*w\"";
        let text = format!("equation = \"{equation}\"\n{text}\nparameters = {parameters}");
        defined(&text).unwrap()
    };
    let (one, _) = drag("torque", "{ a = 1 }");
    let (same, values) = drag("torque", "{ a = 2.5 }");
    assert!(std::ptr::addr_eq(one, same));
    assert_eq!(values, [Some(2.5)]);
    let (other, _) = drag("voltage", "[\"a\"]");
    assert!(!std::ptr::addr_eq(one, other));
}

#[test]
fn wrong_definitions_are_named() {
    let good = "equation = \"torque\"\nexpression = \"a*w\"\nparameters = { a = 1.0 }";
    for (from, to, key, part) in [
        ("a*w", "a*q", "expression", "unknown name `q`"),
        ("a*w", "w", "parameters", "does not stand in"),
        ("a*w", "exp(a*w)", "expression", "linear in none"),
        ("a = 1.0", "w = 1.0", "w", "meaning already"),
        ("a = 1.0", "a = true", "a", "expected a number"),
        ("a = 1.0", "a = nan", "a", "not allowed"),
        ("a = 1.0", "a = { size = 2.0 }", "a", "unknown key"),
        ("a = 1.0", "a = { value = 3.0, max = 2.0 }", "a", "outside"),
        ("{ a = 1.0 }", "[\"a\", \"a\"]", "parameters", "twice"),
        ("{ a = 1.0 }", "7", "parameters", "a table or a list"),
        ("{ a = 1.0 }", "{ \"1a\" = 1.0 }", "1a", "not a name"),
        ("torque", "power", "equation", "power"),
        ("equation", "equatoin", "equatoin", "unknown key"),
    ] {
        let error = defined(&good.replace(from, to)).err().unwrap();
        assert_eq!(error.key, key, "{error}");
        assert!(error.message.contains(part), "{error}");
        assert!(!error.help.is_empty());
    }
    let two = "equation = \"torque\"\nexpression = \"a*sin(b*t)\"\nparameters = [\"a\", \"b\"]";
    let error = defined(two).err().unwrap();
    let is_named = error.key == "b" && error.message.contains("needs a guess");
    assert!(is_named, "{error}");
}

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::kit::nameplate;
use drivebench_model::plant::testing::record;
use drivebench_model::plant::{ActiveEffect, Input, Motor, MotorKey, effect};

/// Steps over the whole speed range with a binary dither on top, after a standstill.
fn rich(seed: u64, until_s: f64) -> Vec<(f64, f64)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut events = vec![(0.0, 0.0)];
    let (mut at_s, mut hold_s, mut level) = (0.3, 0.3, 0.0);
    while at_s < until_s {
        if at_s >= hold_s {
            level = rng.random_range(-90.0..90.0);
            hold_s += rng.random_range(0.3..1.2);
        }
        events.push((at_s, level + if rng.random_bool(0.5) { 5.0 } else { -5.0 }));
        at_s += 0.001 * f64::from(rng.random_range(20..50_u16));
    }
    events
}

/// A run of the model of the nameplate with a term of its own in an equation, `a` of this size.
fn run(term: (&str, &str, f64), seed: u64, period_s: f64, until_s: f64) -> Scenario {
    let (equation, expression, size) = term;
    let settings =
        format!("equation = \"{equation}\"\nparameters = [\"a\"]\nexpression = \"{expression}\"");
    let (effect, _) = effect::define("custom", &settings.parse().unwrap()).unwrap();
    let mut truth = nameplate();
    truth.effects.push(ActiveEffect { effect, values: vec![Some(size)] });
    record(&truth, rich(seed, until_s), period_s, until_s, seed)
}

fn maps(scenario: &Scenario) -> Vec<AxisMap> {
    let noise = NoiseFloor::from_standstill(scenario).unwrap();
    axis_map(&nameplate(), scenario, &noise).unwrap()
}

/// The map with the largest share: of this axis and equation, and above this share.
fn leading<'a>(
    found: &'a [AxisMap],
    (equation, axis, least): (&str, &str, f64),
    case: &str,
) -> &'a AxisMap {
    let first = &found[0];
    assert_eq!((first.equation, first.axis), (equation, axis), "{case}: {found:#?}");
    assert!(first.r2 > least, "{case}: {first:?}");
    first
}

#[test]
fn the_error_of_a_true_model_depends_on_no_axis() {
    let mut all = Vec::new();
    for (seeds, period_s, until_s) in [(0..5, 0.001, 12.0), (0..2, 0.01, 10.0)] {
        for seed in seeds {
            let events = rich(seed, until_s);
            let found = maps(&record(&nameplate(), events, period_s, until_s, seed));
            assert!(found.len() >= 8);
            for map in &found {
                // Some 400 windows that overlap: by chance up to three times the spread of 0.015.
                assert!(map.r2 < 0.06, "{seed} {period_s}: {map:?}");
                assert!(!map.is_followed() && map.finding != AxisFinding::Line, "{map:?}");
            }
            all.extend(found.iter().map(|map| map.r2));
        }
    }
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    assert!(mean < 0.01, "{mean}");
}

#[test]
fn a_bump_over_the_speed_is_a_curve_with_its_position_and_height() {
    let found = maps(&run(("torque", "a*exp(-((w-118)/15)^2)", 0.18), 7, 0.001, 12.0));
    let first = leading(&found, ("torque", "speed_rad_s", 0.85), "a bump");
    let peak = first.peak().unwrap();
    assert!((first.knots[peak] - 118.0).abs() < 8.0, "{first:?}");
    assert!((first.values[peak] - 0.18).abs() < 0.04, "{first:?}");
    assert!(first.std[peak] < 0.02 && first.error_over_noise.unwrap() > 2.0);
    let (place, height) = first.largest().unwrap();
    assert!(place.contains(&first.knots[peak]), "{place:?}");
    assert!((place.end() - place.start()).abs() < 30.0, "{place:?}");
    assert!((height - first.values[peak]).abs() < 1e-12);
}

#[test]
fn each_error_depends_on_its_own_axis() {
    for (equation, expression, size, period_s, axis, least) in [
        ("torque", "a*abs(w)*w", 2e-6, 0.001, "speed_rad_s", 0.84),
        ("torque", "a*sin(theta)", 0.12, 0.001, "angle_rad", 0.93),
        ("voltage", "a*tanh(i/0.05)", 1.0, 0.001, "current_a", 0.9),
        ("torque", "a*sin(2*pi*4.625*t)", 0.1, 0.001, "frequency_hz", 0.91),
        ("torque", "a*(1+sgn(t-6))/2", 0.1, 0.001, "time_s", 0.73),
        ("torque", "a*abs(w)*w", 2e-6, 0.01, "speed_rad_s", 0.8),
        ("torque", "a*sin(theta)", 0.12, 0.01, "angle_rad", 0.7),
        ("voltage", "a*tanh(i/0.05)", 1.0, 0.01, "current_a", 0.7),
    ] {
        let found = maps(&run((equation, expression, size), 7, period_s, 12.0));
        let case = format!("{expression} at {period_s} s");
        let first = leading(&found, (equation, axis, least), &case);
        if axis == "frequency_hz" {
            assert!((first.knots[0] - 4.625).abs() < 0.01, "{first:?}");
            assert!((first.values[0] / 0.1 - 1.0).abs() < 0.05, "{first:?}");
        }
    }
}

#[test]
fn a_run_that_is_driven_by_torque_has_a_torque_balance_only() {
    let mut scenario = run(("torque", "a*abs(w)*w", 2e-6), 7, 0.001, 8.0);
    // A drive holds its torque from one stamp to the next: the mean of both.
    let torque = scenario.current_a.windows(2);
    let torque: Vec<f64> = torque.map(|ends| 0.3538 * 0.5 * (ends[0] + ends[1])).collect();
    scenario.events = scenario.sample_time_s.iter().copied().zip(torque).collect();
    scenario.input = Input::Torque;
    let motor =
        Motor::new("axis").with(MotorKey::Inertia, 0.0045).with(MotorKey::LoadTorque, 0.455);
    let noise = NoiseFloor::from_spread(&scenario);
    let found = axis_map(&Model::baseline(motor), &scenario, &noise).unwrap();
    assert!(found.iter().all(|map| map.equation == "torque"));
    leading(&found, ("torque", "speed_rad_s", 0.6), "driven by torque");
    assert!(found.iter().all(|map| map.axis != "current_a" && map.axis != "voltage_v"));
}

#[test]
fn times_count_from_the_begin_of_a_run() {
    let run = run(("torque", "a*exp(-((t-8)/2)^2)", 0.18), 7, 0.001, 12.0);
    let mut later = run.clone();
    for time_s in &mut later.sample_time_s {
        *time_s += 32.0;
    }
    for (time_s, _) in &mut later.events {
        *time_s += 32.0;
    }
    let [first, again] = [&run, &later].map(|run| {
        let mut maps = maps(run).into_iter();
        let own = maps.find(|map| (map.equation, map.axis) == ("torque", "time_s"));
        own.expect("a torque over time")
    });
    let (place, _) = first.largest().unwrap();
    assert!((6.0..10.0).contains(place.start()), "{place:?}");
    assert!(first.knots.iter().zip(&again.knots).all(|(a, b)| (a - b).abs() < 1e-9));
}

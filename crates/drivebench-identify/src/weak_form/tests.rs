use super::*;
use crate::testing::{self, *};
use drivebench_model::plant::Motor;
use drivebench_model::sample::Verdict;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn value(balances: &[Balanced], key: &str) -> f64 {
    balances.iter().flat_map(|b| &b.parameters).find(|p| p.key == key).unwrap().value.unwrap()
}

#[test]
fn a_voltage_run_gives_every_parameter() {
    let true_values = testing::paper_with("quadratic_load", &[2e-6]);
    let truth = paper().with_effect("quadratic_load").unwrap();
    let events =
        held([0.0, 0.3, 0.9, 1.5, 2.3, 3.0, 4.0], [0.0, 50.0, 80.0, -60.0, 30.0, -90.0, 40.0]);
    let run = testing::simulated(&true_values, Input::Voltage, events, every(0.001, 5.0));
    let found = fit(&truth, &run);
    for (key, expected) in [
        ("resistance_ohm", 1.1),
        ("inductance_h", 0.0099),
        ("back_emf_v_s_per_rad", 0.3538),
        ("inertia_kg_m2", 0.0045),
        ("load_torque_n_m", 0.455),
        ("quadratic_load.quadratic_n_m_s2_per_rad2", 2e-6),
    ] {
        assert_near(value(&found, key), expected, 0.01);
    }
}

#[test]
fn a_linear_axis_under_force_gives_mass_and_friction() {
    let motor = Motor::new("axis").with(MotorKey::Inertia, 95.0).with(MotorKey::LoadTorque, 20.0);
    let model = Model::baseline(motor).with_effect("viscous_friction").unwrap();
    let model = model.with_effect("constant_load").unwrap();
    let mut truth = model.clone();
    truth.effects[0].values = vec![Some(200.0)];
    truth.effects[1].values = vec![Some(-3.0)];
    let events: Vec<(f64, f64)> = (0..600)
        .map(|k| {
            let t = f64::from(k) * 0.02;
            (t, 60.0 * (1.1 * t).sin() + 25.0 * (4.3 * t).sin())
        })
        .collect();
    let mut run = testing::simulated(&truth, Input::Torque, events, every(0.001, 12.0));
    run.current_a.fill(f64::NAN);
    let found = fit(&model, &run);
    for (key, expected) in [
        ("inertia_kg_m2", 95.0),
        ("load_torque_n_m", 20.0),
        ("viscous_friction.viscous_n_m_s_per_rad", 200.0),
        ("constant_load.constant_n_m", -3.0),
    ] {
        assert_near(value(&found, key), expected, 0.02);
    }
    assert_eq!(found.len(), 1);
}

/// A run of a motor that differs from seed to seed, with bench noise; truth first.
fn noisy(seed: u64, period_s: f64) -> (Model, Scenario) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut truth = paper();
    for slot in truth.slots() {
        let value = truth.get(&slot).unwrap() * rng.random_range(0.85..1.15);
        truth.set(&slot, value);
    }
    let mut events = vec![(0.0, 0.0)];
    let mut at_s = 0.5;
    while at_s < 12.0 {
        events.push((at_s, rng.random_range(-80.0..80.0)));
        at_s += rng.random_range(0.05..0.4);
    }
    let mut run = testing::simulated(&truth, Input::Voltage, events, every(period_s, 12.0));
    run.current_a = testing::noisy(&run.current_a, CURRENT_NOISE_A, &mut rng);
    run.speed_rad_s = testing::noisy(&run.speed_rad_s, SPEED_NOISE_RAD_S, &mut rng);
    (truth, run)
}

#[test]
fn the_interval_covers_and_coarse_sampling_widens_it() {
    let unknown = testing::unknown();
    for period_s in [0.001, 0.01] {
        let (mut inside, mut all, mut wrong) = (0, 0, Vec::new());
        for seed in 0..40 {
            let (truth, run) = noisy(seed, period_s);
            for p in fit(&unknown, &run).iter().flat_map(|b| &b.parameters) {
                let expected = truth.motor.get(MotorKey::from_key(&p.key).unwrap()).unwrap();
                let Some(value) = p.value.filter(|_| p.std.is_some()) else { continue };
                all += 1;
                inside += i32::from(covers(p, expected, 1.96));
                if p.verdict == Verdict::Settled && (value / expected - 1.0).abs() > 0.04 {
                    wrong.push(format!("{seed} {} {value} {expected}", p.key));
                }
            }
        }
        let share = f64::from(inside) / f64::from(all);
        assert!(share >= 0.88, "{period_s}: {share}");
        assert!(all >= 180 && wrong.is_empty(), "{all} {wrong:?}");
    }
}

#[test]
fn noise_at_rest_and_at_constant_speed_settles_nothing() {
    let events = vec![(0.0, 0.0), (0.5, 40.0)];
    let mut run = testing::record(&paper(), events, 0.01, 12.0, 3);
    // No transient is left.
    for (k, time_s) in run.sample_time_s.iter().enumerate() {
        if (0.5..3.0).contains(time_s) {
            (run.current_a[k], run.speed_rad_s[k]) = (f64::NAN, f64::NAN);
        }
    }
    for p in fit(&testing::unknown(), &run).iter().flat_map(|b| &b.parameters) {
        if ["inductance_h", "inertia_kg_m2"].contains(&p.key.as_str()) {
            assert_eq!((p.value, p.verdict), (None, Verdict::NotObservable), "{p:?}");
        }
    }
}

#[test]
fn the_residual_of_a_true_model_is_at_the_noise_floor() {
    let (_, run) = noisy(5, 0.001);
    for balance in fit(&paper(), &run) {
        let squares: f64 = balance.residual.iter().map(|left| left.powi(2)).sum();
        let ratio = (squares / balance.residual.len() as f64).sqrt() / balance.noise_floor.unwrap();
        // A step between two samples leaves a corner in the current that a quadrature does not resolve.
        assert!((0.8..1.5).contains(&ratio), "{:?} {ratio}", balance.equation);
    }
}

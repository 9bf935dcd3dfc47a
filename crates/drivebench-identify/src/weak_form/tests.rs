use super::*;
use crate::testing::{self, *};
use drivebench_model::plant::Motor;
use drivebench_model::sample::Verdict;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn value(balances: &[Balanced], key: &str) -> f64 {
    let mut all = balances.iter().flat_map(|b| &b.parameters);
    all.find(|p| p.key == key).unwrap().value.unwrap()
}

#[test]
fn a_voltage_run_gives_every_parameter() {
    let true_values = testing::paper_with("quadratic_load", &[2e-6]);
    let truth = paper().with_effect("quadratic_load").unwrap();
    let events = held(
        [0.0, 0.3, 0.9, 1.5, 2.3, 3.0, 4.0],
        [0.0, 50.0, 80.0, -60.0, 30.0, -90.0, 40.0],
    );
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
    // The character of a linear axis: 95 kg, tens of newtons, tenths of a metre per second.
    let motor = Motor::new("axis")
        .with(MotorKey::Inertia, 95.0)
        .with(MotorKey::LoadTorque, 20.0);
    let model = Model::baseline(motor)
        .with_effect("viscous_friction")
        .unwrap()
        .with_effect("constant_load")
        .unwrap();
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

#[test]
fn a_shaft_at_rest_gives_no_inertia() {
    let times = every(0.001, 2.0);
    let mut run = testing::simulated(&paper(), Input::Voltage, vec![(0.0, 0.5)], times);
    run.current_a = (0..2000)
        .map(|k| 0.45 * (1.0 - (-f64::from(k) / 9.0).exp()))
        .collect();
    run.speed_rad_s = vec![0.0; 2000];
    let found = fit(&paper(), &run);
    let inertia = of(&found[1].parameters, "inertia_kg_m2");
    let told = (inertia.value, inertia.verdict);
    assert_eq!(told, (None, Verdict::NotObservable));
}

/// A run of a motor that differs from seed to seed, with bench noise; truth first.
fn noisy(seed: u64, period_s: f64, constant: bool) -> (Model, Scenario) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut truth = paper();
    for slot in truth.slots() {
        let value = truth.get(&slot).unwrap() * rng.random_range(0.85..1.15);
        truth.set(&slot, value);
    }
    let mut events = vec![(0.0, 0.0)];
    let mut at_s = 0.5;
    while at_s < 12.0 {
        let volts = if constant {
            40.0
        } else {
            rng.random_range(-80.0..80.0)
        };
        events.push((at_s, volts));
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
    for (period_s, covered_at_least) in [(0.001, 0.88), (0.01, 0.88)] {
        let (mut inside, mut all, mut wrong) = (0, 0, Vec::new());
        for seed in 0..40 {
            let (truth, run) = noisy(seed, period_s, false);
            let found = fit(&unknown, &run);
            for p in found.iter().flat_map(|b| &b.parameters) {
                let mut slots = truth.slots().into_iter();
                let slot = slots.find(|s| s.key() == p.key).unwrap();
                let expected = truth.get(&slot).unwrap();
                let Some(value) = p.value.filter(|_| p.std.is_some()) else {
                    continue;
                };
                all += 1;
                inside += i32::from(covers(p, expected, 1.96));
                if p.verdict == Verdict::Settled && (value / expected - 1.0).abs() > 0.04 {
                    wrong.push(format!("{seed} {} {value} {expected}", p.key));
                }
            }
        }
        let share = f64::from(inside) / f64::from(all);
        assert!(share >= covered_at_least, "{period_s}: {share}");
        assert!(all >= 180 && wrong.is_empty(), "{all} {wrong:?}");
    }
}

#[test]
fn a_constant_voltage_settles_nothing_electrical_by_its_noise() {
    let (_, mut run) = noisy(3, 0.01, true);
    // Only the standstill and the steady part: no transient is left.
    let steady = |time_s: &f64| *time_s < 0.5 || *time_s > 3.0;
    let keep: Vec<bool> = run.sample_time_s.iter().map(steady).collect();
    for (k, keep) in keep.iter().enumerate() {
        if !keep {
            run.current_a[k] = f64::NAN;
            run.speed_rad_s[k] = f64::NAN;
        }
    }
    let found = fit(&testing::unknown(), &run);
    for p in found.iter().flat_map(|b| &b.parameters) {
        if ["inductance_h", "inertia_kg_m2"].contains(&p.key.as_str()) {
            let told = (p.value, p.verdict);
            assert_eq!(told, (None, Verdict::NotObservable), "{p:?}");
        }
    }
}

#[test]
fn the_residual_of_a_true_model_is_at_the_noise_floor() {
    let (_, run) = noisy(5, 0.001, false);
    let found = fit(&paper(), &run);
    for balance in &found {
        let squares: f64 = balance
            .residual
            .iter()
            .map(|residual| residual.powi(2))
            .sum();
        let ratio = (squares / balance.residual.len() as f64).sqrt() / balance.noise_floor.unwrap();
        // A step between two samples leaves a corner in the current that a quadrature does not resolve.
        assert!(
            (0.8..1.5).contains(&ratio),
            "{:?} {ratio}",
            balance.equation
        );
    }
}

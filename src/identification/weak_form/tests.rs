use super::*;
use crate::numerics::count::whole;
use crate::plant::{Motor, Plant, State};
use crate::sample::Channel;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

fn scenario(input: Input, events: Vec<(f64, f64)>, period_s: f64, until_s: f64) -> Scenario {
    let samples = whole(until_s / period_s);
    Scenario {
        name: "r".into(),
        input,
        input_channel: if input == Input::Voltage {
            Channel::Voltage
        } else {
            Channel::Torque
        },
        events,
        sample_time_s: (0..samples).map(|k| k as f64 * period_s).collect(),
        current_a: vec![f64::NAN; samples],
        speed_rad_s: vec![f64::NAN; samples],
        angle: vec![],
        time_half_width_s: vec![],
        unknown_input: vec![],
        scored: 0..samples,
    }
}

fn value(balances: &[Balanced], key: &str) -> f64 {
    balances
        .iter()
        .flat_map(|b| &b.parameters)
        .find(|p| p.key == key)
        .unwrap()
        .value
        .unwrap()
}

#[test]
fn a_voltage_run_gives_every_parameter() {
    let truth = Model::baseline(Motor::zk_22fc())
        .with_effect("quadratic_load")
        .unwrap();
    let mut true_values = truth.clone();
    true_values.effects[0].values = vec![Some(2e-6)];
    let events = vec![
        (0.0, 0.0),
        (0.3, 50.0),
        (0.9, 80.0),
        (1.5, -60.0),
        (2.3, 30.0),
        (3.0, -90.0),
        (4.0, 40.0),
    ];
    let mut run = scenario(Input::Voltage, events, 0.001, 5.0);
    let out = Plant::new(&true_values, Input::Voltage)
        .unwrap()
        .simulate(&run, State::default());
    (run.current_a, run.speed_rad_s) = (out.current_a, out.speed_rad_s);
    let found = fit(&truth, &run).unwrap();
    for (key, expected) in [
        ("resistance_ohm", 1.1),
        ("inductance_h", 0.0099),
        ("back_emf_v_s_per_rad", 0.3538),
        ("inertia_kg_m2", 0.0045),
        ("load_torque_n_m", 0.455),
        ("quadratic_load.quadratic_n_m_s2_per_rad2", 2e-6),
    ] {
        let ratio = value(&found, key) / expected;
        assert!((ratio - 1.0).abs() < 0.01, "{key} {ratio}");
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
    let mut run = scenario(Input::Torque, events, 0.001, 12.0);
    run.speed_rad_s = Plant::new(&truth, Input::Torque)
        .unwrap()
        .simulate(&run, State::default())
        .speed_rad_s;
    let found = fit(&model, &run).unwrap();
    for (key, expected) in [
        ("inertia_kg_m2", 95.0),
        ("load_torque_n_m", 20.0),
        ("viscous_friction.viscous_n_m_s_per_rad", 200.0),
        ("constant_load.constant_n_m", -3.0),
    ] {
        let ratio = value(&found, key) / expected;
        assert!((ratio - 1.0).abs() < 0.02, "{key} {ratio}");
    }
    assert_eq!(found.len(), 1);
}

#[test]
fn a_shaft_at_rest_gives_no_inertia() {
    let mut run = scenario(Input::Voltage, vec![(0.0, 0.5)], 0.001, 2.0);
    run.current_a = (0..2000)
        .map(|k| 0.45 * (1.0 - (-f64::from(k) / 9.0).exp()))
        .collect();
    run.speed_rad_s = vec![0.0; 2000];
    let found = fit(&Model::baseline(Motor::zk_22fc()), &run).unwrap();
    let inertia = found[1]
        .parameters
        .iter()
        .find(|p| p.key == "inertia_kg_m2")
        .unwrap();
    assert_eq!(
        (inertia.value, inertia.verdict),
        (None, Verdict::NotObservable)
    );
}

/// A run of a motor that differs from seed to seed, with bench noise; truth first.
fn noisy(seed: u64, period_s: f64, constant: bool) -> (Model, Scenario) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut truth = Model::baseline(Motor::zk_22fc());
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
    let mut run = scenario(Input::Voltage, events, period_s, 12.0);
    let out = Plant::new(&truth, Input::Voltage)
        .unwrap()
        .simulate(&run, State::default());
    let mut add = |values: &[f64], sigma: f64| -> Vec<f64> {
        values
            .iter()
            .map(|value| value + sigma * rng.sample::<f64, _>(StandardNormal))
            .collect()
    };
    run.current_a = add(&out.current_a, 0.03);
    run.speed_rad_s = add(&out.speed_rad_s, 0.15);
    (truth, run)
}

#[test]
fn the_interval_covers_and_coarse_sampling_widens_it() {
    let unknown = Model::baseline(Motor::new("?"));
    for (period_s, covered_at_least) in [(0.001, 0.88), (0.01, 0.88)] {
        let (mut inside, mut all, mut wrong) = (0, 0, Vec::new());
        for seed in 0..40 {
            let (truth, run) = noisy(seed, period_s, false);
            let found = fit(&unknown, &run).unwrap();
            for p in found.iter().flat_map(|b| &b.parameters) {
                let slot = truth
                    .slots()
                    .into_iter()
                    .find(|s| s.key() == p.key)
                    .unwrap();
                let expected = truth.get(&slot).unwrap();
                let (Some(value), Some(std)) = (p.value, p.std) else {
                    continue;
                };
                all += 1;
                inside += i32::from((value - expected).abs() <= 1.96 * std);
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
    let found = fit(&Model::baseline(Motor::new("?")), &run).unwrap();
    for p in found.iter().flat_map(|b| &b.parameters) {
        if ["inductance_h", "inertia_kg_m2"].contains(&p.key.as_str()) {
            assert_eq!(
                (p.value, p.verdict),
                (None, Verdict::NotObservable),
                "{p:?}"
            );
        }
    }
}

#[test]
fn the_residual_of_a_true_model_is_at_the_noise_floor() {
    let (_, run) = noisy(5, 0.001, false);
    let found = fit(&Model::baseline(Motor::zk_22fc()), &run).unwrap();
    for balance in &found {
        let squares: f64 = balance.residual.iter().map(|w| w.residual.powi(2)).sum();
        let ratio = (squares / balance.residual.len() as f64).sqrt() / balance.noise_floor.unwrap();
        assert!(
            // A step between two samples leaves a corner in the current that a quadrature does not resolve.
            (0.8..1.5).contains(&ratio),
            "{:?} {ratio}",
            balance.equation
        );
    }
}

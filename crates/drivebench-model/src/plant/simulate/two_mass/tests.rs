use super::super::tests::{self, model, reversals, scenario};
use super::super::{Plant, Trajectory};
use crate::numerics::count::whole;
use crate::plant::{Input, ModelError, MotorKey, Scenario, State};
use crate::signal;

/// For 1.1 s, sampled every millisecond.
fn run(effects: &[(&str, &[f64])]) -> Trajectory {
    tests::simulated(effects, reversals(), 0.001, 1101)
}

/// Frequency, inertia ratio, damping ratio, friction split, gap.
type Values = [f64; 5];

fn coupled([f, r, zeta, split, gap]: Values) -> (&'static str, Vec<f64>) {
    if gap == 0.0 {
        ("elastic_coupling", vec![f, r, zeta, split])
    } else {
        ("backlash", vec![gap, f, r, zeta, split])
    }
}

fn simulated(values: Values, drag: f64) -> Trajectory {
    let (id, values) = coupled(values);
    let effects = [(id, &values[..]), ("viscous_friction", &[drag])];
    run(if drag == 0.0 { &effects[..1] } else { &effects })
}

/// Independent formulation: small fourth-order Runge-Kutta steps, friction regularised over a very narrow band of
/// speed. Current and motor speed every millisecond.
fn reference(values: Values, drag: f64, until_s: f64) -> Vec<(f64, f64)> {
    let (r, l, ke, j, mc) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
    let [f, share, zeta, split, gap] = values;
    // Mapping as in `Coupling`.
    let (j1, j2) = (j * (1.0 - share), j * share);
    let k = (std::f64::consts::TAU * f).powi(2) * j * share * (1.0 - share);
    let d = 2.0 * zeta * (k * j * share * (1.0 - share)).sqrt();
    let per_sample = 500;
    let h = 1e-3 / f64::from(per_sample);
    let events = reversals();
    let mut x = [0.0f64; 4];
    let mut out = vec![(0.0, 0.0)];
    let mut step = 0;
    while out.len() <= whole((until_s / 1e-3).round()) {
        let t = f64::from(step) * h;
        let u = signal::held(&events, t + 1e-12).unwrap();
        let rates = |x: [f64; 4]| {
            let [i, w, w2, twist] = x;
            let z = twist - twist.clamp(-0.5 * gap, 0.5 * gap);
            let shaft = k * z + d * (w - w2);
            [
                (u - r * i - ke * w) / l,
                (ke * i - drag * w - (1.0 - split) * mc * (w / 1e-3).tanh() - shaft) / j1,
                (shaft - split * mc * (w2 / 1e-3).tanh()) / j2,
                w - w2,
            ]
        };
        let along = |k: [f64; 4], s: f64| [0, 1, 2, 3].map(|n| x[n] + s * k[n]);
        let k1 = rates(x);
        let k2 = rates(along(k1, h / 2.0));
        let k3 = rates(along(k2, h / 2.0));
        let k4 = rates(along(k3, h));
        x = [0, 1, 2, 3].map(|n| x[n] + h / 6.0 * (k1[n] + 2.0 * (k2[n] + k3[n]) + k4[n]));
        step += 1;
        if step % per_sample == 0 {
            out.push((x[0], x[1]));
        }
    }
    out
}

#[test]
fn it_agrees_with_tiny_regularised_steps() {
    for (values, drag) in [
        ([24.0, 0.55, 0.02, 0.5, 0.0], 0.0),
        ([48.0, 0.35, 0.1, 0.3, 0.0], 0.0),
        ([13.0, 0.7, 0.03, 0.8, 0.0], 4e-3),
        ([35.0, 0.5, 0.03, 0.4, 0.04], 0.0),
        ([55.0, 0.35, 0.05, 0.5, 0.08], 2e-3),
    ] {
        let out = simulated(values, drag);
        let expected = reference(values, drag, 1.1);
        let mut most = (0.0_f64, 0.0_f64);
        for (sample, (i, w)) in expected.iter().enumerate() {
            most.0 = most.0.max((out.current_a[sample] - i).abs());
            most.1 = most.1.max((out.speed_rad_s[sample] - w).abs());
        }
        let is_near = most.0 < 0.01 && most.1 < 0.02;
        assert!(is_near, "{values:?} {drag}: {most:?}");
    }
}

fn difference(one: &Trajectory, other: &Trajectory) -> f64 {
    let speeds = one.speed_rad_s.iter().zip(&other.speed_rad_s);
    let currents = one.current_a.iter().zip(&other.current_a);
    speeds
        .chain(currents)
        .fold(0.0, |most, (a, b)| f64::max(most, (a - b).abs()))
}

#[track_caller]
fn assert_near(one: &Trajectory, other: &Trajectory, within: f64) {
    let apart = difference(one, other);
    assert!(apart < within, "{apart}");
}

#[test]
fn a_stiff_shaft_and_a_load_without_inertia_are_the_single_mass() {
    let single = run(&[]);
    let stiff = simulated([1500.0, 0.5, 0.3, 0.4, 0.0], 0.0);
    assert_near(&single, &stiff, 0.02);
    let light = simulated([20.0, 1e-6, 0.05, 0.0, 0.0], 0.0);
    assert_near(&single, &light, 1e-3);
    // The comparison can fail.
    let soft = simulated([20.0, 0.5, 0.05, 0.4, 0.0], 0.0);
    assert!(difference(&single, &soft) > 1.0);
}

#[test]
fn backlash_without_a_gap_is_an_elastic_coupling() {
    let without = run(&[("backlash", &[0.0, 30.0, 0.5, 0.03, 0.4])]);
    let elastic = run(&[("elastic_coupling", &[30.0, 0.5, 0.03, 0.4])]);
    assert!(difference(&without, &elastic) < 1e-9);
    let hair = run(&[("backlash", &[1e-6, 30.0, 0.5, 0.03, 0.4])]);
    assert_near(&hair, &elastic, 1e-2);
}

#[test]
fn an_inertia_that_is_another_one_is_so_on_both_sides_of_the_shaft() {
    let (f, r, zeta, split, gap) = (20.0, 0.5, 0.05, 0.4, 0.02);
    for ratio in [0.6_f64, -0.3] {
        // Long ago, and with the same stiffness and damping.
        let root = (1.0 + ratio).sqrt();
        let values = [gap, f, r, zeta, split];
        let changed = run(&[("backlash", &values), ("inertia_change", &[ratio, -1.0])]);
        let mut heavy = model(&[("backlash", &[gap, f / root, r, zeta / root, split])]);
        let inertia = heavy.motor.get(MotorKey::Inertia).unwrap();
        heavy.motor.set(MotorKey::Inertia, (1.0 + ratio) * inertia);
        let mut plant = Plant::new(&heavy, Input::Voltage).unwrap();
        let heavy = plant.simulate(&scenario(reversals(), 0.001, 1101), State::default());
        assert_near(&changed, &heavy, 0.02);
    }
}

#[test]
fn there_is_one_second_inertia() {
    let both: &[(&str, &[f64])] = &[
        ("elastic_coupling", &[24.0, 0.5, 0.02, 0.5]),
        ("backlash", &[0.05, 24.0, 0.5, 0.02, 0.5]),
    ];
    let refused = Plant::new(&model(both), Input::Voltage).err();
    assert_eq!(refused, Some(ModelError::SecondCoupling));
}

/// A motor without friction under a torque pulse, behind it the load.
fn pulsed(effect: &str, values: &[f64], load_torque_n_m: f64, samples: usize) -> (Plant, Scenario) {
    let mut model = model(&[(effect, values)]);
    model.motor.set(MotorKey::LoadTorque, load_torque_n_m);
    let mut torque = scenario(vec![(0.0, 0.2), (0.1, 0.0)], 0.001, samples);
    torque.input = Input::Torque;
    (Plant::new(&model, Input::Torque).unwrap(), torque)
}

#[test]
fn without_friction_the_shaft_only_passes_momentum_on() {
    for (effect, values) in [
        ("elastic_coupling", &[17.0, 0.6, 0.0, 0.5][..]),
        ("backlash", &[0.05, 30.0, 0.6, 0.1, 0.5][..]),
    ] {
        let mut speeds = Vec::new();
        for samples in [150, 200, 333, 400] {
            let (mut plant, torque) = pulsed(effect, values, 0.0, samples);
            let out = plant.simulate(&torque, State::default());
            let motor = out.speed_rad_s[samples - 1];
            let load = plant.two_mass.as_ref().unwrap().load.speed_rad_s;
            let momentum = 0.0045 * (0.4 * motor + 0.6 * load);
            assert!((momentum - 0.2 * 0.1).abs() < 1e-12, "{effect} {momentum}");
            speeds.push(motor);
        }
        // It rings meanwhile.
        assert!((speeds[0] - speeds[1]).abs() > 0.05, "{speeds:?}");
    }
}

#[test]
fn a_held_load_lets_the_motor_ring_on_the_shaft() {
    // 0.2 N.m are below the 0.3 N.m that hold the load; the motor has no friction of its own.
    let (f, r) = (20.0, 0.6);
    let (mut plant, torque) = pulsed("elastic_coupling", &[f, r, 0.0, 1.0], 0.5, 100);
    let out = plant.simulate(&torque, State::default());
    let two_mass = plant.two_mass.as_ref().unwrap();
    assert!(two_mass.load.mode == super::Mode::Stuck && two_mass.load.speed_rad_s == 0.0);
    // J1 w' = T - k twist: w = T / (J1 w1) sin(w1 t) with w1^2 = k / J1 = (2 pi f)^2 r.
    let w1 = std::f64::consts::TAU * f * r.sqrt();
    for (sample, speed) in out.speed_rad_s.iter().enumerate() {
        let expected = 0.2 / (0.0045 * 0.4 * w1) * (w1 * sample as f64 * 1e-3).sin();
        let off = speed - expected;
        assert!(off.abs() < 1e-9, "{sample} {speed} {expected}");
    }
}

#[test]
fn irregular_sampling_changes_nothing() {
    for values in [[28.0, 0.5, 0.03, 0.4, 0.0], [45.0, 0.5, 0.03, 0.4, 0.05]] {
        let regular = simulated(values, 0.0);
        let mut irregular = scenario(reversals(), 0.001, 2202);
        // Between two samples of the regular run one more, at an instant of its own.
        let between = |k: usize| k as f64 * 1e-3 + 1e-3 * (0.1 + 0.8 * (k as f64 * 0.618).fract());
        let times = (0..1101).flat_map(|k| [k as f64 * 1e-3, between(k)]);
        irregular.sample_time_s = times.collect();
        let (id, values) = coupled(values);
        let mut plant = Plant::new(&model(&[(id, &values)]), Input::Voltage).unwrap();
        let out = plant.simulate(&irregular, State::default());
        let same = Trajectory {
            current_a: out.current_a.iter().copied().step_by(2).collect(),
            speed_rad_s: out.speed_rad_s.iter().copied().step_by(2).collect(),
        };
        let most = difference(&regular, &same);
        assert!(most < 1e-6, "{values:?} {most}");
    }
}

#[test]
fn the_result_moves_smoothly_with_the_parameters() {
    // The second difference over a parameter vanishes with the square of its step; events that are not located, or
    // missed for some values, would leave jumps.
    for values in [[24.0, 0.55, 0.02, 0.5, 0.0], [45.0, 0.5, 0.03, 0.4, 0.05]] {
        for parameter in 0..4 {
            for centre in 0..10 {
                let at = |step: f64| {
                    let mut moved = values;
                    moved[parameter] *= 1.0 + 0.02 * f64::from(centre) + 1e-6 * step;
                    simulated(moved, 0.0)
                };
                let (low, mid, high) = (at(-1.0), at(0.0), at(1.0));
                let speeds = low.speed_rad_s.iter().zip(&mid.speed_rad_s);
                let bends = speeds
                    .zip(&high.speed_rad_s)
                    .map(|((a, b), c)| a - 2.0 * b + c);
                let bend = bends.fold(0.0, |most, bend| f64::max(most, bend.abs()));
                assert!(bend < 1e-5, "{values:?} {parameter} {centre}: {bend:e}");
            }
        }
    }
}

#[test]
fn one_step_predictions_of_its_own_motion_are_its_own_motion() {
    let effects: &[(&str, &[f64])] = &[("elastic_coupling", &[24.0, 0.55, 0.02, 0.5])];
    let free = run(effects);
    let mut measured = scenario(reversals(), 0.001, free.speed_rad_s.len());
    measured.current_a.clone_from(&free.current_a);
    measured.speed_rad_s.clone_from(&free.speed_rad_s);
    let mut plant = Plant::new(&model(effects), Input::Voltage).unwrap();
    let ahead = plant.predict_ahead(&measured, State::default(), 1);
    assert_near(&free, &ahead, 1e-6);
    // Noise on the anchors stays of its size: the load does not run away from the motor.
    for (sample, speed) in measured.speed_rad_s.iter_mut().enumerate() {
        *speed += if sample % 2 == 0 { 0.1 } else { -0.1 };
    }
    let noisy = plant.predict_ahead(&measured, State::default(), 1);
    assert_near(&free, &noisy, 0.8);
}

#[test]
fn a_stiff_circuit_with_a_stiff_shaft_stays_finite() {
    let mut model = model(&[("elastic_coupling", &[200.0, 0.9, 1.0, 0.5])]);
    model.motor.set(MotorKey::Inductance, 1e-6);
    let mut plant = Plant::new(&model, Input::Voltage).unwrap();
    let out = plant.simulate(&scenario(reversals(), 0.001, 1100), State::default());
    let sizes = out.speed_rad_s.iter().map(|speed| speed.abs());
    let largest = sizes.fold(0.0, f64::max);
    assert!((20.0..100.0).contains(&largest), "{largest}");
}

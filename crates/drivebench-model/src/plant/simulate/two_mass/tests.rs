use super::super::tests::{differences, model, reversals, scenario, simulate, simulated};
use super::super::{Plant, Trajectory};
use crate::numerics::statistics::largest;
use crate::plant::{Input, ModelError, MotorKey, State};
use crate::signal;

/// For 1.1 s, sampled every millisecond.
fn run(effects: &[(&str, &[f64])]) -> Trajectory {
    simulated(effects, reversals(), 0.001, 1101)
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

fn run_of(values: Values) -> Trajectory {
    let (id, values) = coupled(values);
    run(&[(id, &values)])
}

/// Independent formulation: small fourth-order Runge-Kutta steps, friction regularised over a very narrow band of speed.
/// Current and motor speed every millisecond.
fn reference(values: Values, drag: f64) -> Trajectory {
    let (r, l, ke, j, mc) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
    let [f, share, zeta, split, gap] = values;
    // Mapping as in `Coupling`.
    let (j1, j2) = (j * (1.0 - share), j * share);
    let k = (std::f64::consts::TAU * f).powi(2) * j * share * (1.0 - share);
    let d = 2.0 * zeta * (k * j * share * (1.0 - share)).sqrt();
    let h = 1e-3 / 500.0;
    let events = reversals();
    let mut x = [0.0f64; 4];
    let mut out = Trajectory::default();
    for step in 0..=1100 * 500 {
        if step % 500 == 0 {
            out.current_a.push(x[0]);
            out.speed_rad_s.push(x[1]);
        }
        let u = signal::held(&events, f64::from(step) * h + 1e-12).unwrap();
        let rates = |[i, w, w2, twist]: [f64; 4]| {
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
        let (id, own) = coupled(values);
        let effects = [(id, &own[..]), ("viscous_friction", &[drag])];
        let out = run(if drag == 0.0 { &effects[..1] } else { &effects });
        let [di, dw] = differences(&out, &reference(values, drag));
        assert!(di < 0.01 && dw < 0.02, "{values:?} {drag}: {di} {dw}");
    }
}

fn difference(one: &Trajectory, other: &Trajectory) -> f64 {
    let [current, speed] = differences(one, other);
    current.max(speed)
}

#[track_caller]
fn assert_near(one: &Trajectory, other: &Trajectory, within: f64) {
    let apart = difference(one, other);
    assert!(apart < within, "{apart}");
}

#[test]
fn stiff_light_and_tight_shafts_are_their_limits() {
    let single = run(&[]);
    assert_near(&single, &run_of([1500.0, 0.5, 0.3, 0.4, 0.0]), 0.02);
    assert_near(&single, &run_of([20.0, 1e-6, 0.05, 0.0, 0.0]), 1e-3);
    // The comparison can fail.
    assert!(difference(&single, &run_of([20.0, 0.5, 0.05, 0.4, 0.0])) > 1.0);
    // Without a gap backlash is an elastic coupling.
    let elastic = run_of([30.0, 0.5, 0.03, 0.4, 0.0]);
    assert_near(&run(&[("backlash", &[0.0, 30.0, 0.5, 0.03, 0.4])]), &elastic, 1e-9);
    assert_near(&run_of([30.0, 0.5, 0.03, 0.4, 1e-6]), &elastic, 1e-2);
    // A stiff shaft in a stiff circuit stays finite.
    let mut stiff = model(&[("elastic_coupling", &[200.0, 0.9, 1.0, 0.5])]);
    stiff.motor.set(MotorKey::Inductance, 1e-6);
    let out = simulate(&stiff, &scenario(reversals(), 0.001, 1100));
    let fastest = largest(&out.speed_rad_s);
    assert!(out.speed_rad_s.iter().all(|speed| speed.is_finite()));
    assert!((20.0..100.0).contains(&fastest), "{fastest}");
}

#[test]
fn a_changed_inertia_acts_on_both_sides_of_the_shaft() {
    let (f, r, zeta, split, gap) = (20.0, 0.5, 0.05, 0.4, 0.02);
    for ratio in [0.6_f64, -0.3] {
        // Long ago, and with the same stiffness and damping.
        let root = (1.0 + ratio).sqrt();
        let values = [gap, f, r, zeta, split];
        let changed = run(&[("backlash", &values), ("inertia_change", &[ratio, -1.0])]);
        let mut heavy = model(&[("backlash", &[gap, f / root, r, zeta / root, split])]);
        let inertia = heavy.motor.get(MotorKey::Inertia).unwrap();
        heavy.motor.set(MotorKey::Inertia, (1.0 + ratio) * inertia);
        assert_near(&changed, &simulate(&heavy, &scenario(reversals(), 0.001, 1101)), 0.02);
    }
}

#[test]
fn there_is_one_second_inertia() {
    let both: &[(&str, &[f64])] = &[
        ("elastic_coupling", &[24.0, 0.5, 0.02, 0.5]),
        ("backlash", &[0.05, 24.0, 0.5, 0.02, 0.5]),
    ];
    assert_eq!(Plant::new(&model(both), Input::Voltage).err(), Some(ModelError::SecondCoupling));
}

/// A torque pulse on a motor with all friction on the load side: the trajectory, and the plant after it.
fn pulsed(id: &str, values: &[f64], load_torque_n_m: f64, samples: usize) -> (Trajectory, Plant) {
    let mut model = model(&[(id, values)]);
    model.motor.set(MotorKey::LoadTorque, load_torque_n_m);
    let mut torque = scenario(vec![(0.0, 0.2), (0.1, 0.0)], 0.001, samples);
    torque.input = Input::Torque;
    let mut plant = Plant::new(&model, Input::Torque).unwrap();
    (plant.simulate(&torque, State::default()), plant)
}

#[test]
fn without_friction_the_shaft_only_passes_momentum_on() {
    for (id, values) in [
        ("elastic_coupling", &[17.0, 0.6, 0.0, 0.5][..]),
        ("backlash", &[0.05, 30.0, 0.6, 0.1, 0.5]),
    ] {
        let speeds = [150, 200, 333, 400].map(|samples| {
            let (out, plant) = pulsed(id, values, 0.0, samples);
            let motor = out.speed_rad_s[samples - 1];
            let load = plant.two_mass.as_ref().unwrap().load.speed_rad_s;
            let momentum = 0.0045 * (0.4 * motor + 0.6 * load);
            assert!((momentum - 0.2 * 0.1).abs() < 1e-12, "{id} {momentum}");
            motor
        });
        // It rings meanwhile.
        assert!((speeds[0] - speeds[1]).abs() > 0.05, "{speeds:?}");
    }
}

#[test]
fn a_held_load_lets_the_motor_ring_on_the_shaft() {
    // 0.2 N.m are below the 0.3 N.m that hold the load; the motor has no friction of its own.
    let (f, r) = (20.0, 0.6);
    let (out, plant) = pulsed("elastic_coupling", &[f, r, 0.0, 1.0], 0.5, 100);
    let load = plant.two_mass.as_ref().unwrap().load;
    assert!(load.mode == super::Mode::Stuck && load.speed_rad_s == 0.0);
    // J1 w' = T - k twist: w = T / (J1 w1) sin(w1 t) with w1^2 = k / J1 = (2 pi f)^2 r.
    let w1 = std::f64::consts::TAU * f * r.sqrt();
    for (sample, speed) in out.speed_rad_s.iter().enumerate() {
        let expected = 0.2 / (0.0045 * 0.4 * w1) * (w1 * sample as f64 * 1e-3).sin();
        assert!((speed - expected).abs() < 1e-9, "{sample} {speed} {expected}");
    }
}

#[test]
fn irregular_sampling_changes_nothing() {
    for values in [[28.0, 0.5, 0.03, 0.4, 0.0], [45.0, 0.5, 0.03, 0.4, 0.05]] {
        let mut irregular = scenario(reversals(), 0.001, 2202);
        // Between two samples of the regular run one more, at an instant of its own.
        let between = |k: usize| 1e-3 * (k as f64 + 0.1 + 0.8 * (k as f64 * 0.618).fract());
        irregular.sample_time_s = (0..1101).flat_map(|k| [k as f64 * 1e-3, between(k)]).collect();
        let (id, own) = coupled(values);
        let out = simulate(&model(&[(id, &own)]), &irregular);
        let same = Trajectory {
            current_a: out.current_a.iter().copied().step_by(2).collect(),
            speed_rad_s: out.speed_rad_s.iter().copied().step_by(2).collect(),
        };
        assert_near(&run_of(values), &same, 1e-6);
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
                    run_of(moved).speed_rad_s
                };
                let (low, mid, high) = (at(-1.0), at(0.0), at(1.0));
                let bend = largest((0..mid.len()).map(|k| low[k] - 2.0 * mid[k] + high[k]));
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
    assert_near(&free, &plant.predict_ahead(&measured, State::default(), 1, 0), 1e-6);
    // Noise on the measurement stays of its size: the load does not run away from the motor.
    for (speed, noise) in measured.speed_rad_s.iter_mut().zip([0.1, -0.1].into_iter().cycle()) {
        *speed += noise;
    }
    assert_near(&free, &plant.predict_ahead(&measured, State::default(), 1, 0), 0.8);
}

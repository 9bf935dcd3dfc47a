use super::*;
use crate::plant::testing::{self, held};
use crate::plant::{ActiveEffect, Model, Motor, effect};
use crate::sample::Channel;
use crate::signal;

/// Under these voltages, with nothing measured.
pub(super) fn scenario(events: Vec<(f64, f64)>, period_s: f64, samples: usize) -> Scenario {
    let times = (0..samples).map(|k| k as f64 * period_s).collect();
    let mut scenario = Scenario::planned("test", Input::Voltage, Channel::Voltage, events, times);
    scenario.current_a = vec![f64::NAN; samples];
    scenario.speed_rad_s = vec![f64::NAN; samples];
    scenario
}

pub(super) fn model(effects: &[(&str, &[f64])]) -> Model {
    let mut model = Model::baseline(Motor::zk_22fc());
    let known =
        |(id, values): &(&str, &[f64])| ActiveEffect::with(effect::find(id).unwrap(), values);
    model.effects = effects.iter().map(known).collect();
    model
}

/// The motor of paper A with these effects under these voltages, from rest.
pub(super) fn simulated(
    effects: &[(&str, &[f64])],
    events: Vec<(f64, f64)>,
    period_s: f64,
    samples: usize,
) -> Trajectory {
    let mut plant = Plant::new(&model(effects), Input::Voltage).unwrap();
    plant.simulate(&scenario(events, period_s, samples), State::default())
}

/// Independent formulation: small Runge-Kutta steps, friction regularised over a very narrow band of speed.
fn reference(
    events: &[(f64, f64)],
    until_s: f64,
    drag: f64,
    stribeck: (f64, f64),
    drop_v: f64,
) -> (f64, f64) {
    let (r, l, ke, j, mc) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
    let h = 2e-6;
    let (mut i, mut w) = (0.0f64, 0.0f64);
    let steps = whole((until_s / h).round());
    for step in 0..steps {
        let t = step as f64 * h;
        let u = signal::held(events, t + 1e-12).unwrap();
        let f = |i: f64, w: f64| {
            let level = mc + stribeck.0 * (-(w / stribeck.1).powi(2)).exp();
            [
                (u - r * i - ke * w - drop_v * (i / 0.1).tanh()) / l,
                (ke * i - drag * w - level * (w / 1e-3).tanh()) / j,
            ]
        };
        let k1 = f(i, w);
        let k2 = f(i + 0.5 * h * k1[0], w + 0.5 * h * k1[1]);
        i += h * k2[0];
        w += h * k2[1];
    }
    (i, w)
}

#[test]
fn a_locked_start_rises_with_the_electrical_time_constant() {
    // 1 V drives 0.9 A: 0.32 N.m, below the Coulomb level, so the shaft stays and i = u/R (1 - exp(-t R/L)).
    let out = simulated(&[], vec![(0.0, 1.0)], 0.003, 10);
    for (k, current) in out.current_a.iter().enumerate() {
        let expected = (1.0 - (-(k as f64) * 0.003 / 0.009).exp()) / 1.1;
        let off = current - expected;
        assert!(off.abs() < 1e-12, "{k}: {current} {expected}");
    }
    assert!(out.speed_rad_s.iter().all(|speed| *speed == 0.0));
}

#[test]
fn steady_speed_under_voltage_is_the_closed_form() {
    let out = simulated(&[], vec![(0.0, 60.0)], 0.01, 200);
    let current = 0.455 / 0.3538;
    assert!((out.current_a[199] - current).abs() < 1e-9);
    assert!((out.speed_rad_s[199] - (60.0 - 1.1 * current) / 0.3538).abs() < 1e-8);
}

/// Reversals, a creep through zero and holds at rest.
pub(super) fn reversals() -> Vec<(f64, f64)> {
    held(
        [0.0, 0.05, 0.25, 0.5, 0.6, 0.7, 0.8, 0.95],
        [0.0, 20.0, -12.0, 2.0, -1.0, 3.0, 0.0, -30.0],
    )
}

#[test]
fn stick_slip_and_effects_agree_with_tiny_regularised_steps() {
    let events = reversals();
    for (effects, drag, stribeck, drop_v) in [
        (&[][..], 0.0, (0.0, 1.0), 0.0),
        (&[("viscous_friction", &[4e-3][..])], 4e-3, (0.0, 1.0), 0.0),
        (&[("stribeck_friction", &[0.2, 8.0])], 0.0, (0.2, 8.0), 0.0),
        (&[("voltage_drop", &[0.9])], 0.0, (0.0, 1.0), 0.9),
    ] {
        for period_s in [0.001, 0.01] {
            let samples = whole(1.1 / period_s);
            let out = simulated(effects, events.clone(), period_s, samples);
            for until in [0.3, 0.54, 0.66, 0.79, 1.0] {
                let k = whole(until / period_s + 0.5);
                let (i, w) = reference(&events, k as f64 * period_s, drag, stribeck, drop_v);
                let (di, dw) = (out.current_a[k] - i, out.speed_rad_s[k] - w);
                let is_near = di.abs() < 0.01 && dw.abs() < 0.02;
                assert!(
                    is_near,
                    "{effects:?} {period_s} {until}: {di} {dw} of {i} {w}"
                );
            }
        }
    }
}

#[test]
fn sampling_more_often_changes_nothing() {
    let events = held([0.0, 0.05, 0.4, 0.8, 0.9], [0.0, 40.0, -35.0, 0.5, 0.0]);
    let run = |period_s: f64, samples| simulated(&[], events.clone(), period_s, samples);
    let (coarse, fine) = (run(0.01, 101), run(0.001, 1001));
    for k in 0..101 {
        let dw = coarse.speed_rad_s[k] - fine.speed_rad_s[10 * k];
        let di = coarse.current_a[k] - fine.current_a[10 * k];
        assert!(dw.abs() < 1e-6 && di.abs() < 1e-6, "{k}: {dw} {di}");
    }
}

#[test]
fn a_mechanical_run_integrates_the_torque() {
    let mut plant = Plant::new(&model(&[]), Input::Torque).unwrap();
    let mut torque = scenario(vec![(0.0, 1.455), (0.5, 0.0)], 0.01, 101);
    torque.input = Input::Torque;
    let out = plant.simulate(&torque, State::default());
    assert!((out.speed_rad_s[50] - 0.5 / 0.0045).abs() < 1e-9);
    // Coasts down on a straight line of slope Mc/J.
    assert!((out.speed_rad_s[60] - (0.5 - 0.0455) / 0.0045).abs() < 1e-8);
    assert!((out.speed_rad_s[50] - out.speed_rad_s[75] - 0.25 * 0.455 / 0.0045).abs() < 1e-8);
}

#[test]
fn heating_raises_the_resistance_as_its_state_says() {
    // Locked (current below breakaway): x' = i^2 - x/tau with i nearly constant.
    let heated = [("winding_heating", &[0.05, 5.0][..])];
    let out = simulated(&heated, vec![(0.0, 1.0)], 0.01, 3000);
    let i = out.current_a[2999];
    let heat = 5.0 * i * i * (1.0 - (-30.0f64 / 5.0).exp());
    // The current moved by a few per cent on the way, so the closed form holds to a per mille.
    let off = i * 1.1 * (1.0 + 0.05 * heat) - 1.0;
    assert!(off.abs() < 2e-3, "{i} {heat}");
}

/// Root mean square of what two signals differ by.
fn rms(one: &[f64], other: &[f64]) -> f64 {
    let squares: f64 = one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum();
    (squares / one.len() as f64).sqrt()
}

#[test]
fn one_step_predictions_of_the_true_model_err_by_the_noise_behind_slow_sensors() {
    let events = held([0.0, 0.3, 0.6, 0.8], [20.0, -12.0, 30.0, 10.0]);
    let several: [(&str, &[f64]); 4] = [
        ("speed_delay", &[0.003]),
        ("speed_filter", &[0.004]),
        ("current_filter", &[0.003]),
        ("speed_offset", &[1.5]),
    ];
    for effects in [
        &[("speed_delay", &[0.002][..])],
        &[("speed_delay", &[0.0075])],
        &[("speed_filter", &[0.005])],
        &several[..],
    ] {
        let model = model(effects);
        let run = testing::record(&model, events.clone(), 0.001, 1.0, 7);
        let mut plant = Plant::new(&model, Input::Voltage).unwrap();
        let ahead = plant.predict_ahead(&run, State::default(), 1);
        let speed = rms(&ahead.speed_rad_s, &run.speed_rad_s) / testing::SPEED_NOISE_RAD_S;
        let current = rms(&ahead.current_a, &run.current_a) / testing::CURRENT_NOISE_A;
        // The noise of the sample before and that of the sample itself, and what of one comes through the other.
        let most = speed.max(current);
        assert!(most < 1.7, "{effects:?}: {speed} {current}");
    }
}

type OfCurrent = fn(f64) -> f64;

#[test]
fn steep_effects_settle_on_a_motor_of_little_inductance() {
    // R, L, Ke, J, Mc of a small fast motor: 0.6 ms electrical.
    let small @ [r, l, ke, j, mc] = [0.8, 5e-4, 0.05, 3e-5, 0.01];
    let events = held([0.0, 0.05, 0.15, 0.25, 0.35], [0.0, 12.0, -12.0, 3.0, 0.0]);
    let conduction: OfCurrent = |i| 8.0 * i.clamp(-0.5, 0.5);
    let cases: [(&str, &[f64], OfCurrent, OfCurrent); 3] = [
        ("voltage_drop", &[1.5], |i| 1.5 * (i / 0.1).tanh(), |_| 0.0),
        ("discontinuous_conduction", &[8.0, 0.5], conduction, |_| 0.0),
        ("inductance_saturation", &[0.03], |_| 0.0, |i| 0.03 * i * i),
    ];
    for (id, values, drop, gain) in cases {
        let mut model = model(&[(id, values)]);
        model.motor = testing::motor("small", &small);
        for period_s in [0.001, 0.01] {
            let samples = whole(0.45 / period_s);
            let run = scenario(events.clone(), period_s, samples);
            let mut plant = Plant::new(&model, Input::Voltage).unwrap();
            let out = plant.simulate(&run, State::default());
            // Independent formulation: tiny midpoint steps, friction over a narrow band.
            let h = 1e-6;
            let (mut i, mut w, mut worst) = (0.0_f64, 0.0_f64, [0.0_f64; 2]);
            let rates = |u: f64, i: f64, w: f64| {
                let di = (1.0 + gain(i)) * (u - r * i - ke * w - drop(i)) / l;
                [di, (ke * i - mc * (w / 1e-3).tanh()) / j]
            };
            for k in 1..samples {
                for step in 0..whole((period_s / h).round()) {
                    let t = (k - 1) as f64 * period_s + step as f64 * h;
                    let u = signal::held(&events, t + 1e-9).unwrap();
                    let begin = rates(u, i, w);
                    let middle = rates(u, i + 0.5 * h * begin[0], w + 0.5 * h * begin[1]);
                    i += h * middle[0];
                    w += h * middle[1];
                }
                worst[0] = worst[0].max((out.current_a[k] - i).abs());
                worst[1] = worst[1].max((out.speed_rad_s[k] - w).abs());
            }
            let is_near = worst[0] < 0.1 && worst[1] < 0.5;
            assert!(is_near, "{id} {period_s}: {worst:?}");
        }
    }
}

#[test]
fn no_place_is_steep_on_an_ordinary_motor() {
    for (id, values) in [
        ("voltage_drop", &[1.0][..]),
        ("discontinuous_conduction", &[2.0, 0.6][..]),
        ("inductance_saturation", &[3e-4][..]),
        ("stribeck_friction", &[0.2, 8.0][..]),
    ] {
        let equations = &mut Equations::new(&model(&[(id, values)]), Input::Voltage).unwrap();
        equations.set_supply(110.0);
        let steep = Steep::of(equations, LONGEST_STEP_WITH_EFFECTS_S);
        assert!(steep.is_empty(), "{id}");
    }
}

/// Largest miss of the speed behind a hole of which the input is told wrongly.
fn largest_miss_behind_a_hole(model: &Model) -> f64 {
    let whole = testing::record(model, vec![(0.0, 20.0)], 1e-3, 1.0, 3);
    let mut lossy = whole.clone();
    lossy.events = held([0.0, 0.5, 0.7], [20.0, -40.0, 20.0]);
    let there = State::at(whole.current_a[700], whole.speed_rad_s[700]);
    lossy.unknown_input = vec![crate::plant::UnknownInput {
        from_s: 0.5,
        to_s: whole.sample_time_s[700],
        lost_rows: 200,
        mean: -40.0,
        beside: [0.0; 3],
        variance: 1.0,
        restart: Some([there.current_a, there.speed_rad_s]),
    }];
    let mut plant = Plant::new(model, Input::Voltage).unwrap();
    let out = plant.simulate(&lossy, State::default());
    let pairs = out.speed_rad_s.iter().zip(&whole.speed_rad_s).skip(700);
    pairs.fold(0.0, |most, (a, b)| f64::max(most, (a - b).abs()))
}

#[test]
fn behind_a_long_hole_the_simulation_goes_on_from_the_measurement() {
    let coupling = ("elastic_coupling", &[20.0, 0.5, 0.05, 0.5][..]);
    let backlash = ("backlash", &[0.05, 50.0, 0.5, 0.05, 0.5][..]);
    let late = ("command_delay", &[5e-3][..]);
    for (name, effects, most) in [
        ("one mass", &[][..], 1.0),
        ("the load goes along with the motor", &[coupling], 1.5),
        ("with play too", &[backlash], 1.5),
        ("a late command is not taken for known", &[late], 1.0),
    ] {
        let miss = largest_miss_behind_a_hole(&model(effects));
        assert!(miss < most, "{name}: {miss}");
    }
}

#[test]
fn what_only_delays_and_offsets_leaves_the_equations_as_exact_as_they_are() {
    let events = vec![(0.0, 0.0), (0.1, 60.0), (0.5, -40.0), (0.9, 0.0)];
    let run = scenario(events, 1e-3, 1200);
    let way = [
        ("command_delay", &[7e-4][..]),
        ("current_offset", &[0.3]),
        ("speed_offset", &[-2.0]),
    ];
    let simulate = |effects: &[(&str, &[f64])], run: &Scenario| {
        let mut plant = Plant::new(&model(effects), Input::Voltage).unwrap();
        plant.simulate(run, State::default())
    };
    let late = simulate(&way, &run);
    let bare = simulate(&[], &run.with_input_delayed(7e-4));
    for sample in 0..run.samples() {
        let off_a = late.current_a[sample] - bare.current_a[sample] - 0.3;
        let off_rad_s = late.speed_rad_s[sample] - bare.speed_rad_s[sample] + 2.0;
        assert!(off_a.abs() < 1e-9 && off_rad_s.abs() < 1e-9);
    }
    // Beside what does enter a balance nothing else changes either.
    let drag = ("viscous_friction", &[3e-4][..]);
    let drop = ("voltage_drop", &[1.0][..]);
    let late = simulate(&[way[0], drag, drop], &run);
    let bare = simulate(&[drag, drop], &run.with_input_delayed(7e-4));
    for (a, b) in late.speed_rad_s.iter().zip(&bare.speed_rad_s) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
}

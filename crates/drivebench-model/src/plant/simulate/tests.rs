use super::*;
use crate::numerics::statistics::largest;
use crate::plant::testing::{self, held};
use crate::plant::{Model, Motor};
use crate::sample::Channel;
use crate::signal;

type OfCurrent = fn(f64) -> f64;
type Effects<'a> = &'a [(&'a str, &'a [f64])];

/// Under these voltages, with nothing measured.
pub(super) fn scenario(events: Vec<(f64, f64)>, period_s: f64, samples: usize) -> Scenario {
    let times = (0..samples).map(|k| k as f64 * period_s).collect();
    Scenario {
        current_a: vec![f64::NAN; samples],
        speed_rad_s: vec![f64::NAN; samples],
        ..Scenario::planned("test", Input::Voltage, Channel::Voltage, events, times)
    }
}

pub(super) fn model(effects: Effects<'_>) -> Model {
    let plain = Model::baseline(Motor::zk_22fc());
    effects.iter().fold(plain, |model, (id, values)| testing::with(&model, id, values))
}

pub(super) fn simulate(model: &Model, scenario: &Scenario) -> Trajectory {
    Plant::new(model, scenario.input).unwrap().simulate(scenario, State::default())
}

pub(super) fn simulated(
    effects: Effects<'_>,
    events: Vec<(f64, f64)>,
    period_s: f64,
    samples: usize,
) -> Trajectory {
    simulate(&model(effects), &scenario(events, period_s, samples))
}

pub(super) fn differences(one: &Trajectory, other: &Trajectory) -> [f64; 2] {
    let most = |a: &[f64], b: &[f64]| largest(a.iter().zip(b).map(|(a, b)| a - b));
    [most(&one.current_a, &other.current_a), most(&one.speed_rad_s, &other.speed_rad_s)]
}

type Rates<'a> = &'a dyn Fn(f64, f64, f64) -> [f64; 2];

/// Independent formulation: midpoint steps of `h` over `rates(u, i, w)`, with friction regularised over a very narrow band of
/// speed; sampled every `period_s`.
fn reference(
    events: &[(f64, f64)],
    period_s: f64,
    samples: usize,
    h: f64,
    rates: Rates<'_>,
) -> Trajectory {
    let (mut i, mut w) = (0.0, 0.0);
    let mut out = Trajectory::default();
    let per_sample = whole((period_s / h).round());
    for step in 0..samples * per_sample {
        if step % per_sample == 0 {
            out.current_a.push(i);
            out.speed_rad_s.push(w);
        }
        let u = signal::held(events, step as f64 * h + 1e-12).unwrap();
        let begin = rates(u, i, w);
        let middle = rates(u, i + 0.5 * h * begin[0], w + 0.5 * h * begin[1]);
        i += h * middle[0];
        w += h * middle[1];
    }
    out
}

#[test]
fn runs_without_effects_are_their_closed_forms() {
    // 1 V drives 0.9 A: 0.32 N.m, below the Coulomb level, so the shaft stays and i = u/R (1 - exp(-t R/L)).
    let out = simulated(&[], vec![(0.0, 1.0)], 0.003, 10);
    for (k, current) in out.current_a.iter().enumerate() {
        let expected = (1.0 - (-(k as f64) * 0.003 / 0.009).exp()) / 1.1;
        assert!((current - expected).abs() < 1e-12, "{k}: {current} {expected}");
    }
    assert!(out.speed_rad_s.iter().all(|speed| *speed == 0.0));
    // The steady state under a voltage.
    let out = simulated(&[], vec![(0.0, 60.0)], 0.01, 200);
    let current = 0.455 / 0.3538;
    assert!((out.current_a[199] - current).abs() < 1e-9);
    assert!((out.speed_rad_s[199] - (60.0 - 1.1 * current) / 0.3538).abs() < 1e-8);
    // A mechanical run integrates the torque, and coasts down on a straight line of slope Mc/J.
    let mut torque = scenario(vec![(0.0, 1.455), (0.5, 0.0)], 0.01, 101);
    torque.input = Input::Torque;
    let speed = simulate(&model(&[]), &torque).speed_rad_s;
    for (sample, momentum) in [(50, 0.5), (60, 0.5 - 0.0455), (75, 0.5 - 0.25 * 0.455)] {
        assert!((speed[sample] - momentum / 0.0045).abs() < 1e-8, "{sample}");
    }
}

/// Reversals, a creep through zero and holds at rest.
pub(super) fn reversals() -> Vec<(f64, f64)> {
    let volts = [0.0, 20.0, -12.0, 2.0, -1.0, 3.0, 0.0, -30.0];
    held([0.0, 0.05, 0.25, 0.5, 0.6, 0.7, 0.8, 0.95], volts)
}

#[test]
fn stick_slip_and_effects_agree_with_tiny_regularised_steps() {
    let (r, l, ke, j, mc) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
    // Drag, Stribeck friction with its speed, voltage drop.
    let cases: [(Effects<'_>, [f64; 4]); 4] = [
        (&[], [0.0, 0.0, 1.0, 0.0]),
        (&[("viscous_friction", &[4e-3])], [4e-3, 0.0, 1.0, 0.0]),
        (&[("stribeck_friction", &[0.2, 8.0])], [0.0, 0.2, 8.0, 0.0]),
        (&[("voltage_drop", &[0.9])], [0.0, 0.0, 1.0, 0.9]),
    ];
    for (effects, [drag, stribeck, stribeck_speed, drop_v]) in cases {
        let rates = |u: f64, i: f64, w: f64| {
            let level = mc + stribeck * (-(w / stribeck_speed).powi(2)).exp();
            [
                (u - r * i - ke * w - drop_v * (i / 0.1).tanh()) / l,
                (ke * i - drag * w - level * (w / 1e-3).tanh()) / j,
            ]
        };
        let expected = reference(&reversals(), 0.01, 110, 2e-6, &rates);
        for every in [1, 10] {
            let period_s = 0.01 / every as f64;
            let out = simulated(effects, reversals(), period_s, 110 * every);
            let picked = |all: &[f64]| all.iter().copied().step_by(every).collect();
            let out = Trajectory {
                current_a: picked(&out.current_a),
                speed_rad_s: picked(&out.speed_rad_s),
            };
            let [di, dw] = differences(&out, &expected);
            assert!(di < 0.02 && dw < 0.05, "{effects:?} {period_s}: {di} {dw}");
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
fn heating_raises_the_resistance_as_its_state_says() {
    // Locked (current below breakaway): x' = i^2 - x/tau with i nearly constant.
    let heated = [("winding_heating", &[0.05, 5.0][..])];
    let i = simulated(&heated, vec![(0.0, 1.0)], 0.01, 3000).current_a[2999];
    let heat = 5.0 * i * i * (1.0 - (-30.0f64 / 5.0).exp());
    // The current moved by a few per cent on the way, so the closed form holds to a per mille.
    let off = i * 1.1 * (1.0 + 0.05 * heat) - 1.0;
    assert!(off.abs() < 2e-3, "{i} {heat}");
}

#[test]
fn one_step_predictions_behind_slow_sensors_err_by_the_noise() {
    let events = held([0.0, 0.3, 0.6, 0.8], [20.0, -12.0, 30.0, 10.0]);
    let cases: [Effects<'_>; 4] = [
        &[("speed_delay", &[0.002])],
        &[("speed_delay", &[0.0075])],
        &[("speed_filter", &[0.005])],
        &[
            ("speed_delay", &[0.003]),
            ("speed_filter", &[0.004]),
            ("current_filter", &[0.003]),
            ("speed_offset", &[1.5]),
        ],
    ];
    for effects in cases {
        let model = model(effects);
        let run = testing::record(&model, events.clone(), 0.001, 1.0, 7);
        let mut plant = Plant::new(&model, Input::Voltage).unwrap();
        let ahead = plant.predict_ahead(&run, State::default(), 1, 0);
        let rms = |one: &[f64], other: &[f64]| {
            let squares: f64 = one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum();
            (squares / one.len() as f64).sqrt()
        };
        let speed = rms(&ahead.speed_rad_s, &run.speed_rad_s) / testing::SPEED_NOISE_RAD_S;
        let current = rms(&ahead.current_a, &run.current_a) / testing::CURRENT_NOISE_A;
        // The noise of the sample before and that of the sample itself, and what of one comes through the other.
        assert!(speed.max(current) < 1.7, "{effects:?}: {speed} {current}");
    }
}

#[test]
fn steep_effects_settle_on_a_motor_of_little_inductance() {
    // R, L, Ke, J, Mc of a small fast motor: 0.6 ms electrical.
    let small @ [r, l, ke, j, mc] = [0.8, 5e-4, 0.05, 3e-5, 0.01];
    let events = held([0.0, 0.05, 0.15, 0.25, 0.35], [0.0, 12.0, -12.0, 3.0, 0.0]);
    let cases: [(Effects<'_>, OfCurrent, OfCurrent); 3] = [
        (&[("voltage_drop", &[1.5])], |i| 1.5 * (i / 0.1).tanh(), |_| 0.0),
        (&[("discontinuous_conduction", &[8.0, 0.5])], |i| 8.0 * i.clamp(-0.5, 0.5), |_| 0.0),
        (&[("inductance_saturation", &[0.03])], |_| 0.0, |i| 0.03 * i * i),
    ];
    for (effects, drop, gain) in cases {
        let mut model = model(effects);
        model.motor = testing::motor("small", &small);
        let rates = |u: f64, i: f64, w: f64| {
            let di = (1.0 + gain(i)) * (u - r * i - ke * w - drop(i)) / l;
            [di, (ke * i - mc * (w / 1e-3).tanh()) / j]
        };
        for (period_s, samples) in [(0.001, 450), (0.01, 45)] {
            let out = simulate(&model, &scenario(events.clone(), period_s, samples));
            let [di, dw] = differences(&out, &reference(&events, period_s, samples, 1e-6, &rates));
            assert!(di < 0.1 && dw < 0.5, "{effects:?} {period_s}: {di} {dw}");
        }
    }
}

#[test]
fn a_steep_effect_costs_where_the_current_changes_in_it_alone() {
    let mut model = model(&[("voltage_drop", &[1.5])]);
    model.motor = testing::motor("small", &[0.8, 5e-4, 0.05, 3e-5, 0.01]);
    let work = |volts: f64| {
        let run = scenario(held([0.0, 0.05], [0.0, volts]), 0.001, 450);
        let mut plant = Plant::new(&model, Input::Voltage).unwrap();
        plant.simulate(&run, State::default());
        plant.work()
    };
    // Two sub-steps a row, each of which costs ten of a linear motor; a start passes the place once.
    let [rest, start] = [0.0, 12.0].map(work);
    assert!((8900..9100).contains(&rest), "{rest}");
    assert!(start < rest + rest / 4, "{start}");
}

#[test]
fn no_place_is_steep_on_an_ordinary_motor() {
    let cases: [Effects<'_>; 4] = [
        &[("voltage_drop", &[1.0])],
        &[("discontinuous_conduction", &[2.0, 0.6])],
        &[("inductance_saturation", &[3e-4])],
        &[("stribeck_friction", &[0.2, 8.0])],
    ];
    for effects in cases {
        let mut equations = Equations::new(&model(effects), Input::Voltage).unwrap();
        equations.set_run(110.0, &RunScales::REFERENCE);
        let steep =
            Steep::of(&equations, RunScales::REFERENCE.responses(LONGEST_STEP_WITH_EFFECTS), 110.0);
        assert!(steep.is_empty(), "{effects:?}");
    }
}

#[test]
fn after_a_long_hole_a_simulation_restarts_from_the_measurement() {
    let cases: [(&str, Effects<'_>, f64); 4] = [
        ("one mass", &[], 1.0),
        ("a second inertia", &[("elastic_coupling", &[20.0, 0.5, 0.05, 0.5])], 1.5),
        ("with play", &[("backlash", &[0.05, 50.0, 0.5, 0.05, 0.5])], 1.5),
        ("a late command", &[("command_delay", &[5e-3])], 1.0),
    ];
    for (name, effects, most) in cases {
        let whole = testing::record(&model(effects), vec![(0.0, 20.0)], 1e-3, 1.0, 3);
        // The input within the hole is wrong.
        let mut lossy = whole.clone();
        lossy.events = held([0.0, 0.5, 0.7], [20.0, -40.0, 20.0]);
        lossy.unknown_input = vec![crate::plant::UnknownInput {
            from_s: 0.5,
            to_s: whole.sample_time_s[700],
            lost_rows: 200,
            mean: -40.0,
            beside: [0.0; 3],
            variance: 1.0,
            restart: Some([whole.current_a[700], whole.speed_rad_s[700]]),
        }];
        let out = simulate(&model(effects), &lossy);
        let pairs = out.speed_rad_s.iter().zip(&whole.speed_rad_s).skip(700);
        let miss = largest(pairs.map(|(a, b)| a - b));
        assert!(miss < most, "{name}: {miss}");
    }
}

#[test]
fn the_offset_of_stamps_acts_in_runs_that_the_host_has_stamped() {
    let events = vec![(0.0, 0.0), (0.1, 60.0), (0.5, -40.0), (0.9, 0.0)];
    let mut run = scenario(events, 1e-3, 1200);
    for offset_s in [7e-4, -7e-4] {
        let offset = Model { input_delay_s: Some(offset_s), ..model(&[]) };
        run.time_half_width_s.clear();
        assert_eq!(simulate(&offset, &run), simulate(&model(&[]), &run));
        let mut later = run.clone();
        later.events[1..].iter_mut().for_each(|event| event.0 += offset_s);
        run.time_half_width_s = vec![1e-4; run.samples()];
        let [di, dw] = differences(&simulate(&offset, &run), &simulate(&model(&[]), &later));
        assert!(di < 1e-9 && dw < 1e-9, "{di} {dw}");
    }
}

#[test]
fn delays_and_offsets_leave_the_equations_as_exact_as_they_are() {
    let events = vec![(0.0, 0.0), (0.1, 60.0), (0.5, -40.0), (0.9, 0.0)];
    let run = scenario(events, 1e-3, 1200);
    let mut delayed = run.clone();
    delayed.events[1..].iter_mut().for_each(|event| event.0 += 7e-4);
    let drag = ("viscous_friction", &[3e-4][..]);
    let drop = ("voltage_drop", &[1.0][..]);
    let delay = ("command_delay", &[7e-4][..]);
    let offsets = [("current_offset", &[0.3][..]), ("speed_offset", &[-2.0])];
    let cases: [(Effects<'_>, Effects<'_>, [f64; 2]); 2] = [
        (&[delay, offsets[0], offsets[1]], &[], [0.3, -2.0]),
        (&[delay, drag, drop], &[drag, drop], [0.0, 0.0]),
    ];
    for (late, bare, [offset_a, offset_rad_s]) in cases {
        let late = simulate(&model(late), &run);
        let mut bare = simulate(&model(bare), &delayed);
        bare.current_a.iter_mut().for_each(|current| *current += offset_a);
        bare.speed_rad_s.iter_mut().for_each(|speed| *speed += offset_rad_s);
        let [di, dw] = differences(&late, &bare);
        assert!(di < 1e-9 && dw < 1e-9, "{di} {dw}");
    }
}

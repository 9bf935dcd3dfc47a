//! Load tracking against an independent integrator: Runge-Kutta at 50 us with its own stick-slip.

use super::*;
use crate::testing::*;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::Motor;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, StandardNormal};

fn plant(events: &[(f64, f64)], load: &dyn Fn(f64) -> f64, period_s: f64, seconds: f64) -> Record {
    let [r, l, ke, j, mc] = PAPER;
    let (mut i, mut w) = (0.0_f64, 0.0_f64);
    let times = every(period_s, seconds);
    let (mut current, mut speed) = (vec![], vec![]);
    let mut now = 0.0;
    for &time_s in &times {
        let h = 5e-5;
        while now < time_s - 0.5 * h {
            let volts = events[events.partition_point(|e| e.0 <= now + 1e-9) - 1].1;
            let drive = |i: f64| ke * i - load(now + 0.5 * h);
            let along = if w == 0.0 { drive(i) } else { w };
            let friction = mc * along.signum();
            let turns = f64::from(u8::from(w != 0.0 || drive(i).abs() > mc));
            let f = |i: f64, w: f64| {
                let turning = turns * (drive(i) - friction) / j;
                ((volts - r * i - ke * w) / l, turning)
            };
            let k1 = f(i, w);
            let k2 = f(i + 0.5 * h * k1.0, w + 0.5 * h * k1.1);
            let k3 = f(i + 0.5 * h * k2.0, w + 0.5 * h * k2.1);
            let k4 = f(i + h * k3.0, w + h * k3.1);
            i += h / 6.0 * (k1.0 + 2.0 * k2.0 + 2.0 * k3.0 + k4.0);
            let next = w + h / 6.0 * (k1.1 + 2.0 * k2.1 + 2.0 * k3.1 + k4.1);
            let stops = w != 0.0 && next * w <= 0.0;
            w = if stops { 0.0 } else { next };
            now += h;
        }
        current.push(i);
        speed.push(w);
    }
    Record { events: events.to_vec(), times, current, speed }
}

fn track(record: &Record, seed: u64) -> LoadTrace {
    load_torque_trace(&record.run(Some(seed)), &Model::baseline(motor(&PAPER))).unwrap()
}

fn events() -> Vec<(f64, f64)> {
    vec![(0.0, 0.0), (0.5037, 40.0), (3.2, 55.0), (5.1, 35.0)]
}

/// Errors from a second after the start on: root mean square, that of error over standard deviation, share within 95 %.
fn score(trace: &LoadTrace, load: &dyn Fn(f64) -> f64) -> [f64; 3] {
    let late = trace.points.iter().filter(|point| point.time_s > 1.0);
    let errors: Vec<(f64, f64)> =
        late.map(|point| (point.load_torque_n_m - load(point.time_s), point.std_n_m)).collect();
    let mean = |of: &dyn Fn(f64, f64) -> f64| {
        errors.iter().map(|(error, std)| of(*error, *std)).sum::<f64>() / errors.len() as f64
    };
    [
        mean(&|error, _| error * error).sqrt(),
        mean(&|error, std| (error / std).powi(2)).sqrt(),
        mean(&|error, std| f64::from(u8::from(error.abs() < 1.96 * std))),
    ]
}

/// Rises by 0.6 N.m, drives with 0.4 N.m, goes back to nothing.
fn stepping(time_s: f64) -> f64 {
    match time_s {
        t if t < 2.0 => 0.0,
        t if t < 3.6 => 0.6,
        t if t < 4.4 => -0.4,
        _ => 0.0,
    }
}

#[test]
fn a_stepping_load_is_followed_at_1_and_10_ms() {
    for (period_s, settling_s, rmse, quiet) in [(0.001, 0.06, 0.1, 0.08), (0.01, 0.12, 0.16, 0.12)]
    {
        let trace = track(&plant(&events(), &stepping, period_s, 6.0), 1);
        let [all, _, covered] = score(&trace, &stepping);
        // After each step: the last instant at which the error is above a quarter of the smallest step.
        let (mut slowest, mut steady) = (0.0_f64, vec![]);
        for at_s in [2.0, 3.6, 4.4] {
            let after = |p: &&LoadPoint| (at_s..at_s + 0.7).contains(&p.time_s);
            for point in trace.points.iter().filter(after) {
                let error = point.load_torque_n_m - stepping(point.time_s);
                if error.abs() > 0.15 {
                    slowest = slowest.max(point.time_s - at_s);
                }
                if point.time_s > at_s + 0.3 {
                    steady.push(error);
                }
            }
        }
        let mean = statistics::mean(&steady);
        let rms = statistics::variance(&steady).sqrt().hypot(mean);
        assert!(slowest < settling_s, "{period_s} {slowest}");
        let is_near = all < rmse && rms < quiet && mean.abs() < 0.02 && covered > 0.9;
        assert!(is_near, "{period_s} {all} {rms} {mean} {covered}");
    }
}

#[test]
fn the_standard_deviation_is_honest_and_the_rate_is_found() {
    // A load that really is a random walk of 0.4 N.m/sqrt(s), in 1 ms steps.
    for period_s in [0.001, 0.01] {
        let (mut squares, mut covered, mut rates) = (0.0, 0.0, 0.0);
        for seed in 0..6 {
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(100 + seed);
            let mut walk = vec![0.0_f64];
            for _ in 0..6000 {
                let step: f64 = StandardNormal.sample(&mut random);
                walk.push(walk.last().unwrap() + 0.4 * 0.001_f64.sqrt() * step);
            }
            let load = |time_s: f64| walk[whole(time_s * 1000.0 + 1e-6).min(6000)];
            let trace = track(&plant(&[(0.0, 0.0), (0.5, 60.0)], &load, period_s, 6.0), seed);
            let [_, normal, share] = score(&trace, &load);
            squares += normal * normal / 6.0;
            covered += share / 6.0;
            rates += trace.rate_n_m_per_sqrt_s / 6.0;
        }
        assert!((0.85..1.15).contains(&squares.sqrt()), "{squares}");
        assert!((0.92..0.98).contains(&covered), "{covered}");
        assert_near(rates, 0.4, 0.25);
    }
}

#[test]
fn without_a_voltage_the_measured_current_drives_the_shaft() {
    let full = plant(&events(), &stepping, 0.001, 6.0).run(Some(3));
    let speeds = full.column(Channel::Speed).unwrap();
    let keep: Vec<usize> = (0..full.rows()).filter(|row| speeds[*row].is_finite()).collect();
    let pick = |values: &[f64]| keep.iter().map(|k| values[*k]).collect();
    let column = |channel| (channel, pick(full.column(channel).unwrap()));
    let run = run_of(pick(full.time_s()), [Channel::Current, Channel::Speed].map(column));
    let mechanical = Motor::new("mechanical")
        .with(MotorKey::TorqueConstant, PAPER[2])
        .with(MotorKey::Inertia, PAPER[3])
        .with(MotorKey::LoadTorque, PAPER[4]);
    let trace = load_torque_trace(&run, &Model::baseline(mechanical)).unwrap();
    let [rmse, _, covered] = score(&trace, &stepping);
    assert_eq!(trace.input, Input::Current);
    assert!(rmse < 0.1 && covered > 0.9, "{rmse} {covered}");
}

#[test]
fn a_load_at_rest_is_known_within_the_friction_and_no_better() {
    // 0.3 V are too little to move against the friction of 0.455 N.m, with a load of 0.2 N.m.
    let record = plant(&[(0.0, 0.0), (0.5, 0.3)], &|_| 0.2, 0.001, 2.0);
    assert!(record.speed.iter().all(|w| *w == 0.0));
    let run = record.run(Some(4));
    let model = Model::baseline(motor(&PAPER));
    let mut tracker = LoadTracker::new(&model, Input::Voltage, 0.5).unwrap();
    let last = run.samples().filter_map(|sample| tracker.push(&sample)).last().unwrap();
    let is_open = (last.load_torque_n_m - 0.2).abs() < 3.0 * last.std_n_m && last.std_n_m > 0.2;
    assert!(is_open, "{last:?}");
    assert!(matches!(load_torque_trace(&run, &model), Err(LoadError::NotObservable { .. })));
}

#[test]
fn a_value_that_is_missing_or_impossible_is_named() {
    let negative = motor(&PAPER).with(MotorKey::Inertia, -1.0);
    for (motor, rate, named) in [
        (Motor::new("empty"), 0.5, "torque_n_m_per_a"),
        (negative, 0.5, "inertia_kg_m2 = -1"),
        (motor(&PAPER), f64::NAN, "rate_n_m_per_sqrt_s"),
    ] {
        let error = LoadTracker::new(&Model::baseline(motor), Input::Voltage, rate).unwrap_err();
        assert!(error.to_string().contains(named), "{error}");
        assert!(!error.help().is_empty());
    }
}

#[test]
fn voltage_that_a_limit_of_the_drive_withheld_is_no_load() {
    let record = plant(&events(), &|_| 0.0, 0.01, 6.0);
    let model = Model::baseline(motor(&PAPER));
    let trace = load_torque_trace(&limited(&record.run(Some(5)), 3.0..5.0), &model).unwrap();
    for point in trace.points.iter().filter(|point| point.time_s > 1.0) {
        let within = point.load_torque_n_m.abs() < 5.0 * point.std_n_m;
        assert!(within && point.load_torque_n_m.abs() < 0.2, "{point:?}");
    }
    assert!(trace.notes.iter().any(|note| note.contains("limit")));
}

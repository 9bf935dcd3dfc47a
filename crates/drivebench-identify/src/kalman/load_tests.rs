//! Load tracking against an independent integrator: Runge-Kutta at 50 us with its own stick-slip.

use super::*;
use crate::testing::{self, *};
use drivebench_model::plant::Motor;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, StandardNormal};

const FINE_S: f64 = 5e-5;

/// The paper's motor under `volts(t)` and a load `load(t)`, sampled every `period_s`.
fn plant(events: &[(f64, f64)], load: &dyn Fn(f64) -> f64, period_s: f64, seconds: f64) -> Record {
    let [r, l, ke, j, mc] = PAPER;
    let (mut i, mut w) = (0.0_f64, 0.0_f64);
    let times = every(period_s, seconds);
    let (mut current, mut speed) = (vec![], vec![]);
    let mut now = 0.0;
    for &time_s in &times {
        while now < time_s - 0.5 * FINE_S {
            let volts = events[events.partition_point(|e| e.0 <= now + 1e-9) - 1].1;
            let drive = |i: f64| ke * i - load(now + 0.5 * FINE_S);
            let stuck = w == 0.0 && drive(i).abs() <= mc;
            let sign = if w == 0.0 {
                drive(i).signum()
            } else {
                w.signum()
            };
            let f = |i: f64, w: f64| {
                let turning = if stuck {
                    0.0
                } else {
                    (drive(i) - mc * sign) / j
                };
                ((volts - r * i - ke * w) / l, turning)
            };
            let h = FINE_S;
            let k1 = f(i, w);
            let k2 = f(i + 0.5 * h * k1.0, w + 0.5 * h * k1.1);
            let k3 = f(i + 0.5 * h * k2.0, w + 0.5 * h * k2.1);
            let k4 = f(i + h * k3.0, w + h * k3.1);
            i += h / 6.0 * (k1.0 + 2.0 * k2.0 + 2.0 * k3.0 + k4.0);
            let next = w + h / 6.0 * (k1.1 + 2.0 * k2.1 + 2.0 * k3.1 + k4.1);
            w = if w != 0.0 && next * w <= 0.0 {
                0.0
            } else {
                next
            };
            now += h;
        }
        current.push(i);
        speed.push(w);
    }
    Record {
        events: events.to_vec(),
        times,
        current,
        speed,
    }
}

fn track(record: &Record, seed: u64) -> LoadTrace {
    let model = Model::baseline(motor(&PAPER));
    load_torque_trace(&record.run(Some(seed)), &model).unwrap()
}

fn events() -> Vec<(f64, f64)> {
    vec![(0.0, 0.0), (0.5037, 40.0), (3.2, 55.0), (5.1, 35.0)]
}

/// Errors from a second after the start on: root mean square, that of error over standard deviation, share within 95 %.
fn score(trace: &LoadTrace, load: &dyn Fn(f64) -> f64) -> [f64; 3] {
    let mut sums = [0.0; 4];
    for point in trace.points.iter().filter(|point| point.time_s > 1.0) {
        let error = point.load_torque_n_m - load(point.time_s);
        let normal = error / point.std_n_m;
        for (sum, term) in sums.iter_mut().zip([
            1.0,
            error * error,
            normal * normal,
            f64::from(u8::from(normal.abs() < 1.96)),
        ]) {
            *sum += term;
        }
    }
    [
        (sums[1] / sums[0]).sqrt(),
        (sums[2] / sums[0]).sqrt(),
        sums[3] / sums[0],
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

/// From nothing at 2 s to 1 N.m at 4 s, and stays.
fn ramping(time_s: f64) -> f64 {
    (0.5 * (time_s - 2.0)).clamp(0.0, 1.0)
}

#[test]
fn a_stepping_load_is_followed_at_1_and_10_ms() {
    for (period_s, settling_s, rmse, quiet) in [(0.001, 0.06, 0.1, 0.08), (0.01, 0.12, 0.16, 0.12)]
    {
        let record = plant(&events(), &stepping, period_s, 6.0);
        let trace = track(&record, 1);
        let [all, normal, covered] = score(&trace, &stepping);
        // After each step: the last instant at which the error is above a quarter of the smallest step.
        let mut slowest = 0.0_f64;
        let mut steady = vec![];
        for at_s in [2.0, 3.6, 4.4] {
            for point in trace
                .points
                .iter()
                .filter(|p| (at_s..at_s + 0.7).contains(&p.time_s))
            {
                let error = point.load_torque_n_m - stepping(point.time_s);
                if error.abs() > 0.15 {
                    slowest = slowest.max(point.time_s - at_s);
                }
                if point.time_s > at_s + 0.3 {
                    steady.push(error);
                }
            }
        }
        let rms = (steady.iter().map(|e| e * e).sum::<f64>() / steady.len() as f64).sqrt();
        let mean = steady.iter().sum::<f64>() / steady.len() as f64;
        println!(
            "step {period_s}: rate {:.3} settling {slowest:.3} s rmse {all:.4} steady rms {rms:.4} mean {mean:.4} told {:.4} normalised {normal:.2} covered {covered:.3} consistency {:.2?}",
            trace.rate_n_m_per_sqrt_s,
            trace.median_std_n_m(),
            trace.consistency
        );
        assert!(slowest < settling_s, "{slowest}");
        assert!(all < rmse && rms < quiet && mean.abs() < 0.02);
        assert!(covered > 0.9, "{covered}");
    }
}

#[test]
fn a_ramping_load_is_followed_at_1_and_10_ms() {
    for (period_s, most_lag_s, rmse) in [(0.001, 0.06, 0.05), (0.01, 0.12, 0.08)] {
        let record = plant(&events(), &ramping, period_s, 6.0);
        let trace = track(&record, 2);
        let [all, normal, covered] = score(&trace, &ramping);
        let on_ramp: Vec<f64> = trace
            .points
            .iter()
            .filter(|p| (2.4..3.9).contains(&p.time_s))
            .map(|p| ramping(p.time_s) - p.load_torque_n_m)
            .collect();
        // The load rises by 0.5 N.m/s.
        let lag_s = on_ramp.iter().sum::<f64>() / on_ramp.len() as f64 / 0.5;
        println!(
            "ramp {period_s}: rate {:.3} lag {lag_s:.4} s rmse {all:.4} told {:.4} normalised {normal:.2} covered {covered:.3}",
            trace.rate_n_m_per_sqrt_s,
            trace.median_std_n_m()
        );
        assert!(lag_s.abs() < most_lag_s && all < rmse, "{lag_s} {all}");
        assert!(covered > 0.85, "{covered}");
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
            let load = |time_s: f64| {
                walk[drivebench_model::numerics::count::whole(time_s * 1000.0 + 1e-6).min(6000)]
            };
            let record = plant(&[(0.0, 0.0), (0.5, 60.0)], &load, period_s, 6.0);
            let trace = track(&record, seed);
            let [_, normal, share] = score(&trace, &load);
            squares += normal * normal / 6.0;
            covered += share / 6.0;
            rates += trace.rate_n_m_per_sqrt_s / 6.0;
        }
        println!(
            "walk {period_s}: normalised {:.3} covered {covered:.3} rate {rates:.3}",
            squares.sqrt()
        );
        assert!((0.85..1.15).contains(&squares.sqrt()), "{squares}");
        assert!((0.92..0.98).contains(&covered), "{covered}");
        assert!((rates / 0.4 - 1.0).abs() < 0.25, "{rates}");
    }
}

#[test]
fn current_alone_drives_the_shaft_where_there_is_no_voltage() {
    let record = plant(&events(), &stepping, 0.001, 6.0);
    let full = record.run(Some(3));
    let keep: Vec<usize> = (0..full.rows())
        .filter(|row| full.column(Channel::Speed).unwrap()[*row].is_finite())
        .collect();
    let pick = |values: &[f64]| keep.iter().map(|k| values[*k]).collect();
    let column = |channel| (channel, pick(full.column(channel).unwrap()));
    let run = run_of(
        pick(full.time_s()),
        [column(Channel::Current), column(Channel::Speed)],
    );
    let mut model = Model::baseline(motor(&PAPER));
    for key in [
        MotorKey::Resistance,
        MotorKey::Inductance,
        MotorKey::BackEmf,
    ] {
        model.motor.clear(key);
    }
    model.motor.set(MotorKey::TorqueConstant, PAPER[2]);
    let trace = load_torque_trace(&run, &model).unwrap();
    let [rmse, normal, covered] = score(&trace, &stepping);
    println!("current: rmse {rmse:.4} normalised {normal:.2} covered {covered:.3}");
    assert_eq!(trace.input, Input::Current);
    assert!(rmse < 0.1 && covered > 0.9, "{rmse} {covered}");
}

#[test]
fn a_load_at_rest_is_known_within_the_friction_and_no_better() {
    // 0.3 V drive too little to move; a load of 0.2 N.m leans against the friction of 0.455 N.m.
    let record = plant(&[(0.0, 0.0), (0.5, 0.3)], &|_| 0.2, 0.001, 2.0);
    assert!(record.speed.iter().all(|w| *w == 0.0));
    let run = record.run(Some(4));
    let model = Model::baseline(motor(&PAPER));
    let mut tracker = LoadTracker::new(&model, Input::Voltage, 0.5).unwrap();
    let last = run
        .samples()
        .filter_map(|sample| tracker.push(&sample))
        .last()
        .unwrap();
    println!("rest {last:?}");
    assert!((last.load_torque_n_m - 0.2).abs() < 3.0 * last.std_n_m);
    assert!(last.std_n_m > 0.2, "{last:?}");
    assert!(matches!(
        load_torque_trace(&run, &model),
        Err(LoadError::NothingSeen { .. })
    ));
}

#[test]
fn what_is_missing_or_impossible_is_named() {
    let model = Model::baseline(Motor::new("empty"));
    let error = LoadTracker::new(&model, Input::Voltage, 0.5).unwrap_err();
    assert!(error.to_string().contains("torque_n_m_per_a") && !error.help().is_empty());
    let motor = motor(&PAPER).with(MotorKey::Inertia, -1.0);
    let error = LoadTracker::new(&Model::baseline(motor), Input::Voltage, 0.5).unwrap_err();
    assert!(error.to_string().contains("inertia_kg_m2 = -1"), "{error}");
    let good = Model::baseline(testing::motor(&PAPER));
    assert!(LoadTracker::new(&good, Input::Voltage, f64::NAN).is_err());
    let record = plant(&events(), &stepping, 0.01, 1.0);
    let scenario = Scenario::from_run(&record.run(None)).unwrap();
    assert_eq!(scenario.input, Input::Voltage);
}

#[test]
fn what_a_limit_of_the_drive_kept_from_the_motor_is_no_load() {
    let record = plant(&events(), &|_| 0.0, 0.01, 6.0);
    let model = Model::baseline(motor(&PAPER));
    let run = limited(&record.run(Some(5)), 3.0..5.0);
    let trace = load_torque_trace(&run, &model).unwrap();
    for point in trace.points.iter().filter(|point| point.time_s > 1.0) {
        let within = point.load_torque_n_m.abs() < 5.0 * point.std_n_m;
        assert!(within && point.load_torque_n_m.abs() < 0.2, "{point:?}");
    }
    assert!(trace.notes.iter().any(|note| note.contains("limit")));
}

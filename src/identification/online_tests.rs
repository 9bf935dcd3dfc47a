//! On-line identification against the simulated motor of paper A.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};

use super::*;
use crate::plant::{Input, Motor, Plant, Scenario, State};
use crate::sample::Verdict;

/// R, L, Ke, J, Mc of `Motor::zk_22fc`.
const TRUTH: [f64; 5] = [1.1, 0.0099, 0.3538, 0.0045, 0.455];

/// Voltage steps that hold 60 to 110 ms and jump at odd instants between samples, after 0.3 s at rest.
fn steps(seconds: f64) -> Vec<(f64, f64)> {
    let levels = [
        20.0, 35.0, 15.0, 60.0, 30.0, 45.0, 25.0, -30.0, -50.0, -20.0, 10.0, 70.0,
    ];
    let mut events = vec![(0.0, 0.0)];
    let mut at_s = 0.3037;
    for step in 0.. {
        if at_s > seconds {
            break;
        }
        events.push((at_s, levels[step % levels.len()]));
        at_s += 0.0613 + 0.0471 * (step % 3) as f64 / 2.0;
    }
    events
}

struct Bench {
    events: Vec<(f64, f64)>,
    times: Vec<f64>,
    current: Vec<f64>,
    speed: Vec<f64>,
}

impl Bench {
    fn new(events: Vec<(f64, f64)>, times: Vec<f64>) -> Self {
        Self::of(Motor::zk_22fc(), events, times)
    }

    fn of(motor: Motor, events: Vec<(f64, f64)>, times: Vec<f64>) -> Self {
        let scenario = Scenario {
            name: "r".into(),
            input: Input::Voltage,
            input_channel: Channel::VoltageCmd,
            events: events.clone(),
            unknown_input: vec![],
            scored: 0..times.len(),
            sample_time_s: times.clone(),
            current_a: vec![],
            speed_rad_s: vec![],
            angle: vec![],
            time_half_width_s: vec![],
        };
        let out = Plant::new(&Model::baseline(motor), Input::Voltage)
            .unwrap()
            .simulate(&scenario, State::default());
        Self {
            events,
            times,
            current: out.current_a,
            speed: out.speed_rad_s,
        }
    }

    fn regular(events: Vec<(f64, f64)>, period_s: f64, seconds: f64) -> Self {
        Self::new(events, every(period_s, seconds))
    }

    /// Bench noise, then the quantisation of registers: 1 mA and 0.01 rad/s.
    fn noisy(&self, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut add = |values: &[f64], sigma: f64, quantum: f64| -> Vec<f64> {
            let normal = Normal::new(0.0, sigma).unwrap();
            values
                .iter()
                .map(|x| ((x + normal.sample(&mut random)) / quantum).round() * quantum)
                .collect()
        };
        let current = add(&self.current, 0.03, 1e-3);
        (current, add(&self.speed, 0.15, 0.01))
    }

    /// Feeds everything in the order of time, commands as rows of their own.
    fn feed(&self, online: &mut Online, current: &[f64], speed: &[f64]) {
        let mut events = self.events.iter().peekable();
        for (k, &time_s) in self.times.iter().enumerate() {
            while let Some(&&(at_s, volts)) = events.peek().filter(|event| event.0 <= time_s) {
                online.push(&Sample::at(at_s).with(Channel::VoltageCmd, volts));
                events.next();
            }
            let sample = Sample::at(time_s)
                .with(Channel::Current, current[k])
                .with(Channel::Speed, speed[k]);
            online.push(&sample);
        }
    }

    fn run(&self, config: OnlineConfig) -> Online {
        let mut online = Online::new(config);
        self.feed(&mut online, &self.current, &self.speed);
        online
    }
}

fn errors(estimates: &[ParameterEstimate], truth: &[f64]) -> Vec<f64> {
    estimates
        .iter()
        .zip(truth)
        .map(|(e, t)| e.value.map_or(f64::NAN, |v| v / t - 1.0))
        .collect()
}

#[test]
fn without_noise_every_parameter_is_found_at_1_to_20_ms() {
    // Largest error of any of the five.
    for (period_s, limit) in [(0.001, 0.002), (0.005, 0.005), (0.01, 0.01), (0.02, 0.05)] {
        let online = Bench::regular(steps(6.0), period_s, 6.0).run(OnlineConfig::default());
        let found = errors(&online.estimates(), &TRUTH);
        println!(
            "{period_s} {found:.5?} scheme 2 {:.4?}",
            errors(&online.scheme_2(), &TRUTH[3..])
        );
        assert!(
            found.iter().all(|e| e.abs() < limit),
            "{period_s} {found:?}"
        );
    }
}

/// Bias and coverage of the nominal 95 % intervals over 40 seeds: scheme 3, then scheme 2.
fn seeds(period_s: f64, seconds: f64, config: OnlineConfig) -> ([f64; 7], [u32; 7]) {
    let bench = Bench::regular(steps(seconds), period_s, seconds);
    let (mut bias, mut squares, mut stds, mut covered) = ([0.0; 7], [0.0; 7], [0.0; 7], [0; 7]);
    let truth: Vec<f64> = TRUTH.iter().chain(&TRUTH[3..]).copied().collect();
    for seed in 0..40 {
        let (current, speed) = bench.noisy(seed);
        let mut online = Online::new(config);
        bench.feed(&mut online, &current, &speed);
        let estimates = [online.estimates(), online.scheme_2()].concat();
        for (j, estimate) in estimates.iter().enumerate() {
            let (value, std) = (estimate.value.unwrap(), estimate.std.unwrap());
            let error = value / truth[j] - 1.0;
            bias[j] += error / 40.0;
            squares[j] += error * error / 40.0;
            stds[j] += std / truth[j] / 40.0;
            covered[j] += u32::from((value - truth[j]).abs() < 1.96 * std);
        }
    }
    let spread: Vec<f64> = (0..7)
        .map(|j| (squares[j] - bias[j] * bias[j]).sqrt())
        .collect();
    println!(
        "T {period_s} over {seconds} s bias {bias:.4?}\n  spread {spread:.4?}\n  std    {stds:.4?}\n  covered {covered:?}"
    );
    (bias, covered)
}

#[test]
fn bench_noise_leaves_little_bias_and_intervals_that_cover() {
    for seconds in [2.0, 6.0] {
        let (bias, covered) = seeds(0.001, seconds, OnlineConfig::default());
        assert!(bias.iter().all(|b| b.abs() < 0.005), "{bias:?}");
        assert!(covered.iter().all(|c| *c >= 32), "{covered:?}");
    }
    for seconds in [2.0, 6.0] {
        let (bias, covered) = seeds(0.01, seconds, OnlineConfig::default());
        assert!(covered[..5].iter().all(|c| *c >= 32), "{covered:?}");
        assert!(bias[..5].iter().all(|b| b.abs() < 0.01), "{bias:?}");
    }
}

#[test]
fn a_first_guess_that_is_far_off_is_left_behind() {
    let motor = Motor::new("guess")
        .with(MotorKey::Resistance, 2.5)
        .with(MotorKey::Inductance, 0.004)
        .with(MotorKey::BackEmf, 0.25);
    let config = OnlineConfig::from_model(&Model::baseline(motor));
    assert!(config.start.is_some());
    for period_s in [0.001, 0.01] {
        let online = Bench::regular(steps(12.0), period_s, 12.0).run(config);
        let found = errors(&online.estimates(), &TRUTH);
        println!("far start {period_s} {found:.5?}");
        assert!(found.iter().all(|e| e.abs() < 0.02), "{found:?}");
    }
}

#[test]
fn at_standstill_nothing_is_claimed_and_the_reason_has_numbers() {
    let bench = Bench::regular(vec![(0.0, 0.0)], 0.001, 2.0);
    let (current, speed) = bench.noisy(1);
    for config in [
        OnlineConfig::default(),
        OnlineConfig::from_model(&Model::baseline(Motor::zk_22fc())),
    ] {
        let mut online = Online::new(config);
        bench.feed(&mut online, &current, &speed);
        for estimate in [online.estimates(), online.scheme_2()].concat() {
            println!("standstill {estimate:?}");
            assert_eq!(estimate.verdict, Verdict::NotObservable, "{estimate:?}");
            let reason = estimate.reason.unwrap();
            assert!(reason.contains(|c: char| c.is_ascii_digit()), "{reason}");
        }
        assert_eq!(online.innovation().map(|i| i.1), None);
    }
}

#[test]
fn a_long_constant_voltage_keeps_what_was_learnt() {
    let mut events = steps(4.0);
    events.push((4.2, 40.0));
    let bench = Bench::regular(events, 0.001, 60.0);
    let (current, speed) = bench.noisy(2);
    let mut online = Online::new(OnlineConfig::default());
    bench.feed(&mut online, &current, &speed);
    let found = errors(&online.estimates(), &TRUTH);
    println!("constant {found:.5?} {:?}", online.excitation());
    assert!(found.iter().all(|e| e.abs() < 0.01), "{found:?}");
}

#[test]
fn constant_voltage_from_the_start_settles_no_inductance() {
    // The motor turns already when the first sample comes: nothing but steady state.
    let bench = Bench::regular(vec![(0.0, 40.0)], 0.001, 4.0);
    let (current, speed) = bench.noisy(3);
    let mut online = Online::new(OnlineConfig::default());
    for k in 1000..bench.times.len() {
        online.push(
            &Sample::at(bench.times[k])
                .with(Channel::Voltage, 40.0)
                .with(Channel::Current, current[k])
                .with(Channel::Speed, speed[k]),
        );
    }
    for estimate in online.estimates() {
        println!("steady {estimate:?}");
        assert_ne!(estimate.verdict, Verdict::Settled, "{estimate:?}");
    }
}

#[test]
fn irregular_stamps_and_late_tellings_change_little_and_the_bits_repeat() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let jitter = Normal::new(0.0, 0.0008).unwrap();
    let times: Vec<f64> = (0..1200)
        .map(|k| 0.005 * f64::from(k) + f64::clamp(jitter.sample(&mut random), -0.002, 0.002))
        .collect();
    let bench = Bench::new(steps(6.0), times);
    let online = bench.run(OnlineConfig::default());
    let found = errors(&online.estimates(), &TRUTH);
    println!("irregular {found:.5?}");
    assert!(found.iter().all(|e| e.abs() < 0.01), "{found:?}");

    // The live door: each command is told just before the first sample after it.
    let mut live = Online::new(OnlineConfig::default());
    let mut events = bench.events.iter().peekable();
    for (k, &time_s) in bench.times.iter().enumerate() {
        while let Some(&&(at_s, volts)) = events.peek().filter(|event| event.0 <= time_s) {
            live.command_applied(at_s, volts);
            events.next();
        }
        live.push(
            &Sample::at(time_s)
                .with(Channel::Current, bench.current[k])
                .with(Channel::Speed, bench.speed[k]),
        );
    }
    assert_eq!(live.estimates(), online.estimates());
    assert_eq!(live.innovation(), online.innovation());
}

fn every(period_s: f64, seconds: f64) -> Vec<f64> {
    (0..u32::MAX)
        .map(|k| f64::from(k) * period_s)
        .take_while(|time_s| *time_s < seconds - 0.5 * period_s)
        .collect()
}

#[test]
fn a_small_fast_motor_is_found_too() {
    let truth = [2.0, 0.002, 0.05, 1e-5, 0.01];
    let motor = Motor::new("small")
        .with(MotorKey::Resistance, truth[0])
        .with(MotorKey::Inductance, truth[1])
        .with(MotorKey::BackEmf, truth[2])
        .with(MotorKey::Inertia, truth[3])
        .with(MotorKey::LoadTorque, truth[4]);
    let volts = steps(6.0).into_iter().map(|(t, u)| (t, u / 5.0)).collect();
    // L/R is 1 ms, R J/Ke^2 is 8 ms.
    for (period_s, limit) in [(0.0005, 0.01), (0.001, 0.02)] {
        let bench = Bench::of(motor.clone(), Vec::clone(&volts), every(period_s, 6.0));
        let found = errors(&bench.run(OnlineConfig::default()).estimates(), &truth);
        println!("small {period_s} {found:.5?}");
        assert!(found.iter().all(|e| e.abs() < limit), "{found:?}");
    }
}

#[test]
fn a_hotter_winding_and_twice_the_inertia_are_followed() {
    let changed = Motor::zk_22fc()
        .with(MotorKey::Resistance, 1.43)
        .with(MotorKey::Inertia, 0.009);
    for period_s in [0.001, 0.01] {
        let mut online = Bench::regular(steps(4.0), period_s, 4.0).run(OnlineConfig::default());
        let mut bench = Bench::of(changed.clone(), steps(8.0), every(period_s, 8.0));
        bench.times.iter_mut().for_each(|t| *t += 5.0);
        bench.events.iter_mut().for_each(|e| e.0 += 5.0);
        bench.feed(&mut online, &bench.current, &bench.speed);
        let found = errors(&online.estimates(), &[1.43, 0.0099, 0.3538, 0.009, 0.455]);
        println!("changed {period_s} {found:.5?}");
        assert!(found.iter().all(|e| e.abs() < 0.05), "{found:?}");
    }
}

#[test]
fn an_inductance_that_is_gone_between_two_samples_is_not_claimed() {
    // L/R = 0.4 ms against a period of 10 ms.
    let fast = Motor::zk_22fc().with(MotorKey::Inductance, 0.000_44);
    for seed in 0..8 {
        let bench = Bench::of(fast.clone(), steps(6.0), every(0.01, 6.0));
        let (current, speed) = bench.noisy(seed);
        let mut online = Online::new(OnlineConfig::default());
        bench.feed(&mut online, &current, &speed);
        let estimates = online.estimates();
        let inductance = &estimates[1];
        assert_eq!(inductance.verdict, Verdict::NotObservable, "{inductance:?}");
        assert_eq!((inductance.value, inductance.std), (None, None));
    }
}

/// What a settled parameter misses the truth by, in its standard deviations; names of those that miss by more than three.
fn settled_and_wrong(online: &Online, truth: [f64; 5]) -> Vec<String> {
    online
        .estimates()
        .iter()
        .zip(truth)
        .filter(|(estimate, truth)| {
            estimate.verdict == Verdict::Settled
                && (estimate.value.unwrap() - truth).abs() > 3.0 * estimate.std.unwrap()
        })
        .map(|(estimate, truth)| format!("{truth} {estimate:?}"))
        .collect()
}

#[test]
fn while_a_limit_of_the_drive_holds_its_output_nothing_is_learnt_or_settled() {
    let bench = Bench::regular(steps(6.0), 0.01, 6.0);
    for seed in 0..5 {
        let (current, speed) = bench.noisy(seed);
        let mut online = Online::new(OnlineConfig::default());
        let limited = 3.0..5.0;
        let mut events = bench.events.iter().peekable();
        let mut before = Vec::new();
        for (k, &time_s) in bench.times.iter().enumerate() {
            while let Some(&&(at_s, volts)) = events.peek().filter(|event| event.0 <= time_s) {
                // The limit leaves the motor another voltage than was commanded.
                let asked = if limited.contains(&at_s) {
                    0.6 * volts
                } else {
                    volts
                };
                online.push(&Sample::at(at_s).with(Channel::VoltageCmd, asked));
                events.next();
            }
            let mut sample = Sample::at(time_s)
                .with(Channel::Current, current[k])
                .with(Channel::Speed, speed[k]);
            sample.limited = (limited.start - 0.02..limited.end + 0.12).contains(&time_s);
            online.push(&sample);
            if sample.limited && time_s > limited.start {
                let verdicts: Vec<Verdict> = online.estimates().iter().map(|e| e.verdict).collect();
                assert!(
                    !verdicts.contains(&Verdict::Settled),
                    "{time_s} {verdicts:?}"
                );
            }
            if (2.95..2.96).contains(&time_s) {
                before = online.estimates();
            }
        }
        assert_eq!(before[0].verdict, Verdict::Settled);
        let wrong = settled_and_wrong(&online, TRUTH);
        assert!(wrong.len() <= 1, "{seed} {wrong:?}");
        assert_eq!(online.estimates()[0].verdict, Verdict::Settled);
        let error = online.estimates()[0].value.unwrap() / TRUTH[0] - 1.0;
        assert!(error.abs() < 0.02, "{seed} {error}");
    }
}

#[test]
fn an_inertia_that_changes_is_never_settled_at_what_lies_between() {
    let moves = |factor: f64| {
        let mut motor = Motor::zk_22fc();
        motor.set(MotorKey::Inertia, factor * TRUTH[3]);
        let mut events = steps(4.0);
        events.push((4.0, 0.0));
        Bench::of(motor, events, every(0.01, 6.0))
    };
    for factor in [0.25, 0.5, 2.0, 5.0] {
        let (first, second) = (moves(1.0), moves(factor));
        let mut online = Online::new(OnlineConfig::default());
        let (current, speed) = first.noisy(1);
        first.feed(&mut online, &current, &speed);
        let (current, speed) = second.noisy(2);
        let truth = [TRUTH[0], TRUTH[1], TRUTH[2], factor * TRUTH[3], TRUTH[4]];
        let mut settled = 0;
        let mut events = second.events.iter().peekable();
        for (k, &time_s) in second.times.iter().enumerate() {
            while let Some(&&(at_s, volts)) = events.peek().filter(|event| event.0 <= time_s) {
                online.push(&Sample::at(6.0 + at_s).with(Channel::VoltageCmd, volts));
                events.next();
            }
            online.push(
                &Sample::at(6.0 + time_s)
                    .with(Channel::Current, current[k])
                    .with(Channel::Speed, speed[k]),
            );
            // Nothing moves, and so nothing can have been noticed, before the first step.
            if time_s > 0.6 && k % 10 == 0 {
                let inertia = online.estimates().swap_remove(3);
                if inertia.verdict == Verdict::Settled {
                    settled += 1;
                    let miss = (inertia.value.unwrap() - truth[3]).abs() / inertia.std.unwrap();
                    assert!(miss < 5.0, "{factor} {time_s} {inertia:?}");
                }
            }
        }
        assert!(settled > 20, "{factor}: settled {settled} times");
    }
}

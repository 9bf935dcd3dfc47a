//! On-line identification against the simulated motor of paper A.

use super::*;
use crate::testing::{self, *};
use drivebench_model::plant::Motor;
use drivebench_model::sample::Verdict;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};

/// Voltage steps that hold 60 to 110 ms and jump at odd instants between samples, after 0.3 s at rest.
fn steps(seconds: f64) -> Vec<(f64, f64)> {
    testing::steps(0.3037, seconds, 1.0, 0.0613)
}

fn regular(events: Vec<(f64, f64)>, period_s: f64, seconds: f64) -> Record {
    Record::of(&paper(), events, every(period_s, seconds))
}

fn feed(record: &Record, online: &mut Online, [current, speed]: &[Vec<f64>; 2]) {
    in_order(&record.events, &record.times, [current, speed], |sample| {
        online.push(&sample);
    });
}

fn run(record: &Record, config: OnlineConfig) -> Online {
    let mut online = Online::new(config);
    let read = [record.current.clone(), record.speed.clone()];
    feed(record, &mut online, &read);
    online
}

/// With the noise of a seed, from nothing.
fn run_noisy(record: &Record, seed: u64) -> Online {
    let mut online = Online::new(OnlineConfig::default());
    feed(record, &mut online, &record.noisy(seed));
    online
}

#[test]
fn without_noise_every_parameter_is_found() {
    for (name, truth, scale, period_s, within) in [
        ("paper", PAPER, 1.0, 0.001, 0.002),
        ("paper", PAPER, 1.0, 0.005, 0.005),
        ("paper", PAPER, 1.0, 0.01, 0.01),
        ("paper", PAPER, 1.0, 0.02, 0.05),
        ("small", SMALL, 0.2, 0.0005, 0.01),
        ("small", SMALL, 0.2, 0.001, 0.02),
    ] {
        let events = testing::steps(0.3037, 6.0, scale, 0.0613);
        let bench = Record::of(&Model::baseline(motor(&truth)), events, every(period_s, 6.0));
        assert_all(
            &format!("{name} {period_s}"),
            &run(&bench, OnlineConfig::default()).estimates(),
            &truth,
            within,
        );
    }
}

#[test]
fn bench_noise_leaves_little_bias_and_intervals_that_cover() {
    let [r, l, ke, j, mc] = PAPER;
    // Scheme 3, then scheme 2, which is judged where the current between samples is known.
    for (period_s, judged, limit) in [(0.001, 7, 0.005), (0.01, 5, 0.01)] {
        for seconds in [2.0, 6.0] {
            let bench = regular(steps(seconds), period_s, seconds);
            let of_seed = |seed| {
                let online = run_noisy(&bench, seed);
                [online.estimates(), online.scheme_2()].concat()
            };
            let estimates: Vec<_> = (0..40).map(of_seed).collect();
            let found = Statistics::over(estimates.iter(), &[r, l, ke, j, mc, j, mc]);
            assert_eq!(found.missing, 0);
            let (bias, covered) = (&found.bias[..judged], &found.covered[..judged]);
            assert!(bias.iter().all(|b| b.abs() < limit), "{bias:?}");
            assert!(covered.iter().all(|share| *share >= 0.8), "{covered:?}");
        }
    }
}

#[test]
fn a_wrong_first_guess_is_left_and_a_changed_motor_followed() {
    let guess = Motor::new("guess")
        .with(MotorKey::Resistance, 2.5)
        .with(MotorKey::Inductance, 0.004)
        .with(MotorKey::BackEmf, 0.25);
    let config = OnlineConfig::from_model(&Model::baseline(guess));
    assert!(config.start.is_some());
    // A hotter winding and twice the inertia.
    let hot = [1.43, 0.0099, 0.3538, 0.009, 0.455];
    let changed = Model::baseline(motor(&hot));
    for period_s in [0.001, 0.01] {
        let online = run(&regular(steps(12.0), period_s, 12.0), config);
        assert_all("far start", &online.estimates(), &PAPER, 0.02);
        let mut online = run(&regular(steps(4.0), period_s, 4.0), OnlineConfig::default());
        let mut bench = Record::of(&changed, steps(8.0), every(period_s, 8.0));
        bench.times.iter_mut().for_each(|t| *t += 5.0);
        bench.events.iter_mut().for_each(|e| e.0 += 5.0);
        let read = [bench.current.clone(), bench.speed.clone()];
        feed(&bench, &mut online, &read);
        assert_all("changed", &online.estimates(), &hot, 0.05);
    }
}

#[test]
fn at_standstill_nothing_is_claimed_and_the_reason_has_numbers() {
    let bench = regular(vec![(0.0, 0.0)], 0.001, 2.0);
    for config in [OnlineConfig::default(), OnlineConfig::from_model(&paper())] {
        let mut online = Online::new(config);
        feed(&bench, &mut online, &bench.noisy(1));
        for estimate in [online.estimates(), online.scheme_2()].concat() {
            assert_eq!(estimate.verdict, Verdict::NotObservable, "{estimate:?}");
            let reason = estimate.reason.unwrap();
            assert!(reason.contains(|c: char| c.is_ascii_digit()), "{reason}");
        }
        assert_eq!(online.innovation().map(|i| i.1), None);
    }
}

#[test]
fn a_constant_voltage_keeps_values_and_settles_nothing_new() {
    let mut events = steps(4.0);
    events.push((4.2, 40.0));
    let online = run_noisy(&regular(events, 0.001, 60.0), 2);
    assert_all("after steps", &online.estimates(), &PAPER, 0.01);
    // The motor turns already when the first sample comes: nothing but steady state.
    let bench = regular(vec![(0.0, 40.0)], 0.001, 4.0);
    let [current, speed] = bench.noisy(3);
    let mut online = Online::new(OnlineConfig::default());
    for k in 1000..bench.times.len() {
        let sample = Sample::at(bench.times[k]).with(Channel::Voltage, 40.0);
        online.push(&sample.with(Channel::Current, current[k]).with(Channel::Speed, speed[k]));
    }
    for estimate in online.estimates() {
        assert_ne!(estimate.verdict, Verdict::Settled, "{estimate:?}");
    }
}

#[test]
fn jittered_stamps_change_little_and_separate_commands_no_bit() {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let jitter = Normal::new(0.0, 0.0008).unwrap();
    let late = |k| 0.005 * f64::from(k) + f64::clamp(jitter.sample(&mut random), -0.002, 0.002);
    let bench = Record::of(&paper(), steps(6.0), (0..1200).map(late).collect());
    let online = run(&bench, OnlineConfig::default());
    assert_all("jittered", &online.estimates(), &PAPER, 0.01);
    // As the live bench does it: each command is given just before the first sample after it.
    let mut live = Online::new(OnlineConfig::default());
    let read = [&bench.current[..], &bench.speed];
    in_order(&bench.events, &bench.times, read, |sample| match sample.get(Channel::VoltageCmd) {
        Some(volts) => live.command_applied(sample.time_s, volts),
        None => live.push(&sample),
    });
    assert_eq!(live.estimates(), online.estimates());
    assert_eq!(live.innovation(), online.innovation());
}

#[test]
fn an_inductance_gone_between_two_samples_is_not_claimed() {
    // L/R = 0.4 ms against a period of 10 ms.
    let fast = Motor::zk_22fc().with(MotorKey::Inductance, 0.000_44);
    let bench = Record::of(&Model::baseline(fast), steps(6.0), every(0.01, 6.0));
    for seed in 0..8 {
        let inductance = run_noisy(&bench, seed).estimates().swap_remove(1);
        assert_eq!(inductance.verdict, Verdict::NotObservable, "{inductance:?}");
        assert_eq!((inductance.value, inductance.std), (None, None));
    }
}

#[test]
fn at_a_limit_of_the_drive_nothing_is_learnt_or_settled() {
    let bench = regular(steps(6.0), 0.01, 6.0);
    for seed in 0..5 {
        let read = bench.noisy(seed);
        let mut online = Online::new(OnlineConfig::default());
        let limited = 3.0..5.0;
        let mut before = None;
        let read = [&read[0][..], &read[1]];
        in_order(&bench.events, &bench.times, read, |mut sample| {
            let time_s = sample.time_s;
            if let Some(volts) = sample.get(Channel::VoltageCmd) {
                // The limit leaves the motor another voltage than was commanded.
                let share = if limited.contains(&time_s) { 0.6 } else { 1.0 };
                online.push(&Sample::at(time_s).with(Channel::VoltageCmd, share * volts));
                return;
            }
            sample.limited = (limited.start - 0.02..limited.end + 0.12).contains(&time_s);
            online.push(&sample);
            assert_eq!(online.frozen().since_s.is_some(), sample.limited);
            if sample.limited && time_s > limited.start {
                let now = online.estimates();
                assert!(!now.iter().any(|e| e.verdict == Verdict::Settled), "{time_s} {now:?}");
            }
            if (2.95..2.96).contains(&time_s) {
                before = Some(online.estimates()[0].verdict);
            }
        });
        assert_eq!(before, Some(Verdict::Settled));
        // Learning goes on by itself.
        let frozen = online.frozen();
        assert_eq!(frozen.since_s, None);
        assert!((2.1..2.2).contains(&frozen.seconds), "{frozen:?}");
        assert!((205..225).contains(&frozen.rows), "{frozen:?}");
        let estimates = online.estimates();
        let wrong = estimates.iter().zip(PAPER).filter(|(estimate, truth)| {
            estimate.verdict == Verdict::Settled && !covers(estimate, *truth, 3.0)
        });
        assert!(wrong.count() <= 1, "{seed} {estimates:?}");
        assert_eq!(estimates[0].verdict, Verdict::Settled);
        assert_near(estimates[0].value.unwrap(), PAPER[0], 0.02);
    }
}

#[test]
fn a_changing_inertia_is_never_settled_at_a_value_between() {
    let moves = |factor: f64| {
        let motor = Motor::zk_22fc().with(MotorKey::Inertia, factor * PAPER[3]);
        let mut events = steps(4.0);
        events.push((4.0, 0.0));
        Record::of(&Model::baseline(motor), events, every(0.01, 6.0))
    };
    for factor in [0.25, 0.5, 2.0, 5.0] {
        let (first, second) = (moves(1.0), moves(factor));
        let mut online = run_noisy(&first, 1);
        let read = second.noisy(2);
        let truth = factor * PAPER[3];
        let (mut settled, mut sample_number) = (0, 0);
        let read = [&read[0][..], &read[1]];
        in_order(&second.events, &second.times, read, |mut sample| {
            let time_s = sample.time_s;
            sample.time_s += 6.0;
            online.push(&sample);
            if sample.get(Channel::Speed).is_none() {
                return;
            }
            sample_number += 1;
            // Nothing moves, and so nothing can have been noticed, before the first step.
            if time_s > 0.6 && sample_number % 10 == 1 {
                let inertia = online.estimates().swap_remove(3);
                if inertia.verdict == Verdict::Settled {
                    settled += 1;
                    assert!(covers(&inertia, truth, 5.0), "{factor} {time_s} {inertia:?}");
                }
            }
        });
        assert!(settled > 20, "{factor}: settled {settled} times");
    }
}

//! On-line identification against the simulated motor of paper A.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};

use super::*;
use crate::testing::{self, *};
use drivebench_model::plant::Motor;
use drivebench_model::sample::Verdict;

/// Voltage steps that hold 60 to 110 ms and jump at odd instants between samples, after 0.3 s at rest.
fn steps(seconds: f64) -> Vec<(f64, f64)> {
    testing::steps(0.3037, seconds, 1.0, 0.0613)
}

fn regular(events: Vec<(f64, f64)>, period_s: f64, seconds: f64) -> Record {
    Record::of(&paper(), events, every(period_s, seconds))
}

/// Feeds everything in the order of time, commands as rows of their own.
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

#[track_caller]
fn is_found_without_noise(name: &str, truth: &Truth, scale: f64, period_s: f64, limit: f64) {
    let events = testing::steps(0.3037, 6.0, scale, 0.0613);
    let bench = Record::of(&Model::baseline(motor(truth)), events, every(period_s, 6.0));
    let online = run(&bench, OnlineConfig::default());
    let found = errors(&online.estimates(), truth);
    let by_scheme_2 = errors(&online.scheme_2(), &truth[3..]);
    println!("{name} {period_s} {found:.5?} scheme 2 {by_scheme_2:.4?}");
    assert!(
        found.iter().all(|e| e.abs() < limit),
        "{name} {period_s} {found:?}"
    );
}

#[test]
fn without_noise_every_parameter_is_found_at_1_to_20_ms() {
    // Largest error of any of the five.
    for (period_s, limit) in [(0.001, 0.002), (0.005, 0.005), (0.01, 0.01), (0.02, 0.05)] {
        is_found_without_noise("paper", &PAPER, 1.0, period_s, limit);
    }
}

#[test]
fn a_small_fast_motor_is_found_too() {
    for (period_s, limit) in [(0.0005, 0.01), (0.001, 0.02)] {
        is_found_without_noise("small", &SMALL, 0.2, period_s, limit);
    }
}

/// Bias and coverage of the nominal 95 % intervals over 40 seeds: scheme 3, then scheme 2.
fn seeds(period_s: f64, seconds: f64) -> Statistics<7> {
    let bench = regular(steps(seconds), period_s, seconds);
    let [r, l, ke, j, mc] = PAPER;
    let of_seed = |seed| {
        let online = run_noisy(&bench, seed);
        [online.estimates(), online.scheme_2()].concat()
    };
    let estimates: Vec<_> = (0..40).map(of_seed).collect();
    let found = Statistics::over(estimates.iter(), &[r, l, ke, j, mc, j, mc]);
    println!("T {period_s} over {seconds} s: {found:.4?}");
    assert_eq!(found.missing, 0);
    found
}

#[test]
fn bench_noise_leaves_little_bias_and_intervals_that_cover() {
    for (period_s, judged, limit) in [(0.001, 7, 0.005), (0.01, 5, 0.01)] {
        for seconds in [2.0, 6.0] {
            let Statistics { bias, covered, .. } = seeds(period_s, seconds);
            let (bias, covered) = (&bias[..judged], &covered[..judged]);
            assert!(bias.iter().all(|b| b.abs() < limit), "{bias:?}");
            assert!(covered.iter().all(|share| *share >= 0.8), "{covered:?}");
        }
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
        let online = run(&regular(steps(12.0), period_s, 12.0), config);
        let found = errors(&online.estimates(), &PAPER);
        println!("far start {period_s} {found:.5?}");
        assert!(found.iter().all(|e| e.abs() < 0.02), "{found:?}");
    }
}

#[test]
fn at_standstill_nothing_is_claimed_and_the_reason_has_numbers() {
    let bench = regular(vec![(0.0, 0.0)], 0.001, 2.0);
    for config in [
        OnlineConfig::default(),
        OnlineConfig::from_model(&Model::baseline(Motor::zk_22fc())),
    ] {
        let mut online = Online::new(config);
        feed(&bench, &mut online, &bench.noisy(1));
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
    let online = run_noisy(&regular(events, 0.001, 60.0), 2);
    let found = errors(&online.estimates(), &PAPER);
    println!("constant {found:.5?} {:?}", online.excitation());
    assert!(found.iter().all(|e| e.abs() < 0.01), "{found:?}");
}

#[test]
fn constant_voltage_from_the_start_settles_no_inductance() {
    // The motor turns already when the first sample comes: nothing but steady state.
    let bench = regular(vec![(0.0, 40.0)], 0.001, 4.0);
    let [current, speed] = bench.noisy(3);
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
    let bench = Record::of(&paper(), steps(6.0), times);
    let online = run(&bench, OnlineConfig::default());
    let found = errors(&online.estimates(), &PAPER);
    println!("irregular {found:.5?}");
    assert!(found.iter().all(|e| e.abs() < 0.01), "{found:?}");

    // The live door: each command is told just before the first sample after it.
    let mut live = Online::new(OnlineConfig::default());
    let read = [&bench.current[..], &bench.speed];
    in_order(&bench.events, &bench.times, read, |sample| {
        match sample.get(Channel::VoltageCmd) {
            Some(volts) => live.command_applied(sample.time_s, volts),
            None => live.push(&sample),
        }
    });
    assert_eq!(live.estimates(), online.estimates());
    assert_eq!(live.innovation(), online.innovation());
}

#[test]
fn a_hotter_winding_and_twice_the_inertia_are_followed() {
    let truth = [1.43, 0.0099, 0.3538, 0.009, 0.455];
    let changed = Model::baseline(motor(&truth));
    for period_s in [0.001, 0.01] {
        let mut online = run(&regular(steps(4.0), period_s, 4.0), OnlineConfig::default());
        let mut bench = Record::of(&changed, steps(8.0), every(period_s, 8.0));
        bench.times.iter_mut().for_each(|t| *t += 5.0);
        bench.events.iter_mut().for_each(|e| e.0 += 5.0);
        let read = [bench.current.clone(), bench.speed.clone()];
        feed(&bench, &mut online, &read);
        let found = errors(&online.estimates(), &truth);
        println!("changed {period_s} {found:.5?}");
        assert!(found.iter().all(|e| e.abs() < 0.05), "{found:?}");
    }
}

#[test]
fn an_inductance_that_is_gone_between_two_samples_is_not_claimed() {
    // L/R = 0.4 ms against a period of 10 ms.
    let fast = Motor::zk_22fc().with(MotorKey::Inductance, 0.000_44);
    let bench = Record::of(&Model::baseline(fast), steps(6.0), every(0.01, 6.0));
    for seed in 0..8 {
        let inductance = run_noisy(&bench, seed).estimates().swap_remove(1);
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
    let bench = regular(steps(6.0), 0.01, 6.0);
    for seed in 0..5 {
        let [current, speed] = bench.noisy(seed);
        let mut online = Online::new(OnlineConfig::default());
        let limited = 3.0..5.0;
        let mut before = Vec::new();
        in_order(
            &bench.events,
            &bench.times,
            [&current, &speed],
            |mut sample| {
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
                    let settled = now.iter().any(|e| e.verdict == Verdict::Settled);
                    assert!(!settled, "{time_s} {now:?}");
                }
                if (2.95..2.96).contains(&time_s) {
                    before = online.estimates();
                }
            },
        );
        assert_eq!(before[0].verdict, Verdict::Settled);
        // It says so, and goes on by itself.
        let frozen = online.frozen();
        assert_eq!(frozen.since_s, None);
        assert!((2.1..2.2).contains(&frozen.seconds), "{frozen:?}");
        assert!((205..225).contains(&frozen.rows), "{frozen:?}");
        let wrong = settled_and_wrong(&online, PAPER);
        assert!(wrong.len() <= 1, "{seed} {wrong:?}");
        assert_eq!(online.estimates()[0].verdict, Verdict::Settled);
        let error = online.estimates()[0].value.unwrap() / PAPER[0] - 1.0;
        assert!(error.abs() < 0.02, "{seed} {error}");
    }
}

#[test]
fn an_inertia_that_changes_is_never_settled_at_what_lies_between() {
    let moves = |factor: f64| {
        let motor = Motor::zk_22fc().with(MotorKey::Inertia, factor * PAPER[3]);
        let mut events = steps(4.0);
        events.push((4.0, 0.0));
        Record::of(&Model::baseline(motor), events, every(0.01, 6.0))
    };
    for factor in [0.25, 0.5, 2.0, 5.0] {
        let (first, second) = (moves(1.0), moves(factor));
        let mut online = run_noisy(&first, 1);
        let [current, speed] = second.noisy(2);
        let truth = factor * PAPER[3];
        let (mut settled, mut sample_number) = (0, 0);
        in_order(
            &second.events,
            &second.times,
            [&current, &speed],
            |mut sample| {
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
                        let miss = (inertia.value.unwrap() - truth).abs() / inertia.std.unwrap();
                        assert!(miss < 5.0, "{factor} {time_s} {inertia:?}");
                    }
                }
            },
        );
        assert!(settled > 20, "{factor}: settled {settled} times");
    }
}

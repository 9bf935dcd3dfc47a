//! Noise of the speed sensor: least squares against instrumental variables.

use rayon::prelude::*;

use super::*;

/// Errors of Ta, TM, Ke in per cent: least squares as printed and exact, instruments, and the deviations these claim.
fn trial(seed: u64, samples: usize, reversing: bool) -> [[f64; 3]; 4] {
    let volts = if reversing {
        binary(samples, 10, 0.0, 40.0, seed)
    } else {
        binary(samples, 10, 60.0, 25.0, seed)
    };
    let record = Record::of(SLOW, 0.02, volts).with_sensor_noise(10.0, seed + 1000);
    let least = [Form::Printed, Form::Exact].map(|form| {
        let found = record.feed(form, 1.0).dynamics();
        found.map_or([f64::NAN; 3], errors)
    });
    let free = instrumental_variables(&record.series(), &record.direction, None).unwrap();
    let stds = std::array::from_fn(|j| {
        100.0 * free.covariance[j][j].sqrt() / [SLOW.ta_s, SLOW.tm_s, KE][j]
    });
    [least[0], least[1], errors(free.dynamics), stds]
}

fn middle(trials: &[[[f64; 3]; 4]], which: usize) -> [f64; 3] {
    std::array::from_fn(|j| median(&trials.iter().map(|t| t[which][j]).collect::<Vec<f64>>()))
}

fn covered(trials: &[[[f64; 3]; 4]], parameter: usize) -> usize {
    let inside = |t: &&[[f64; 3]; 4]| t[2][parameter].abs() < 1.96 * t[3][parameter];
    trials.iter().filter(inside).count()
}

#[test]
fn with_sensor_noise_the_instruments_are_ten_times_less_biased_than_least_squares() {
    let trials: Vec<[[f64; 3]; 4]> = (0..60_u64)
        .into_par_iter()
        .map(|seed| trial(seed, 20_000, false))
        .collect();
    let (printed, free) = (middle(&trials, 0), middle(&trials, 2));
    println!(
        "printed {printed:.2?} exact {:.2?} iv {free:.2?}",
        middle(&trials, 1)
    );
    for j in 0..2 {
        assert!(
            free[j].abs() < 0.1 * printed[j].abs(),
            "{printed:?} {free:?}"
        );
    }
    assert!(
        (printed[0] + 86.0).abs() < 3.0 && printed[1] > 40.0,
        "{printed:?}"
    );
    for j in 0..3 {
        assert!(free[j].abs() < 1.0, "{free:?}");
        assert!(
            (52..=60).contains(&covered(&trials, j)),
            "{j} {}",
            covered(&trials, j)
        );
    }
}

#[test]
fn over_reversals_the_instruments_stay_free_of_bias_and_their_intervals_cover() {
    let trials: Vec<[[f64; 3]; 4]> = (100..140_u64)
        .into_par_iter()
        .map(|seed| trial(seed, 5_000, true))
        .collect();
    let free = middle(&trials, 2);
    let counts = [0, 1, 2].map(|j| covered(&trials, j));
    println!(
        "printed {:.2?} iv {free:.2?} {counts:?} std {:.2?}",
        middle(&trials, 0),
        middle(&trials, 3)
    );
    for j in 0..3 {
        assert!(free[j].abs() < 3.0, "{free:?}");
        assert!(counts[j] >= 34, "{counts:?}");
    }
}

fn errors(found: Dynamics) -> [f64; 3] {
    [
        off(found.ta_s, SLOW.ta_s),
        off(found.tm_s, SLOW.tm_s),
        off(found.ke, KE),
    ]
}

/// Errors of Ta in per cent and whether its interval covers, at another period and length; noise of one tenth in power.
fn at_period(seed: u64, period_s: f64, samples: usize, hold: usize) -> Option<(f64, bool)> {
    let record = Record::of(SLOW, period_s, binary(samples, hold, 60.0, 25.0, seed))
        .with_sensor_noise(10.0, seed + 1000);
    let free = instrumental_variables(&record.series(), &record.direction, None).ok()?;
    let covers = (free.dynamics.ta_s - SLOW.ta_s).abs() < 1.96 * free.covariance[0][0].sqrt();
    Some((off(free.dynamics.ta_s, SLOW.ta_s), covers))
}

#[test]
fn the_instruments_bear_fast_sampling_but_not_a_memory_of_some_tens_of_samples() {
    let trials = |period_s: f64, samples: usize, hold: usize| -> Vec<(f64, bool)> {
        (0..24_u64)
            .into_par_iter()
            .filter_map(|seed| at_period(seed, period_s, samples, hold))
            .collect()
    };
    let fast = trials(0.005, 2000, 40);
    let ta: Vec<f64> = fast.iter().map(|trial| trial.0).collect();
    assert_eq!(fast.len(), 24);
    assert!(
        median(&ta).abs() < 2.0 && robust_deviation(&ta) < 5.0,
        "{ta:?}"
    );
    assert!(
        fast.iter().filter(|trial| trial.1).count() >= 20,
        "{fast:?}"
    );
    let short: Vec<f64> = trials(0.02, 40, 10).iter().map(|trial| trial.0).collect();
    println!("40 samples: {short:.0?}");
    assert!(
        short.len() < 24 || robust_deviation(&short) > 10.0,
        "{short:?}"
    );
}

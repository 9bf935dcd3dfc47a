//! The joint filter against the simulated motor: accuracy, coverage, bad input.

use rayon::prelude::*;

use super::super::bench::*;
use super::*;

fn errors(found: &Kalman, truth: &Truth) -> Vec<f64> {
    found
        .estimates()
        .iter()
        .zip(truth)
        .map(|(estimate, truth)| estimate.value.map_or(f64::NAN, |value| value / truth - 1.0))
        .collect()
}

fn unknown() -> KalmanConfig {
    KalmanConfig::default()
}

/// Bias, spread, reported deviation (all relative) and share of covered truths, over seeds.
struct Statistics {
    bias: [f64; 5],
    spread: [f64; 5],
    told: [f64; 5],
    covered: [f64; 5],
    missing: u32,
}

fn statistics(
    record: &Record,
    noise: [f64; 2],
    truth: &Truth,
    seeds: u64,
    online: bool,
) -> Statistics {
    let rows: Vec<[[f64; 2]; 5]> = (0..seeds)
        .into_par_iter()
        .filter_map(|seed| {
            let run = record.run(noise, seed);
            let found = if online {
                let mut kalman = Kalman::new(&unknown());
                run.samples().for_each(|sample| kalman.push(&sample));
                kalman
            } else {
                identify(&unknown(), &run)
            };
            let estimates = found.estimates();
            let mut row = [[0.0; 2]; 5];
            for k in 0..5 {
                row[k] = [
                    estimates[k].value? / truth[k] - 1.0,
                    estimates[k].std? / truth[k],
                ];
            }
            Some(row)
        })
        .collect();
    let count = rows.len() as f64;
    let over = |f: &dyn Fn(&[f64; 2]) -> f64| -> [f64; 5] {
        std::array::from_fn(|k| rows.iter().map(|row| f(&row[k])).sum::<f64>() / count)
    };
    let bias = over(&|row| row[0]);
    let squares = over(&|row| row[0] * row[0]);
    Statistics {
        bias,
        spread: std::array::from_fn(|k| (squares[k] - bias[k] * bias[k]).sqrt()),
        told: over(&|row| row[1]),
        covered: over(&|row| f64::from(u8::from(row[0].abs() < 1.96 * row[1]))),
        missing: u32::try_from(seeds).unwrap() - u32::try_from(rows.len()).unwrap(),
    }
}

fn print(name: &str, s: &Statistics) {
    println!(
        "{name}: missing {}\n  bias    {:.5?}\n  spread  {:.5?}\n  told    {:.5?}\n  covered {:.3?}",
        s.missing, s.bias, s.spread, s.told, s.covered
    );
}

fn cases() -> Vec<(&'static str, Truth, f64, f64, f64)> {
    // Name, motor, voltage scale, hold, period that is short for it.
    vec![
        ("paper", PAPER, 1.0, 0.0613, 0.001),
        ("paper 10 ms", PAPER, 1.0, 0.0613, 0.01),
        ("small", SMALL, 0.2, 0.0213, 0.0005),
        ("small 2 ms", SMALL, 0.2, 0.0213, 0.002),
        ("large", LARGE, 3.0, 0.211, 0.002),
        ("large 20 ms", LARGE, 3.0, 0.211, 0.02),
    ]
}

#[test]
#[ignore = "prints the table of coverage; minutes"]
fn table_of_coverage() {
    let seeds = 200;
    for (name, truth, scale, hold_s, period_s) in cases() {
        let seconds = if period_s < 0.001 { 2.5 } else { 6.0 };
        let model = Model::baseline(motor(&truth));
        let events = steps(seconds, scale, hold_s);
        let noise = [CURRENT_NOISE_A, SPEED_NOISE_RAD_S];
        let regular = Record::of(&model, events.clone(), every(period_s, seconds));
        let jitter = Record::of(&model, events, jittered(period_s, seconds, 5));
        print(name, &statistics(&regular, noise, &truth, seeds, false));
        print(
            &format!("{name} jitter"),
            &statistics(&jitter, noise, &truth, seeds, false),
        );
        print(
            &format!("{name} on line"),
            &statistics(&regular, noise, &truth, seeds, true),
        );
    }
}

#[test]
fn without_noise_every_parameter_is_found() {
    for (name, truth, scale, hold_s, period_s) in cases() {
        let seconds = 4.0;
        let model = Model::baseline(motor(&truth));
        let record = Record::of(
            &model,
            steps(seconds, scale, hold_s),
            every(period_s, seconds),
        );
        let found = identify(&unknown(), &record.run([0.0; 2], 0));
        let found = errors(&found, &truth);
        println!("{name} {found:.6?}");
        assert!(found.iter().all(|e| e.abs() < 0.001), "{name} {found:?}");
    }
}

#[test]
#[ignore = "debug"]
fn debug_large() {
    for (name, truth, scale, hold_s, period_s) in [cases()[4], cases()[5], cases()[1]] {
        let model = Model::baseline(motor(&truth));
        let record = Record::of(&model, steps(6.0, scale, hold_s), every(period_s, 6.0));
        for seed in 0..12 {
            let run = record.run([CURRENT_NOISE_A, SPEED_NOISE_RAD_S], seed);
            let found = identify(&unknown(), &run);
            let z: Vec<f64> = found
                .estimates()
                .iter()
                .zip(&truth)
                .map(|(e, t)| (e.value.unwrap() - t) / e.std.unwrap())
                .collect();
            println!("{name} {seed} {z:.2?} {}", found.summary());
        }
    }
}

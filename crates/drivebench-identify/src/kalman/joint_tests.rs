//! The joint filter against the simulated motor: accuracy, coverage, bad input.

use rayon::prelude::*;

use super::identify;
use super::*;
use crate::testing::{self, *};

fn errors(found: &Kalman, truth: &Truth) -> Vec<f64> {
    testing::errors(&found.estimates(), truth)
}

/// Steps after half a second of rest.
fn steps(seconds: f64, scale: f64, hold_s: f64) -> Vec<(f64, f64)> {
    testing::steps(0.5037, seconds, scale, hold_s)
}

fn statistics(record: &Record, truth: &Truth, seeds: u64) -> Statistics<5> {
    let of_seed = |seed| identify(&unknown(), &record.run(Some(seed))).estimates();
    let seeds: Vec<_> = (0..seeds).into_par_iter().map(of_seed).collect();
    Statistics::over(seeds.iter(), truth)
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
fn without_noise_every_parameter_is_found() {
    for (name, truth, scale, hold_s, period_s) in cases() {
        let seconds = 4.0;
        let model = Model::baseline(motor(&truth));
        let events = steps(seconds, scale, hold_s);
        let record = Record::of(&model, events, every(period_s, seconds));
        let found = identify(&unknown(), &record.run(None));
        let found = errors(&found, &truth);
        println!("{name} {found:.6?}");
        assert!(found.iter().all(|e| e.abs() < 0.001), "{name} {found:?}");
    }
}

#[test]
fn intervals_cover_on_three_motors_at_regular_and_jittered_stamps() {
    // The table above over 200 seeds: 0.90 to 0.985. Few seeds here: below 0.84 lies one honest case in a thousand.
    for (name, truth, scale, hold_s, period_s) in [cases()[1], cases()[3], cases()[5]] {
        let seconds = 6.0;
        let model = Model::baseline(motor(&truth));
        let stamps = jittered(period_s, seconds, 5);
        let record = Record::of(&model, steps(seconds, scale, hold_s), stamps);
        let found = statistics(&record, &truth, 60);
        println!("{name}: {found:.5?}");
        assert_eq!(found.missing, 0);
        assert!(found.covered.iter().all(|share| *share >= 0.83), "{name}");
        for k in 0..5 {
            assert!(found.bias[k].abs() < found.spread[k], "{name} {k}");
            assert!(found.claimed[k] < 1.3 * found.spread[k], "{name} {k}");
        }
    }
}

fn paper_run(period_s: f64, seed: u64) -> Run {
    let model = Model::baseline(motor(&PAPER));
    let record = Record::of(&model, steps(4.0, 1.0, 0.0613), every(period_s, 4.0));
    record.run(Some(seed))
}

#[test]
fn on_line_from_a_guess_that_is_far_off_and_without_any() {
    let guess = motor(&[2.5, 0.004, 0.25, 0.01, 0.1]);
    let far = Model::baseline(guess);
    for period_s in [0.001, 0.01] {
        for start in [far.clone(), unknown()] {
            let mut kalman = Kalman::new(&start);
            let run = paper_run(period_s, 1);
            run.samples().for_each(|sample| kalman.push(&sample));
            let found = errors(&kalman, &PAPER);
            println!("{period_s} {found:.5?} {}", kalman.summary());
            assert!(found.iter().all(|e| e.abs() < 0.01), "{found:?}");
        }
    }
}

#[test]
fn standstill_claims_nothing_and_says_why_in_numbers() {
    let model = Model::baseline(motor(&PAPER));
    let record = Record::of(&model, vec![(0.0, 0.0)], every(0.001, 2.0));
    let run = record.run(Some(1));
    for start in [unknown(), model] {
        for estimate in identify(&start, &run).estimates() {
            assert_eq!(estimate.verdict, Verdict::NotObservable, "{estimate:?}");
            let reason = estimate.reason.unwrap();
            assert!(reason.contains(|c: char| c.is_ascii_digit()), "{reason}");
        }
    }
}

#[test]
fn constant_voltage_settles_neither_inductance_nor_inertia() {
    let model = Model::baseline(motor(&PAPER));
    let record = Record::of(&model, vec![(0.0, 40.0)], every(0.001, 4.0));
    let run = record.run(Some(3));
    // The run without its start: nothing but steady state.
    let cells = |channel| (channel, run.column(channel).unwrap()[1500..].to_vec());
    let mut steady = run_of(
        run.time_s()[1500..].to_vec(),
        [Channel::Current, Channel::Speed].map(cells),
    );
    put(
        &mut steady,
        Channel::VoltageCmd,
        vec![40.0; run.rows() - 1500],
    );
    for start in [unknown(), model] {
        let found = identify(&start, &steady);
        let estimates = found.estimates();
        for estimate in &estimates {
            println!("steady {estimate:?}");
        }
        for k in [0, 1, 3] {
            assert_ne!(estimates[k].verdict, Verdict::Settled, "{:?}", estimates[k]);
        }
        // u = R i + Ke w: Ke is known as well as the start knows R (30 % of 1.4 V in 40 V), not better.
        if let (Some(value), Some(std)) = (estimates[2].value, estimates[2].std) {
            assert!(std > 0.005 * value, "{:?}", estimates[2]);
        }
    }
}

#[test]
fn bad_samples_are_left_out_and_one_missing_quantity_is_not_a_missing_row() {
    let run = paper_run(0.001, 2);
    let mut kalman = Kalman::new(&unknown());
    for (k, mut sample) in run.samples().enumerate() {
        match k % 7 {
            2 => sample.set(Channel::Speed, f64::NAN),
            4 => sample.set_stale(Channel::Current),
            _ => {}
        }
        kalman.push(&sample);
        // Out of order, and without a time.
        kalman.push(&Sample::at(sample.time_s - 0.01).with(Channel::Speed, 1e6));
        kalman.push(&Sample::at(f64::NAN).with(Channel::Speed, 1e6));
    }
    let found = errors(&kalman, &PAPER);
    println!("bad {found:.5?} {}", kalman.summary());
    assert!(found.iter().all(|e| e.abs() < 0.01), "{found:?}");
}

#[test]
fn a_hotter_winding_and_twice_the_inertia_are_followed() {
    let truth = [1.43, 0.0099, 0.3538, 0.009, 0.455];
    let changed = Model::baseline(motor(&truth));
    for period_s in [0.001, 0.01] {
        let mut kalman = Kalman::new(&unknown());
        let run = paper_run(period_s, 3);
        run.samples().for_each(|sample| kalman.push(&sample));
        let record = Record::of(&changed, steps(6.0, 1.0, 0.0613), every(period_s, 6.0));
        for mut sample in record.run(Some(4)).samples() {
            sample.time_s += 5.0;
            kalman.push(&sample);
        }
        let found = errors(&kalman, &truth);
        println!("changed {period_s} {found:.5?} {}", kalman.summary());
        assert!(kalman.filter.tally.reopened > 0);
        assert!(found.iter().all(|e| e.abs() < 0.02), "{found:?}");
    }
}

#[test]
fn a_model_that_misses_an_effect_settles_nothing_and_says_by_how_much() {
    let truth = paper_with("quadratic_load", &[5e-5]);
    let record = Record::of(&truth, steps(6.0, 1.0, 0.0613), every(0.001, 6.0));
    let run = record.run(Some(5));
    let blind = identify(&unknown(), &run);
    for estimate in blind.estimates() {
        println!("blind {estimate:?}");
        assert_ne!(estimate.verdict, Verdict::Settled);
    }
    // Told of the effect, it finds the motor.
    let mut model = unknown();
    model.effects = truth.effects;
    let told = identify(&model, &run);
    let found = errors(&told, &PAPER);
    println!("told {found:.5?} {}", told.summary());
    assert!(found.iter().all(|e| e.abs() < 0.005), "{found:?}");
}

#[test]
fn what_a_limit_of_the_drive_kept_from_the_motor_is_not_learnt() {
    let found = identify(&unknown(), &limited(&paper_run(0.001, 6), 1.5..2.5));
    let errors = errors(&found, &PAPER);
    assert!(errors.iter().all(|e| e.abs() < 0.01), "{errors:?}");
    let settled = |estimate: &ParameterEstimate| estimate.verdict == Verdict::Settled;
    assert!(found.estimates().iter().all(settled));
}

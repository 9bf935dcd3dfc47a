//! Scheme 1 on simulated motors: exact where it must be, as far off as the paper's form is, free of bias where it claims to be.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use super::*;
use crate::testing::{self, assert_near, noisy};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::{median, robust_deviation, variance};
use drivebench_model::plant::{Input, Model};

/// A motor by its time constants, with 1.1 ohm and 0.35 V.s/rad.
#[derive(Clone, Copy)]
struct Truth {
    ta_s: f64,
    tm_s: f64,
    load_v: f64,
}

const R: f64 = 1.1;
const KE: f64 = 0.35;

impl Truth {
    /// Ta 20 ms, TM so many times that.
    fn of_ratio(ratio: f64) -> Self {
        Self {
            ta_s: 0.02,
            tm_s: 0.02 * ratio,
            load_v: 2.0,
        }
    }

    fn dynamics(self) -> Dynamics {
        Dynamics {
            ta_s: self.ta_s,
            tm_s: self.tm_s,
            ke: KE,
            load_v: self.load_v,
        }
    }

    fn inertia(self) -> f64 {
        self.tm_s * KE * KE / R
    }
}

struct Record {
    period_s: f64,
    voltage_v: Vec<f64>,
    speed_rad_s: Vec<f64>,
    /// Sign of the true motion.
    direction: Vec<i8>,
}

impl Record {
    /// `voltage_v[k]` is applied over the period that ends at sample `k`.
    fn of(truth: Truth, period_s: f64, voltage_v: Vec<f64>) -> Self {
        let samples = voltage_v.len();
        let (load, inertia) = (truth.load_v * KE / R, truth.inertia());
        let model = Model::baseline(testing::motor(&[R, truth.ta_s * R, KE, inertia, load]));
        let time = |k: usize| k as f64 * period_s;
        let events = (1..samples).map(|k| (time(k - 1), voltage_v[k]));
        let times = (0..samples).map(time).collect();
        let out = testing::simulated(&model, Input::Voltage, events.collect(), times);
        let sign = |w: f64| i8::from(w > 0.0) - i8::from(w < 0.0);
        Self {
            period_s,
            voltage_v,
            direction: out.speed_rad_s.iter().map(|w| sign(*w)).collect(),
            speed_rad_s: out.speed_rad_s,
        }
    }

    /// Sensor noise with a signal-to-noise ratio of power.
    fn with_sensor_noise(mut self, power_ratio: f64, seed: u64) -> Self {
        let sigma = (variance(&self.speed_rad_s) / power_ratio).sqrt();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        self.speed_rad_s = noisy(&self.speed_rad_s, sigma, &mut rng);
        self
    }

    fn feed(&self, form: Form, forgetting: f64) -> Scheme1 {
        self.feed_until(self.voltage_v.len(), form, forgetting)
    }

    fn feed_until(&self, samples: usize, form: Form, forgetting: f64) -> Scheme1 {
        let mut scheme = Scheme1::new(form, self.period_s, forgetting);
        for k in 0..samples {
            scheme.push(self.voltage_v[k], self.speed_rad_s[k], self.direction[k]);
        }
        scheme
    }

    fn series(&self) -> Series<'_> {
        Series {
            period_s: self.period_s,
            voltage_v: &self.voltage_v,
            speed_rad_s: &self.speed_rad_s,
        }
    }
}

/// Two levels about an offset, each held for `hold` periods or a multiple of it.
fn binary(samples: usize, hold: usize, offset_v: f64, amplitude_v: f64, seed: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut level = 0.0;
    (0..samples)
        .map(|k| {
            if k % hold == 1 % hold {
                level = [-amplitude_v, amplitude_v][usize::from(rng.random::<bool>())];
            }
            offset_v + level
        })
        .collect()
}

fn off(found: f64, truth: f64) -> f64 {
    100.0 * (found / truth - 1.0)
}

#[test]
fn without_noise_the_exact_form_is_exact_however_coarse_the_sampling() {
    for ratio in [0.5, 1.0, 2.0, 5.0, 10.0, 30.0] {
        for alpha in [0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 3.0] {
            let truth = Truth::of_ratio(ratio);
            let hold = whole((1.0 + ratio / alpha).min(100.0));
            let record = Record::of(truth, 0.02 * alpha, binary(6000, hold, 30.0, 15.0, 7));
            let found = record.feed(Form::Exact, 1.0).parameters(R, None);
            let found = found.unwrap_or_else(|error| panic!("{ratio} {alpha} {error}"));
            let errors = [
                off(found.ta_s, truth.ta_s),
                off(found.tm_s, truth.tm_s),
                off(found.ke, KE),
                off(found.inertia, truth.inertia()),
                off(found.load_torque, truth.load_v * KE / R),
            ];
            let exact = errors.iter().all(|error| error.abs() < 0.1);
            assert!(exact, "TM/Ta {ratio} T/Ta {alpha}: {errors:?} %");
        }
    }
}

#[test]
fn at_one_time_constant_the_printed_form_errs_as_the_table_says() {
    let table = [
        (1.0, -22.0, 105.0),
        (2.0, 1.0, 53.0),
        (5.0, 25.0, 22.0),
        (10.0, 35.0, 12.0),
        (30.0, 44.0, 5.0),
    ];
    for (ratio, ta, tm) in table {
        let truth = Truth::of_ratio(ratio);
        let record = Record::of(truth, 0.02, binary(20_000, 5, 30.0, 15.0, 7));
        let found = record.feed(Form::Printed, 1.0).parameters(R, None).unwrap();
        let times = [off(found.ta_s, truth.ta_s), off(found.tm_s, truth.tm_s)];
        for (error, expected) in [(times[0], ta), (times[1], tm), (off(found.ke, KE), 0.0)] {
            assert!((error - expected).abs() < 1.0, "{ratio} {times:?}");
        }
    }
}

const SLOW: Truth = Truth {
    ta_s: 0.1,
    tm_s: 0.2,
    load_v: 2.0,
};

#[test]
fn coefficients_of_a_motor_lead_back_to_it() {
    for ratio in [0.6, 2.0, 4.0, 4.000_001, 30.0] {
        for alpha in [0.01, 0.3, 1.0, 2.9] {
            let truth = Truth::of_ratio(ratio).dynamics();
            let period_s = 0.02 * alpha;
            let there = Coefficients::of_motor(&truth, period_s);
            let back = Dynamics::from_coefficients(Form::Exact, &there, period_s).unwrap();
            for (found, given) in back.to_array().iter().zip(truth.to_array()) {
                let is_back = (found / given - 1.0).abs() < 1e-6;
                assert!(is_back, "{ratio} {alpha} {back:?}");
            }
        }
    }
}

#[test]
fn at_constant_voltage_the_estimate_neither_winds_up_nor_drifts_away() {
    let mut volts = binary(600, 10, 60.0, 25.0, 3);
    volts.extend(std::iter::repeat_n(60.0, 20_000));
    let record = Record::of(SLOW, 0.02, volts).with_sensor_noise(1e7, 8);
    let before = record.feed_until(600, Form::Exact, 0.97).dynamics();
    let after = record.feed(Form::Exact, 0.97);
    // Noise of the sensor alone moves Ta and TM at rest, but the prior never takes over.
    let spread = after.covariance().unwrap();
    let small = (0..5).all(|j| spread[j][j].is_finite() && spread[j][j] < 1.0);
    assert!(small, "{spread:?}");
    assert_near(after.dynamics().unwrap().ke, before.unwrap().ke, 0.1);
}

#[test]
fn a_missing_sample_and_a_reversal_leave_rows_out_and_spoil_nothing() {
    let truth = Truth::of_ratio(4.0);
    let mut record = Record::of(truth, 0.01, binary(4000, 12, 0.0, 30.0, 2));
    for k in (100..4000).step_by(97) {
        record.speed_rad_s[k] = f64::NAN;
    }
    let scheme = record.feed(Form::Exact, 1.0);
    assert!((1501..3900).contains(&scheme.rows()), "{}", scheme.rows());
    let free = instrumental_variables(&record.series(), &record.direction, None).unwrap();
    for found in [scheme.dynamics().unwrap(), free.dynamics] {
        for (found, truth) in found.to_array().iter().zip(truth.dynamics().to_array()) {
            assert!(off(*found, truth).abs() < 0.01, "{found} {truth}");
        }
    }
}

#[test]
fn what_belongs_to_no_motor_is_rejected_with_the_reason() {
    let good = Coefficients::of_motor(&SLOW.dynamics(), 0.02);
    let exact = |c: Coefficients| Dynamics::from_coefficients(Form::Exact, &c, 0.02);
    let printed = |c: Coefficients| Dynamics::from_coefficients(Form::Printed, &c, 0.02);
    let with = |p: f64, q: f64| Coefficients { p, q, ..good };
    let voltage = -1e-3;
    let reversed = Coefficients { voltage, ..good };
    let cases = [
        (exact(with(2.7, 1.8)), "poles"),
        (exact(with(0.1, 0.2)), "-a2"),
        (exact(with(-0.1, 1e-3)), "-a2"),
        (exact(reversed), "b1 + b2"),
        (exact(with(good.p, -1e-3)), "1 - a1 - a2"),
        (printed(with(-0.1, good.q)), "2 - a1"),
        (printed(with(good.p, f64::NAN)), "1 - a1 - a2"),
        (exact(with(f64::NAN, good.q)), "-a2"),
    ];
    for (result, word) in cases {
        let error = result.unwrap_err();
        assert!(error.to_string().contains(word), "{error} {word}");
        assert!(!error.help().is_empty());
    }
    let scheme = Scheme1::new(Form::Exact, 0.02, 1.0);
    assert!(matches!(
        scheme.parameters(1.0, None),
        Err(Scheme1Rejection::TooFewRows { rows: 0, .. })
    ));
    for resistance in [0.0, -1.0, f64::NAN] {
        assert!(matches!(
            SLOW.dynamics().values(resistance, None),
            Err(Scheme1Rejection::Resistance { .. })
        ));
    }
}

#[test]
fn a_speed_without_news_gives_no_instruments() {
    let still = Record::of(SLOW, 0.02, vec![0.0; 200]);
    let constant = Record::of(SLOW, 0.02, vec![40.0; 2000]);
    for record in [&still, &constant] {
        let found = instrumental_variables(&record.series(), &record.direction, None);
        assert!(found.is_err(), "{found:?}");
    }
}

#[test]
fn the_known_share_of_the_noise_is_taken_out_of_least_squares() {
    let clean = Record::of(SLOW, 0.05, binary(8000, 6, 60.0, 25.0, 4));
    let sigma = (variance(&clean.speed_rad_s) / 2000.0).sqrt();
    let record = clean.with_sensor_noise(2000.0, 9);
    let found = |scheme: Dynamics| off(scheme.ta_s, SLOW.ta_s);
    let biased = found(record.feed(Form::Exact, 1.0).dynamics().unwrap());
    for (noise, left) in [(Noise::Known(sigma), 0.2), (Noise::FromResidual, 0.5)] {
        let (without, used) = noise_free(&record.series(), &record.direction, noise).unwrap();
        let without = found(without);
        assert!(without.abs() < left * biased.abs(), "{biased} {without}");
        assert_near(used, sigma, 0.3);
    }
    assert!(biased < -5.0, "{biased}");
}

// Noise as equation error, as paper A's Figure 2 must have had it.

/// Ta and TM over their true values, sample by sample.
type Tracks = (Vec<f64>, Vec<f64>);

/// Paper A's Figure 2: eq. (17) itself with noise as equation error, TM doubled at sample 900.
fn figure_2(seed: u64, power_ratio: f64) -> Tracks {
    let (mut ta, mut tm) = (Vec::new(), Vec::new());
    figure_2_rows(seed, power_ratio, |scheme| {
        let found = scheme.dynamics().ok();
        ta.push(found.map_or(f64::NAN, |d| d.ta_s / SLOW.ta_s));
        tm.push(found.map_or(f64::NAN, |d| d.tm_s / SLOW.tm_s));
    });
    (ta, tm)
}

/// Ta and TM just before the jump, with the deviations claimed.
fn figure_2_end(seed: u64) -> ([f64; 2], [f64; 2]) {
    let (mut end, mut sample) = (([f64::NAN; 2], [f64::NAN; 2]), 0);
    figure_2_rows(seed, 100.0, |scheme| {
        sample += 1;
        if sample == 890 {
            let spread = scheme.dynamics_covariance().unwrap();
            let found = scheme.dynamics().unwrap();
            let stds = [0, 1].map(|j| spread[j][j].sqrt());
            end = ([found.ta_s, found.tm_s], stds);
        }
    });
    end
}

fn figure_2_rows(seed: u64, power_ratio: f64, mut see: impl FnMut(&Scheme1)) {
    let (period_s, samples) = (0.02, 1800);
    let volts = binary(samples, 10, 60.0, 25.0, seed);
    let coefficients = |tm_s: f64| {
        let (alpha, gamma) = (period_s / SLOW.ta_s, period_s / tm_s);
        Coefficients {
            p: alpha,
            q: alpha * gamma,
            voltage: alpha * gamma / (2.0 * KE),
            load: SLOW.load_v / KE * gamma / 2.0 * (2.0 * alpha - alpha * gamma),
            voltage_step: 0.0,
        }
    };
    let respond = |sigma: f64, drive: f64| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed + 5);
        let mut w = vec![drive * 165.0; 2];
        for k in 2..samples {
            let c = coefficients(if k < 900 { SLOW.tm_s } else { 2.0 * SLOW.tm_s });
            let noise: f64 = sigma * rng.sample::<f64, _>(StandardNormal);
            w.push(
                c.a1() * w[k - 1]
                    + c.a2() * w[k - 2]
                    + drive * (c.voltage * (volts[k] + volts[k - 1]) - c.load)
                    + noise,
            );
        }
        w
    };
    let sigma = (variance(&respond(0.0, 1.0)) / power_ratio / variance(&respond(1.0, 0.0))).sqrt();
    let mut scheme = Scheme1::new(Form::Printed, period_s, 0.97);
    for (volts, speed) in volts.iter().zip(respond(sigma, 1.0)) {
        scheme.push(*volts, speed, 1);
        see(&scheme);
    }
}

#[test]
fn a_doubled_mechanical_time_constant_is_followed_with_a_memory_of_33_samples() {
    let tracks = (0..60_u64).into_par_iter().map(|seed| figure_2(seed, 10.0));
    let tracks: Vec<Tracks> = tracks.collect();
    let at = |k: usize, of: fn(&Tracks) -> &Vec<f64>| {
        let there: Vec<f64> = tracks.iter().map(|track| of(track)[k]).collect();
        median(&there)
    };
    for k in [600, 880, 1100, 1300, 1700] {
        let (ta, tm) = (at(k, |t| &t.0), at(k, |t| &t.1));
        let truth = if k < 900 { 1.0 } else { 2.0 };
        assert!((ta - 1.0).abs() < 0.15, "{k} {ta}");
        assert!((tm / truth - 1.0).abs() < 0.15, "{k} {tm}");
    }
}

#[test]
fn claimed_deviations_of_least_squares_are_those_of_repeated_trials_with_equation_error() {
    let ends: Vec<([f64; 2], [f64; 2])> = (0..200_u64).into_par_iter().map(figure_2_end).collect();
    for j in 0..2 {
        let found: Vec<f64> = ends.iter().map(|end| end.0[j]).collect();
        let claimed: Vec<f64> = ends.iter().map(|end| end.1[j]).collect();
        let ratio = median(&claimed) / robust_deviation(&found);
        assert!((0.75..1.33).contains(&ratio), "{j} {ratio}");
    }
}

// Noise of the speed sensor: least squares against instrumental variables.

/// Errors of Ta, TM, Ke in per cent: least squares as printed and exact, instruments, and the deviations these claim.
type Trial = [[f64; 3]; 4];

fn trials(seeds: std::ops::Range<u64>, samples: usize, reversing: bool) -> Vec<Trial> {
    let seeds = seeds.into_par_iter();
    seeds.map(|seed| trial(seed, samples, reversing)).collect()
}

fn trial(seed: u64, samples: usize, reversing: bool) -> Trial {
    let (offset_v, amplitude_v) = if reversing { (0.0, 40.0) } else { (60.0, 25.0) };
    let volts = binary(samples, 10, offset_v, amplitude_v, seed);
    let record = Record::of(SLOW, 0.02, volts).with_sensor_noise(10.0, seed + 1000);
    let least = [Form::Printed, Form::Exact].map(|form| {
        let found = record.feed(form, 1.0).dynamics();
        found.map_or([f64::NAN; 3], errors)
    });
    let free = instrumental_variables(&record.series(), &record.direction, None).unwrap();
    let sizes = [SLOW.ta_s, SLOW.tm_s, KE];
    let stds = [0, 1, 2].map(|j| 100.0 * free.covariance[j][j].sqrt() / sizes[j]);
    [least[0], least[1], errors(free.dynamics), stds]
}

fn middle(trials: &[Trial], which: usize) -> [f64; 3] {
    std::array::from_fn(|j| median(&trials.iter().map(|t| t[which][j]).collect::<Vec<f64>>()))
}

fn covered(trials: &[Trial], parameter: usize) -> usize {
    let inside = |t: &&Trial| t[2][parameter].abs() < 1.96 * t[3][parameter];
    trials.iter().filter(inside).count()
}

#[test]
fn with_sensor_noise_the_instruments_are_ten_times_less_biased_than_least_squares() {
    let trials = trials(0..60, 20_000, false);
    let (printed, free) = (middle(&trials, 0), middle(&trials, 2));
    let less = |j: usize| free[j].abs() < 0.1 * printed[j].abs();
    assert!(less(0) && less(1), "{printed:?} {free:?}");
    let as_known = (printed[0] + 86.0).abs() < 3.0 && printed[1] > 40.0;
    assert!(as_known, "{printed:?}");
    let counts = [0, 1, 2].map(|j| covered(&trials, j));
    for j in 0..3 {
        assert!(free[j].abs() < 1.0, "{free:?}");
        assert!((52..=60).contains(&counts[j]), "{counts:?}");
    }
}

#[test]
fn over_reversals_the_instruments_stay_free_of_bias_and_their_intervals_cover() {
    let trials = trials(100..140, 5_000, true);
    let free = middle(&trials, 2);
    let counts = [0, 1, 2].map(|j| covered(&trials, j));
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
    let bears = median(&ta).abs() < 2.0 && robust_deviation(&ta) < 5.0;
    assert!(bears, "{ta:?}");
    let covered = fast.iter().filter(|trial| trial.1).count();
    assert!(covered >= 20, "{fast:?}");
    let short: Vec<f64> = trials(0.02, 40, 10).iter().map(|trial| trial.0).collect();
    let scatters = short.len() < 24 || robust_deviation(&short) > 10.0;
    assert!(scatters, "{short:?}");
}

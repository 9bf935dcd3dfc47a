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

const R: f64 = 1.1;
const KE: f64 = 0.35;

/// Ta 20 ms, TM so many times that.
fn of_ratio(ratio: f64) -> Dynamics {
    Dynamics { ta_s: 0.02, tm_s: 0.02 * ratio, ke: KE, load_v: 2.0 }
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
    fn of(truth: Dynamics, period_s: f64, voltage_v: Vec<f64>) -> Self {
        let samples = voltage_v.len();
        let (load, inertia) = (truth.load_v * KE / R, truth.tm_s * KE * KE / R);
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

    fn feed(&self, form: Form) -> Scheme1 {
        self.feed_until(self.voltage_v.len(), form, 1.0)
    }

    fn feed_until(&self, samples: usize, form: Form, forgetting: f64) -> Scheme1 {
        let mut scheme = Scheme1::new(form, self.period_s, forgetting);
        for k in 0..samples {
            scheme.push(self.voltage_v[k], self.speed_rad_s[k], self.direction[k]);
        }
        scheme
    }

    fn instruments(&self) -> Result<Instrumental, InstrumentalError> {
        instrumental_variables(&self.series(), &self.direction, None)
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

/// Per cent.
fn off(found: f64, truth: f64) -> f64 {
    100.0 * (found / truth - 1.0)
}

#[test]
fn without_noise_the_exact_form_is_exact_at_any_period() {
    for ratio in [0.5, 1.0, 2.0, 5.0, 10.0, 30.0] {
        for alpha in [0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 3.0] {
            let truth = of_ratio(ratio);
            let hold = whole((1.0 + ratio / alpha).min(100.0));
            let record = Record::of(truth, 0.02 * alpha, binary(6000, hold, 30.0, 15.0, 7));
            let found = record.feed(Form::Exact).parameters(R, None);
            let found = found.unwrap_or_else(|error| panic!("{ratio} {alpha} {error}"));
            let errors = [
                off(found.ta_s, truth.ta_s),
                off(found.tm_s, truth.tm_s),
                off(found.ke, KE),
                off(found.inertia, truth.tm_s * KE * KE / R),
                off(found.load_torque, truth.load_v * KE / R),
            ];
            let exact = errors.iter().all(|error| error.abs() < 0.1);
            assert!(exact, "TM/Ta {ratio} T/Ta {alpha}: {errors:?} %");
        }
    }
}

#[test]
fn at_one_time_constant_the_printed_form_errs_as_known() {
    for (ratio, ta, tm) in [
        (1.0, -22.0, 105.0),
        (2.0, 1.0, 53.0),
        (5.0, 25.0, 22.0),
        (10.0, 35.0, 12.0),
        (30.0, 44.0, 5.0),
    ] {
        let truth = of_ratio(ratio);
        let record = Record::of(truth, 0.02, binary(20_000, 5, 30.0, 15.0, 7));
        let found = record.feed(Form::Printed).dynamics().unwrap();
        let errors =
            [off(found.ta_s, truth.ta_s) - ta, off(found.tm_s, truth.tm_s) - tm, off(found.ke, KE)];
        assert!(errors.iter().all(|error| error.abs() < 1.0), "{ratio} {errors:?}");
    }
}

const SLOW: Dynamics = Dynamics { ta_s: 0.1, tm_s: 0.2, ke: KE, load_v: 2.0 };

#[test]
fn coefficients_of_a_motor_lead_back_to_it() {
    for ratio in [0.6, 2.0, 4.0, 4.000_001, 30.0] {
        for alpha in [0.01, 0.3, 1.0, 2.9] {
            let (truth, period_s) = (of_ratio(ratio), 0.02 * alpha);
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
fn at_constant_voltage_the_estimate_does_not_wind_up() {
    let mut volts = binary(600, 10, 60.0, 25.0, 3);
    volts.extend(std::iter::repeat_n(60.0, 20_000));
    let record = Record::of(SLOW, 0.02, volts).with_sensor_noise(1e7, 8);
    let before = record.feed_until(600, Form::Exact, 0.97).dynamics();
    let after = record.feed_until(20_600, Form::Exact, 0.97);
    // Noise of the sensor alone moves Ta and TM at rest, but the prior never takes over.
    let spread = after.covariance().unwrap();
    assert!((0..5).all(|j| spread[j][j].is_finite() && spread[j][j] < 1.0), "{spread:?}");
    assert_near(after.dynamics().unwrap().ke, before.unwrap().ke, 0.1);
}

#[test]
fn missing_samples_and_reversals_only_leave_rows_out() {
    let truth = of_ratio(4.0);
    let mut record = Record::of(truth, 0.01, binary(4000, 12, 0.0, 30.0, 2));
    for k in (100..4000).step_by(97) {
        record.speed_rad_s[k] = f64::NAN;
    }
    let scheme = record.feed(Form::Exact);
    assert!((1501..3900).contains(&scheme.rows()), "{}", scheme.rows());
    let free = record.instruments().unwrap().dynamics;
    for found in [scheme.dynamics().unwrap(), free] {
        for (found, truth) in found.to_array().iter().zip(truth.to_array()) {
            assert!(off(*found, truth).abs() < 0.01, "{found} {truth}");
        }
    }
}

#[test]
fn coefficients_of_no_motor_are_rejected_with_the_reason() {
    let good = Coefficients::of_motor(&SLOW, 0.02);
    let reversed = Coefficients { voltage: -1e-3, ..good };
    let with = |p: f64, q: f64| Coefficients { p, q, ..good };
    for (form, coefficients, word) in [
        (Form::Exact, with(2.7, 1.8), "poles"),
        (Form::Exact, with(0.1, 0.2), "-a2"),
        (Form::Exact, with(-0.1, 1e-3), "-a2"),
        (Form::Exact, reversed, "b1 + b2"),
        (Form::Exact, with(good.p, -1e-3), "1 - a1 - a2"),
        (Form::Printed, with(-0.1, good.q), "2 - a1"),
        (Form::Printed, with(good.p, f64::NAN), "1 - a1 - a2"),
        (Form::Exact, with(f64::NAN, good.q), "-a2"),
    ] {
        let error = Dynamics::from_coefficients(form, &coefficients, 0.02).unwrap_err();
        assert!(error.to_string().contains(word), "{error} {word}");
        assert!(!error.help().is_empty());
    }
    let empty = Scheme1::new(Form::Exact, 0.02, 1.0).dynamics();
    assert!(matches!(empty, Err(Scheme1Rejection::TooFewRows { rows: 0, .. })), "{empty:?}");
    for resistance in [0.0, -1.0, f64::NAN] {
        assert!(matches!(SLOW.values(resistance, None), Err(Scheme1Rejection::Resistance { .. })));
    }
    for still in [vec![0.0; 200], vec![40.0; 2000]] {
        let found = Record::of(SLOW, 0.02, still).instruments();
        assert!(found.is_err(), "{found:?}");
    }
}

#[test]
fn the_known_share_of_the_noise_is_taken_out_of_least_squares() {
    let clean = Record::of(SLOW, 0.05, binary(8000, 6, 60.0, 25.0, 4));
    let sigma = (variance(&clean.speed_rad_s) / 2000.0).sqrt();
    let record = clean.with_sensor_noise(2000.0, 9);
    let biased = off(record.feed(Form::Exact).dynamics().unwrap().ta_s, SLOW.ta_s);
    assert!(biased < -5.0, "{biased}");
    for (noise, left) in [(Noise::Known(sigma), 0.2), (Noise::FromResidual, 0.5)] {
        let (without, used) = noise_free(&record.series(), &record.direction, noise).unwrap();
        let without = off(without.ta_s, SLOW.ta_s);
        assert!(without.abs() < left * biased.abs(), "{biased} {without}");
        assert_near(used, sigma, 0.3);
    }
}

// Noise as equation error, as paper A's Figure 2 must have had it.

/// Paper A's Figure 2: eq. (17) itself with noise as equation error, TM doubled at sample 900.
fn figure_2(seed: u64, power_ratio: f64, mut take: impl FnMut(usize, &Scheme1)) {
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
            let driven = c.voltage * (volts[k] + volts[k - 1]) - c.load;
            w.push(c.a1() * w[k - 1] + c.a2() * w[k - 2] + drive * driven + noise);
        }
        w
    };
    let sigma = (variance(&respond(0.0, 1.0)) / power_ratio / variance(&respond(1.0, 0.0))).sqrt();
    let mut scheme = Scheme1::new(Form::Printed, period_s, 0.97);
    for (k, (volts, speed)) in volts.iter().zip(respond(sigma, 1.0)).enumerate() {
        scheme.push(*volts, speed, 1);
        take(k, &scheme);
    }
}

#[test]
fn a_doubled_tm_is_followed_with_a_memory_of_33_samples() {
    let tracks = (0..60_u64).into_par_iter().map(|seed| {
        let mut track = Vec::new();
        figure_2(seed, 10.0, |_, scheme| {
            let found = scheme.dynamics().ok();
            track.push(found.map_or([f64::NAN; 2], |d| [d.ta_s / SLOW.ta_s, d.tm_s / SLOW.tm_s]));
        });
        track
    });
    let tracks: Vec<Vec<[f64; 2]>> = tracks.collect();
    for (k, truth) in [(600, 1.0), (880, 1.0), (1100, 2.0), (1300, 2.0), (1700, 2.0)] {
        let [ta, tm] = [0, 1].map(|j| {
            let there: Vec<f64> = tracks.iter().map(|track| track[k][j]).collect();
            median(&there)
        });
        let follows = (ta - 1.0).abs() < 0.15 && (tm / truth - 1.0).abs() < 0.15;
        assert!(follows, "{k} {ta} {tm}");
    }
}

#[test]
fn claimed_deviations_are_those_of_trials_with_equation_error() {
    let ends = (0..200_u64).into_par_iter().map(|seed| {
        let mut end = [[f64::NAN; 2]; 2];
        figure_2(seed, 100.0, |k, scheme| {
            // Just before the jump.
            if k == 889 {
                let spread = scheme.dynamics_covariance().unwrap();
                let found = scheme.dynamics().unwrap();
                end = [[found.ta_s, spread[0][0].sqrt()], [found.tm_s, spread[1][1].sqrt()]];
            }
        });
        end
    });
    let ends: Vec<[[f64; 2]; 2]> = ends.collect();
    for j in 0..2 {
        let [found, claimed] = [0, 1].map(|k| ends.iter().map(|end| end[j][k]).collect::<Vec<_>>());
        let ratio = median(&claimed) / robust_deviation(&found);
        assert!((0.75..1.33).contains(&ratio), "{j} {ratio}");
    }
}

// Noise of the speed sensor: least squares against instrumental variables.

/// Errors of Ta, TM, Ke in per cent: least squares as printed, instruments, and the deviations that these claim.
type Trial = [[f64; 3]; 3];

fn trial(seed: u64, samples: usize, offset_v: f64, amplitude_v: f64) -> Trial {
    let errors = |found: Dynamics| {
        let sizes = SLOW.to_array();
        let found = found.to_array();
        [0, 1, 2].map(|j| off(found[j], sizes[j]))
    };
    let volts = binary(samples, 10, offset_v, amplitude_v, seed);
    let record = Record::of(SLOW, 0.02, volts).with_sensor_noise(10.0, seed + 1000);
    let printed = record.feed(Form::Printed).dynamics();
    let free = record.instruments().unwrap();
    let sizes = [SLOW.ta_s, SLOW.tm_s, KE];
    let stds = [0, 1, 2].map(|j| 100.0 * free.covariance[j][j].sqrt() / sizes[j]);
    [printed.map_or([f64::NAN; 3], errors), errors(free.dynamics), stds]
}

/// Medians of the errors of both methods, and in how many trials the intervals of the instruments cover.
fn trials(
    seeds: std::ops::Range<u64>,
    of_seed: impl Fn(u64) -> Trial + Send + Sync,
) -> ([[f64; 3]; 2], [usize; 3]) {
    let trials: Vec<Trial> = seeds.into_par_iter().map(of_seed).collect();
    let middle =
        |which: usize, j: usize| median(&trials.iter().map(|t| t[which][j]).collect::<Vec<f64>>());
    let covered = |j: usize| trials.iter().filter(|t| t[1][j].abs() < 1.96 * t[2][j]).count();
    let medians = [0, 1].map(|which| [0, 1, 2].map(|j| middle(which, j)));
    (medians, [0, 1, 2].map(covered))
}

#[test]
fn with_sensor_noise_the_instruments_are_free_of_bias_and_cover() {
    let ([printed, free], counts) = trials(0..60, |seed| trial(seed, 20_000, 60.0, 25.0));
    let less = |j: usize| free[j].abs() < 0.1 * printed[j].abs();
    assert!(less(0) && less(1), "{printed:?} {free:?}");
    let as_known = (printed[0] + 86.0).abs() < 3.0 && printed[1] > 40.0;
    assert!(as_known, "{printed:?}");
    for j in 0..3 {
        let is_honest = free[j].abs() < 1.0 && (52..=60).contains(&counts[j]);
        assert!(is_honest, "{free:?} {counts:?}");
    }
    // Over reversals.
    let ([_, free], counts) = trials(100..140, |seed| trial(seed, 5_000, 0.0, 40.0));
    for j in 0..3 {
        let is_honest = free[j].abs() < 3.0 && counts[j] >= 34;
        assert!(is_honest, "{free:?} {counts:?}");
    }
}

#[test]
fn the_instruments_bear_fast_sampling_but_no_short_memory() {
    // Errors of Ta in per cent and whether its interval covers; noise of one tenth in power.
    let trials = |period_s: f64, samples: usize, hold: usize| -> Vec<(f64, bool)> {
        let of_seed = |seed: u64| {
            let volts = binary(samples, hold, 60.0, 25.0, seed);
            let record = Record::of(SLOW, period_s, volts).with_sensor_noise(10.0, seed + 1000);
            let free = record.instruments().ok()?;
            let ta_s = free.dynamics.ta_s;
            let covers = (ta_s - SLOW.ta_s).abs() < 1.96 * free.covariance[0][0].sqrt();
            Some((off(ta_s, SLOW.ta_s), covers))
        };
        (0..24_u64).into_par_iter().filter_map(of_seed).collect()
    };
    let fast = trials(0.005, 2000, 40);
    let ta: Vec<f64> = fast.iter().map(|trial| trial.0).collect();
    let covered = fast.iter().filter(|trial| trial.1).count();
    let bears = median(&ta).abs() < 2.0 && robust_deviation(&ta) < 5.0 && covered >= 20;
    assert!(fast.len() == 24 && bears, "{fast:?}");
    let short: Vec<f64> = trials(0.02, 40, 10).iter().map(|trial| trial.0).collect();
    let scatters = short.len() < 24 || robust_deviation(&short) > 10.0;
    assert!(scatters, "{short:?}");
}

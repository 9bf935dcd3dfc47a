//! Scheme 1 on simulated motors: exact where it must be, as far off as the paper's form is, free of bias where it claims to be.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

mod figure_2;
mod instruments;

use super::*;
use crate::numerics::count::whole;
use crate::numerics::statistics::{median, robust_deviation, variance};
use crate::plant::{Input, Model, Motor, MotorKey, Plant, Scenario, State};
use crate::sample::Channel;

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
        let motor = Motor::new("test")
            .with(MotorKey::Resistance, R)
            .with(MotorKey::Inductance, truth.ta_s * R)
            .with(MotorKey::BackEmf, KE)
            .with(MotorKey::Inertia, truth.inertia())
            .with(MotorKey::LoadTorque, truth.load_v * KE / R);
        let scenario = Scenario {
            name: String::new(),
            input: Input::Voltage,
            input_channel: Channel::Voltage,
            events: (1..samples)
                .map(|k| ((k - 1) as f64 * period_s, voltage_v[k]))
                .collect(),
            sample_time_s: (0..samples).map(|k| k as f64 * period_s).collect(),
            current_a: vec![],
            speed_rad_s: vec![],
            angle: vec![],
            time_half_width_s: vec![],
            unknown_input: vec![],
            scored: 0..samples,
        };
        let out = Plant::new(&Model::baseline(motor), Input::Voltage)
            .unwrap()
            .simulate(&scenario, State::default());
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
        for speed in &mut self.speed_rad_s {
            *speed += sigma * rng.sample::<f64, _>(StandardNormal);
        }
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
                level = if rng.random::<bool>() {
                    amplitude_v
                } else {
                    -amplitude_v
                };
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
            let truth = Truth {
                ta_s: 0.02,
                tm_s: 0.02 * ratio,
                load_v: 2.0,
            };
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
            for error in errors {
                assert!(
                    error.abs() < 0.1,
                    "TM/Ta {ratio} T/Ta {alpha}: {errors:?} %"
                );
            }
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
        let truth = Truth {
            ta_s: 0.02,
            tm_s: 0.02 * ratio,
            load_v: 2.0,
        };
        let record = Record::of(truth, 0.02, binary(20_000, 5, 30.0, 15.0, 7));
        let found = record.feed(Form::Printed, 1.0).parameters(R, None).unwrap();
        let errors = [
            off(found.ta_s, truth.ta_s),
            off(found.tm_s, truth.tm_s),
            off(found.ke, KE),
        ];
        assert!(
            (errors[0] - ta).abs() < 1.0 && (errors[1] - tm).abs() < 1.0,
            "{ratio} {errors:?}"
        );
        assert!(errors[2].abs() < 1.0, "{ratio} {errors:?}");
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
            let truth = Truth {
                ta_s: 0.02,
                tm_s: 0.02 * ratio,
                load_v: 2.0,
            }
            .dynamics();
            let period_s = 0.02 * alpha;
            let there = Coefficients::of_motor(&truth, period_s);
            let back = Dynamics::from_coefficients(Form::Exact, &there, period_s).unwrap();
            for (found, given) in back.to_array().iter().zip(truth.to_array()) {
                assert!(
                    (found / given - 1.0).abs() < 1e-6,
                    "{ratio} {alpha} {back:?}"
                );
            }
        }
    }
}

#[test]
fn at_constant_voltage_the_estimate_neither_winds_up_nor_drifts_away() {
    let mut volts = binary(600, 10, 60.0, 25.0, 3);
    volts.extend(std::iter::repeat_n(60.0, 20_000));
    let record = Record::of(SLOW, 0.02, volts).with_sensor_noise(1e7, 8);
    let before = record
        .feed_until(600, Form::Exact, 0.97)
        .dynamics()
        .unwrap();
    let after = record.feed(Form::Exact, 0.97);
    // Noise of the sensor alone moves Ta and TM at rest, but the prior never takes over.
    let spread = after.covariance().unwrap();
    assert!(
        (0..5).all(|j| spread[j][j].is_finite() && spread[j][j] < 1.0),
        "{spread:?}"
    );
    let after = after.dynamics().unwrap();
    assert!(
        (after.ke / before.ke - 1.0).abs() < 0.1,
        "{before:?} {after:?}"
    );
}

#[test]
fn a_missing_sample_and_a_reversal_leave_rows_out_and_spoil_nothing() {
    let truth = Truth {
        ta_s: 0.02,
        tm_s: 0.08,
        load_v: 2.0,
    };
    let mut record = Record::of(truth, 0.01, binary(4000, 12, 0.0, 30.0, 2));
    for k in (100..4000).step_by(97) {
        record.speed_rad_s[k] = f64::NAN;
    }
    let scheme = record.feed(Form::Exact, 1.0);
    assert!(
        scheme.rows() < 3900 && scheme.rows() > 1500,
        "{}",
        scheme.rows()
    );
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
    let cases = [
        (
            exact(Coefficients {
                p: 2.7,
                q: 1.8,
                ..good
            }),
            "poles",
        ),
        (
            exact(Coefficients {
                p: 0.1,
                q: 0.2,
                ..good
            }),
            "-a2",
        ),
        (
            exact(Coefficients {
                p: -0.1,
                q: 1e-3,
                ..good
            }),
            "-a2",
        ),
        (
            exact(Coefficients {
                voltage: -1e-3,
                ..good
            }),
            "b1 + b2",
        ),
        (exact(Coefficients { q: -1e-3, ..good }), "1 - a1 - a2"),
        (printed(Coefficients { p: -0.1, ..good }), "2 - a1"),
        (
            printed(Coefficients {
                q: f64::NAN,
                ..good
            }),
            "1 - a1 - a2",
        ),
        (
            exact(Coefficients {
                p: f64::NAN,
                ..good
            }),
            "-a2",
        ),
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
        let (without, used) =
            noise_free(Form::Exact, &record.series(), &record.direction, noise).unwrap();
        assert!(
            found(without).abs() < left * biased.abs(),
            "{biased} {}",
            found(without)
        );
        assert!((used / sigma - 1.0).abs() < 0.3, "{used} {sigma}");
    }
    assert!(biased < -5.0, "{biased}");
}

//! Errors of every scheme of the catalogue on one emulated record, and what the paper does not show: these errors against
//! the sampling period and against the noise of the sensors.
//!
//! A scheme is given what the paper gives it and nothing more: schemes 1 the resistance, schemes 2 the torque constant,
//! every other one nothing at all.

use rayon::prelude::*;
use serde::{Serialize, Serializer};

use super::CHOSEN;
use super::machine::{COMPLETE, figures, forward, motor, simulated, stamps, value};
use super::machine::{SignalToNoise, random, random_binary, white, with_noise};
use drivebench::identification::scheme::{CATALOGUE, Data, Scheme};
use drivebench::identification::scheme_1::{Form, Scheme1};
use drivebench::numerics::count::whole;
use drivebench::numerics::statistics::median;
use drivebench::plant::{Input, Model, Motor, MotorKey, Scenario, State};
use drivebench::sample::{Channel, Origin, Run};

/// Names of the errors, in the order of [`Errors`].
pub const NAMES: [&str; 5] = ["Ta", "TM", "Ke", "J", "Mc"];

/// Error of each parameter, per cent of the truth; `None` where the scheme does not give it or the data do not carry it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors(pub [Option<f64>; 5]);

impl Errors {
    /// Of what was found, in the order of [`NAMES`].
    fn between(found: [Option<f64>; 5], truth: &Motor) -> Self {
        let truth = figures(truth);
        let error = |which: usize| Some(100.0 * (found[which]? / truth[which]? - 1.0));
        Self(std::array::from_fn(error))
    }

    /// Median of each error; none where fewer than half of the records give it.
    fn medians(all: &[Self]) -> Self {
        Self(std::array::from_fn(|which| {
            let given: Vec<f64> = all.iter().filter_map(|errors| errors.0[which]).collect();
            (2 * given.len() > all.len()).then(|| median(&given))
        }))
    }
}

impl Serialize for Errors {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let keys = [
            "electrical_time_constant",
            "mechanical_time_constant",
            "back_emf",
            "inertia",
            "load_torque",
        ];
        serializer.collect_map(keys.iter().zip(&self.0))
    }
}

struct Record {
    motor: Motor,
    run: Run,
    scenario: Scenario,
}

/// From rest under two voltages in turn, each held between Ta and 3 TM; noise on current and speed where `noise` says.
fn record(
    motor: &Motor,
    period_s: f64,
    samples: usize,
    seed: u64,
    noise: Option<SignalToNoise>,
) -> Record {
    let [ta_s, tm_s, ..] = figures(motor).map(|value| value.expect(COMPLETE));
    // Between the time constants, but never the same length again and again: that would excite one frequency only.
    let shortest = whole(ta_s / period_s).max(1);
    let longest = whole(3.0 * tm_s / period_s).max(shortest + 3);
    // Samples at rest before the first step: enough to measure the noise.
    let rest = 30;
    let (rng, turning) = (&mut random(seed, 1), samples - rest);
    let mut volts = vec![0.0; rest];
    volts.extend(random_binary(rng, CHOSEN.levels_v, shortest..=longest, turning));
    let times = stamps(period_s, samples);
    let events = times.iter().copied().zip(volts.iter().copied()).collect();
    let name = format!("period {period_s} s, seed {seed}");
    let mut scenario =
        Scenario::planned(name, Input::Voltage, Channel::VoltageCmd, events, times.clone());
    let clean = simulated(motor, &scenario, State::default());
    let sensor = |clean: Vec<f64>, purpose: u64| match noise {
        None => clean,
        Some(ratio) => {
            let deviation = ratio.noise_for(&clean[rest..]);
            let noise = white(&mut random(seed, purpose), samples);
            with_noise(&clean, &noise, deviation)
        }
    };
    scenario.current_a = sensor(clean.current_a, 2);
    scenario.speed_rad_s = sensor(clean.speed_rad_s, 3);
    let mut run = Run::new(scenario.name.clone(), times).expect("stamps increase");
    let (current, speed) = (scenario.current_a.clone(), scenario.speed_rad_s.clone());
    for (channel, cells, origin) in [
        (Channel::VoltageCmd, volts, Origin::Commanded),
        (Channel::Current, current, Origin::Measured),
        (Channel::Speed, speed, Origin::Measured),
    ] {
        run.set_column(channel, cells, origin).expect("every column has one cell per stamp");
    }
    Record { motor: motor.clone(), run, scenario }
}

/// The schemes that take part: all that read these records.
fn taking_part() -> impl Iterator<Item = &'static Scheme> {
    // Inverse dynamics filters, which takes many samples per time constant; a step response takes one long step.
    let apart = ["inverse-dynamics", "step-response"];
    let all = CATALOGUE.iter().copied();
    all.filter(move |scheme| !apart.contains(&scheme.id()))
}

/// What the paper gives to a scheme.
fn known(scheme: &Scheme, truth: &Motor) -> Model {
    let mut motor = Motor::new("sought");
    let mut fixed = Vec::new();
    let mut give = |key: MotorKey, value: f64| {
        motor.set(key, value);
        fixed.push(key.key().to_owned());
    };
    match scheme.id().split('-').next() {
        Some("1") => give(MotorKey::Resistance, value(truth, MotorKey::Resistance)),
        Some("2") => give(MotorKey::TorqueConstant, value(truth, MotorKey::BackEmf)),
        _ => {}
    }
    let mut model = Model::baseline(motor);
    model.fixed = fixed;
    model
}

fn errors(scheme: &Scheme, record: &Record) -> Errors {
    let model = known(scheme, &record.motor);
    let data = Data { run: &record.run, scenario: &record.scenario, model: &model };
    let Ok(found) = scheme.identify(&data) else {
        return Errors::default();
    };
    let mut all = model.motor.clone();
    for key in MotorKey::ALL {
        let mut parameters = found.parameters.iter();
        let own = parameters.find(|parameter| parameter.key == key.key());
        if let Some(value) = own.and_then(|parameter| parameter.value) {
            all.set(key, value);
        }
    }
    Errors::between(figures(&all), &record.motor)
}

/// Errors of one scheme at each ratio.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    pub scheme: &'static str,
    pub errors: Vec<Errors>,
}

/// For each scheme of these, the medians over the records of each ratio.
fn curves(records: &[Vec<Record>], taken: impl Fn(&str) -> bool) -> Vec<Curve> {
    let curve = |scheme: &'static Scheme| {
        let median = |records: &Vec<Record>| {
            let found = records.par_iter().map(|record| errors(scheme, record));
            Errors::medians(&found.collect::<Vec<_>>())
        };
        Curve { scheme: scheme.id(), errors: records.par_iter().map(median).collect() }
    };
    let taken = taking_part().filter(|scheme| taken(scheme.id()));
    taken.map(curve).collect()
}

/// T/Ta and T/TM: two to a factor of three and a half.
const PERIOD_RATIOS: [f64; 11] = [0.01, 0.02, 0.03, 0.06, 0.1, 0.2, 0.3, 0.6, 1.0, 2.0, 3.0];
/// Ta of the ZK-22FC, s.
const ZK_22FC_TA_S: f64 = 0.009;
const FEWEST_SAMPLES: usize = 400;
const SEED: u64 = 1;
/// TM/Ta of the motors that are sampled at T = Ta.
const AT_TA: [f64; 5] = [1.0, 2.0, 5.0, 10.0, 30.0];

/// One motor sampled with ever longer periods, without noise.
#[derive(Clone, Debug, Serialize)]
pub struct Sweep {
    /// `T/Ta` or `T/TM`.
    pub against: &'static str,
    pub tm_over_ta: f64,
    pub electrical_time_constant_s: f64,
    pub ratios: Vec<f64>,
    pub curves: Vec<Curve>,
}

/// The printed and the exact form of scheme 1 at T = Ta.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AtTa {
    pub tm_over_ta: f64,
    pub printed: Errors,
    pub exact: Errors,
}

#[derive(Clone, Debug, Serialize)]
pub struct Sampling {
    pub sweeps: Vec<Sweep>,
    pub at_ta: Vec<AtTa>,
}

pub(super) fn sampling() -> Sampling {
    Sampling {
        sweeps: vec![
            // Both poles real and well apart.
            sweep("T/Ta", ZK_22FC_TA_S, 5.0),
            // A choke before the armature, so that it is its armature circuit that oscillates.
            sweep("T/TM", 0.03, 1.0),
        ],
        at_ta: AT_TA.map(at_ta).into(),
    }
}

fn sweep(against: &'static str, ta_s: f64, tm_over_ta: f64) -> Sweep {
    let tm_s = tm_over_ta * ta_s;
    let motor = motor(ta_s, tm_s);
    let unit_s = if against == "T/TM" { tm_s } else { ta_s };
    let sampled = |ratio: f64| {
        let period_s = ratio * unit_s;
        // A record lasts at least 40 mechanical time constants.
        let samples = whole(40.0 * tm_s / period_s).max(FEWEST_SAMPLES);
        vec![record(&motor, period_s, samples, SEED, None)]
    };
    let records: Vec<_> = PERIOD_RATIOS.into_par_iter().map(sampled).collect();
    Sweep {
        against,
        tm_over_ta,
        electrical_time_constant_s: ta_s,
        ratios: PERIOD_RATIOS.into(),
        curves: curves(&records, |_| true),
    }
}

fn at_ta(tm_over_ta: f64) -> AtTa {
    let motor = motor(ZK_22FC_TA_S, tm_over_ta * ZK_22FC_TA_S);
    let volts = random_binary(&mut random(SEED, 1), CHOSEN.levels_v, CHOSEN.hold, FEWEST_SAMPLES);
    let turning = forward(&[(&motor, FEWEST_SAMPLES)], ZK_22FC_TA_S, &volts, None);
    let of = |form: Form| {
        let mut scheme = Scheme1::new(form, ZK_22FC_TA_S, 1.0);
        for (k, at) in turning.iter().enumerate() {
            // The voltage of the interval that ends at this sample.
            scheme.push(volts[k.saturating_sub(1)], at.speed_rad_s, 1);
        }
        let found = scheme.parameters(value(&motor, MotorKey::Resistance), None);
        found.map_or_else(
            |_| Errors::default(),
            |found| {
                let (ta_s, tm_s) = (found.ta_s, found.tm_s);
                let found = [ta_s, tm_s, found.ke, found.inertia, found.load_torque];
                Errors::between(found.map(Some), &motor)
            },
        )
    };
    AtTa { tm_over_ta, printed: of(Form::Printed), exact: of(Form::Exact) }
}

/// Ratios of power.
const NOISE_RATIOS: [f64; 6] = [10.0, 100.0, 1e3, 1e4, 1e5, 1e6];

/// Medians over the seeds against signal-to-noise, the noise on the sensors.
#[derive(Clone, Debug, Serialize)]
pub struct NoiseSweep {
    pub electrical_time_constant_s: f64,
    pub mechanical_time_constant_s: f64,
    pub period_s: f64,
    pub samples: usize,
    pub seeds: u64,
    /// Of power, on speed and current alike.
    pub signal_to_noise: Vec<f64>,
    pub curves: Vec<Curve>,
    pub long: Long,
}

/// Schemes 1 on a long record at the worst ratio: what the number of samples mends, and what it does not.
#[derive(Clone, Debug, Serialize)]
pub struct Long {
    pub signal_to_noise: f64,
    pub samples: usize,
    pub seeds: u64,
    pub curves: Vec<Curve>,
}

pub(super) fn noise() -> NoiseSweep {
    let motor = motor(CHOSEN.ta_s, CHOSEN.tm_s);
    let (samples, seeds) = (3000, 5);
    let (long_samples, long_seeds) = (20_000, 7);
    let records = |ratios: &[f64], samples: usize, seeds: u64| -> Vec<Vec<Record>> {
        let of = |ratio: &f64| {
            let noise = Some(SignalToNoise::power(*ratio));
            let record = |seed| record(&motor, CHOSEN.period_s, samples, seed, noise);
            (0..seeds).map(record).collect()
        };
        ratios.par_iter().map(of).collect()
    };
    let long = records(&NOISE_RATIOS[..1], long_samples, long_seeds);
    NoiseSweep {
        electrical_time_constant_s: CHOSEN.ta_s,
        mechanical_time_constant_s: CHOSEN.tm_s,
        period_s: CHOSEN.period_s,
        samples,
        seeds,
        signal_to_noise: NOISE_RATIOS.into(),
        curves: curves(&records(&NOISE_RATIOS, samples, seeds), |_| true),
        long: Long {
            signal_to_noise: NOISE_RATIOS[0],
            samples: long_samples,
            seeds: long_seeds,
            curves: curves(&long, |id| id.starts_with('1')),
        },
    }
}

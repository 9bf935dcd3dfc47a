//! Figure 3: scheme 2 (current and speed give J and Mc), beta 0.98, S/N <= 15.
//!
//! The paper states neither where the noise enters nor what S/N is a ratio of, so both readings are computed.

use rayon::prelude::*;
use serde::Serialize;

use super::machine::{SignalToNoise, Spread, random, random_binary, white, with_noise};
use super::machine::{Turning, forward, motor, value};
use super::{CHOSEN, NoiseModel, Trace};
use drivebench::identification::recursive::{CurrentIntegral, Scheme2};
use drivebench::plant::{Motor, MotorKey};

pub(super) struct Settings {
    /// The paper's.
    pub forgetting: f64,
    signal_to_noise: f64,
    samples: usize,
    /// The spread counts from here on: the memory of 50 samples has filled several times.
    settled_from: usize,
}

pub(super) const SETTINGS: Settings =
    Settings { forgetting: 0.98, signal_to_noise: 15.0, samples: 900, settled_from: 300 };

/// One way of making the noise and of integrating the current.
#[derive(Clone, Debug, Serialize)]
pub struct Case {
    pub noise: NoiseModel,
    pub signal_to_noise: SignalToNoise,
    /// What S/N compares.
    pub of_signal: &'static str,
    /// `rectangle` is the printed form.
    pub integral: &'static str,
    pub inertia_kg_m2: Spread,
    pub load_torque_n_m: Spread,
    /// Estimates of the first seed.
    pub inertia_trace: Trace,
    pub load_torque_trace: Trace,
}

#[derive(Clone, Debug, Serialize)]
pub struct Figure3 {
    pub forgetting: f64,
    pub period_s: f64,
    pub samples: usize,
    pub settled_from: usize,
    pub seeds: u64,
    pub inertia_kg_m2: f64,
    pub load_torque_n_m: f64,
    pub cases: Vec<Case>,
}

/// What a case is made of: noise model, ratio, whether the current is noisy too, integral.
type Setup = (NoiseModel, SignalToNoise, bool, CurrentIntegral);

pub(super) fn figure_3() -> Figure3 {
    use CurrentIntegral::{Rectangle, Trapezoid};
    use NoiseModel::{EquationError, Sensor};
    let (power, amplitude) = (
        SignalToNoise::power(SETTINGS.signal_to_noise),
        SignalToNoise::amplitude(SETTINGS.signal_to_noise),
    );
    let setups: [Setup; 6] = [
        (EquationError, amplitude, false, Rectangle),
        (EquationError, power, false, Rectangle),
        (EquationError, power, false, Trapezoid),
        (Sensor, power, false, Rectangle),
        (Sensor, power, false, Trapezoid),
        (Sensor, power, true, Trapezoid),
    ];
    let motor = motor(CHOSEN.ta_s, CHOSEN.tm_s);
    Figure3 {
        forgetting: SETTINGS.forgetting,
        period_s: CHOSEN.period_s,
        samples: SETTINGS.samples,
        settled_from: SETTINGS.settled_from,
        seeds: CHOSEN.seeds,
        inertia_kg_m2: value(&motor, MotorKey::Inertia),
        load_torque_n_m: value(&motor, MotorKey::LoadTorque),
        cases: setups.map(|setup| case(&motor, setup)).into(),
    }
}

fn case(motor: &Motor, setup: Setup) -> Case {
    let seeds = (0..CHOSEN.seeds).into_par_iter();
    let traces: Vec<[Vec<f64>; 2]> = seeds.map(|seed| estimates(motor, setup, 1 + seed)).collect();
    let spread = |key: MotorKey, which: usize| {
        let settled = traces.iter().flat_map(|trace| &trace[which][SETTINGS.settled_from..]);
        Spread::of(value(motor, key), settled.copied())
    };
    let (noise, signal_to_noise, current_noise, integral) = setup;
    let [inertia_trace, load_torque_trace] = traces[0].clone().map(Trace);
    Case {
        noise,
        signal_to_noise,
        of_signal: match (noise, current_noise) {
            (NoiseModel::EquationError, _) => "the speed's change per period, to epsilon",
            (NoiseModel::Sensor, false) => "speed, to the noise on it; current exact",
            (NoiseModel::Sensor, true) => "speed and current, to the noise on each",
        },
        integral: match integral {
            CurrentIntegral::Rectangle => "rectangle",
            CurrentIntegral::Trapezoid => "trapezoid",
        },
        inertia_kg_m2: spread(MotorKey::Inertia, 0),
        load_torque_n_m: spread(MotorKey::LoadTorque, 1),
        inertia_trace,
        load_torque_trace,
    }
}

/// J and Mc over the samples of one seed.
fn estimates(motor: &Motor, setup: Setup, seed: u64) -> [Vec<f64>; 2] {
    let (noise, ratio, current_noise, integral) = setup;
    let volts = random_binary(&mut random(seed, 1), CHOSEN.levels_v, CHOSEN.hold, SETTINGS.samples);
    let clean = forward(&[(motor, SETTINGS.samples)], CHOSEN.period_s, &volts, None);
    let columns = |turning: &[Turning]| -> (Vec<f64>, Vec<f64>) {
        turning.iter().map(|at| (at.speed_rad_s, at.current_a)).unzip()
    };
    let (mut speed, mut current) = columns(&clean);
    let errors = white(&mut random(seed, 2), SETTINGS.samples);
    match noise {
        NoiseModel::EquationError => {
            let steps: Vec<f64> = speed.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let deviation = ratio.noise_for(&steps);
            let disturbances: Vec<f64> = errors.iter().map(|error| deviation * error).collect();
            let disturbed =
                forward(&[(motor, SETTINGS.samples)], CHOSEN.period_s, &volts, Some(&disturbances));
            (speed, current) = columns(&disturbed);
        }
        NoiseModel::Sensor => {
            if current_noise {
                let errors = white(&mut random(seed, 3), SETTINGS.samples);
                current = with_noise(&current, &errors, ratio.noise_for(&current));
            }
            speed = with_noise(&speed, &errors, ratio.noise_for(&speed));
        }
    }
    let mut scheme = Scheme2::new(integral, SETTINGS.forgetting, 0.0);
    let torque = Some((value(motor, MotorKey::BackEmf), 0.0));
    let estimate = |k: usize| {
        scheme.push(CHOSEN.period_s * k as f64, current[k], speed[k]);
        let found = scheme.estimates(torque);
        let [inertia, load] = [0, 1].map(|which: usize| found[which].value.unwrap_or(f64::NAN));
        (inertia, load)
    };
    let (inertia, load) = (0..SETTINGS.samples).map(estimate).unzip();
    [inertia, load]
}

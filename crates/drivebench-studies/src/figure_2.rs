//! Figure 2: scheme 1 (voltage and speed give TM, Ta, Ke, J, Mc), beta 0.97, S/N <= 10, TM doubled at k = 900.
//!
//! The paper states neither where the noise enters nor what S/N is a ratio of. As an equation error, the figure can be met;
//! with the same ratio on the speed sensor it cannot, whatever the form: least squares is then biased. The instrumental
//! variables are not, but they need hundreds of samples, and get the sample of the jump here.

use drivebench::tabulated;
use std::array::from_fn;
use std::ops::Index;

use rayon::prelude::*;
use serde::{Serialize, Serializer};

use super::machine::{COMPLETE, ZeroOrderHold, figures, forward, motor, value};
use super::machine::{RatioOf, SignalToNoise, Spread, random, random_binary, white, with_noise};
use super::{CHOSEN, NoiseModel, Trace};
use drivebench::identification::scheme_1::{
    Form, Scheme1, Scheme1Values, Series, instrumental_variables,
};
use drivebench::numerics::statistics::{median, variance};
use drivebench::plant::{Motor, MotorKey};

/// The figure's own values, and what its schemes need.
struct Settings {
    /// The paper's.
    forgetting: f64,
    signal_to_noise: f64,
    jump_at: usize,
    jump: f64,
    samples: usize,
    /// Samples after the start and after the jump in which the memory of 33 samples fills; the spread counts after them.
    filling: usize,
    /// Samples between two batches of the instrumental variables in the picture, and in the first of them.
    batch_stride: usize,
    /// Samples in which the auxiliary model of the instrumental variables runs up: many times TM.
    run_up: usize,
}

const FIGURE: Settings = Settings {
    forgetting: 0.97,
    signal_to_noise: 10.0,
    jump_at: 900,
    jump: 2.0,
    samples: 1800,
    filling: 300,
    batch_stride: 25,
    run_up: 150,
};

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Method {
        /// Scheme 1 as printed, eq. (17), with the paper's forgetting.
        Printed = "printed",
        /// Eq. (13) and the exact inverse, with the paper's forgetting.
        Exact = "exact",
        /// As printed, every sample since the start or the jump counting alike.
        PrintedBatch = "printed_batch",
        /// Instrumental variables over every sample since the start or the jump.
        InstrumentalVariables = "instrumental_variables",
    }
    /// In file columns.
    pub(super) const fn name(self) -> &'static str;
}

impl Method {
    /// With the known sample of the jump, and without forgetting.
    pub(super) const fn is_batch(self) -> bool {
        matches!(self, Self::PrintedBatch | Self::InstrumentalVariables)
    }
}

/// Places of the parameters in [`ByParameter`]; J stands between Ke and Mc.
pub(super) const TM: usize = 0;
pub(super) const TA: usize = 1;
pub(super) const KE: usize = 2;
pub(super) const MC: usize = 4;
/// Their heads in files.
pub(super) const COLUMNS: [&str; 5] =
    ["tm_s", "ta_s", "back_emf_v_s_per_rad", "inertia_kg_m2", "load_torque_n_m"];

/// Estimates over time or their spread, by parameter; an object in JSON.
#[derive(Clone, Debug)]
pub struct ByParameter<T>(pub [T; 5]);

impl<T> Index<usize> for ByParameter<T> {
    type Output = T;

    fn index(&self, which: usize) -> &T {
        &self.0[which]
    }
}

impl<T: Serialize> Serialize for ByParameter<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let time_constants = ["mechanical_time_constant_s", "electrical_time_constant_s"];
        let keys = time_constants.iter().chain(&COLUMNS[KE..]);
        serializer.collect_map(keys.zip(&self.0))
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct Case {
    pub noise: NoiseModel,
    pub signal_to_noise: SignalToNoise,
    pub method: Method,
    /// Over time and seeds before the jump, and after it. A batch counts once, at its end.
    pub before: ByParameter<Spread>,
    pub after: ByParameter<Spread>,
    /// Samples after the jump until the median over the seeds has made nine tenths of the step of TM; `None`: it never
    /// does, or the method gets the sample of the jump.
    pub samples_to_follow: Option<usize>,
    /// Estimates of the first seed.
    pub trace: ByParameter<Trace>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Figure2 {
    pub forgetting: f64,
    pub period_s: f64,
    pub samples: usize,
    pub jump_at: usize,
    pub settled_after: usize,
    pub seeds: u64,
    pub cases: Vec<Case>,
    /// Set values over the samples, for the picture.
    #[serde(skip)]
    pub set: ByParameter<Vec<f64>>,
}

impl Figure2 {
    /// The case of that noise, reading of S/N and method, if it was computed.
    pub fn case(&self, noise: NoiseModel, of: RatioOf, method: Method) -> Option<&Case> {
        let is = |case: &&Case| {
            (case.noise, case.signal_to_noise.of, case.method) == (noise, of, method)
        };
        self.cases.iter().find(is)
    }
}

/// TM, Ta and the rest in the order of [`ByParameter`].
type Five = [f64; 5];
type Setup = (NoiseModel, SignalToNoise, Method);

pub(super) fn figure_2() -> Figure2 {
    use Method::{Exact, InstrumentalVariables, Printed, PrintedBatch};
    use NoiseModel::{EquationError, Sensor};
    let (power, amplitude) = (
        SignalToNoise::power(FIGURE.signal_to_noise),
        SignalToNoise::amplitude(FIGURE.signal_to_noise),
    );
    let setups: [Setup; 8] = [
        (EquationError, amplitude, Printed),
        (EquationError, power, Printed),
        (EquationError, power, Exact),
        (Sensor, amplitude, Printed),
        (Sensor, power, Printed),
        (Sensor, power, Exact),
        (Sensor, power, PrintedBatch),
        (Sensor, power, InstrumentalVariables),
    ];
    let set: Vec<Five> = motors().iter().map(truth).collect();
    let held = |which: usize| {
        let of = |k: usize| set[usize::from(k >= FIGURE.jump_at)][which];
        (0..FIGURE.samples).map(of).collect()
    };
    Figure2 {
        forgetting: FIGURE.forgetting,
        period_s: CHOSEN.period_s,
        samples: FIGURE.samples,
        jump_at: FIGURE.jump_at,
        settled_after: FIGURE.filling,
        seeds: CHOSEN.seeds,
        cases: setups.map(case).into(),
        set: ByParameter(from_fn(held)),
    }
}

fn motors() -> [Motor; 2] {
    [motor(CHOSEN.ta_s, CHOSEN.tm_s), motor(CHOSEN.ta_s, FIGURE.jump * CHOSEN.tm_s)]
}

fn truth(motor: &Motor) -> Five {
    let [ta, tm, ke, inertia, load] = figures(motor);
    [tm, ta, ke, inertia, load].map(|value| value.expect(COMPLETE))
}

fn case(setup: Setup) -> Case {
    let (noise, signal_to_noise, method) = setup;
    let every: Vec<Vec<Five>> = (0..CHOSEN.seeds)
        .into_par_iter()
        .map(|seed| estimates(setup, 1 + seed, seed == 0))
        .collect();
    let spread = |motor: &Motor, from: usize, to: usize| {
        let truth = truth(motor);
        let first = if method.is_batch() { to - 1 } else { from + FIGURE.filling };
        ByParameter(from_fn(|which| {
            let estimates = every.iter().flat_map(|seed| &seed[first..to]);
            Spread::of(truth[which], estimates.map(|five| five[which]))
        }))
    };
    let [before, after] = motors();
    Case {
        noise,
        signal_to_noise,
        method,
        before: spread(&before, 0, FIGURE.jump_at),
        after: spread(&after, FIGURE.jump_at, FIGURE.samples),
        samples_to_follow: (!method.is_batch()).then(|| follows(&every)).flatten(),
        trace: ByParameter(from_fn(|which| {
            Trace(every[0].iter().map(|five| five[which]).collect())
        })),
    }
}

/// Samples after the jump until the median over the seeds has gone nine tenths of the way to the new TM.
fn follows(every: &[Vec<Five>]) -> Option<usize> {
    let goal = CHOSEN.tm_s * (1.0 + 0.9 * (FIGURE.jump - 1.0));
    let middle = |k: usize| median(&every.iter().map(|seed| seed[k][0]).collect::<Vec<_>>());
    // An estimate that was near the new value before the jump does not follow it.
    let was_near = middle(FIGURE.jump_at - 1) >= goal;
    (FIGURE.jump_at..FIGURE.samples)
        .find(|k| middle(*k) >= goal)
        .filter(|_| !was_near)
        .map(|k| k - FIGURE.jump_at)
}

/// Voltage held from each sample to the next, and the measured speed.
fn record(noise: NoiseModel, ratio: SignalToNoise, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let volts = random_binary(&mut random(seed, 1), CHOSEN.levels_v, CHOSEN.hold, FIGURE.samples);
    let [before, after] = motors();
    let pieces = [(&before, FIGURE.jump_at), (&after, FIGURE.samples - FIGURE.jump_at)];
    let clean: Vec<f64> =
        forward(&pieces, CHOSEN.period_s, &volts, None).iter().map(|at| at.speed_rad_s).collect();
    let mut errors = white(&mut random(seed, 2), FIGURE.samples);
    let deviation = match noise {
        NoiseModel::Sensor => ratio.noise_for(&clean),
        NoiseModel::EquationError => {
            // What the equation error does to the speed: eq. (13) is linear, so it adds to the clean one. The ratio is
            // that of the speed to this part of it.
            let [early, late] = [&before, &after]
                .map(|motor| ZeroOrderHold::new(motor, CHOSEN.period_s).difference_equation());
            for k in 0..FIGURE.samples {
                let [a1, a2, ..] = if k < FIGURE.jump_at { early } else { late };
                let back = |by: usize| k.checked_sub(by).map_or(0.0, |at| errors[at]);
                errors[k] += a1 * back(1) + a2 * back(2);
            }
            ratio.noise_for(&clean) / variance(&errors).sqrt()
        }
    };
    let speed = with_noise(&clean, &errors, deviation);
    (volts, speed)
}

/// Estimates after each sample, NaN where there is none.
fn estimates((noise, ratio, method): Setup, seed: u64, whole_trace: bool) -> Vec<Five> {
    let (volts, speed) = record(noise, ratio, seed);
    // Scheme 1 takes with each sample the voltage of the interval that ends there.
    let ending = [&volts[..1], &volts[..FIGURE.samples - 1]].concat();
    let resistance = value(&motors()[0], MotorKey::Resistance);
    match method {
        Method::Printed | Method::Exact | Method::PrintedBatch => {
            let exact = method == Method::Exact;
            let form = if exact { Form::Exact } else { Form::Printed };
            let forgetting = if method.is_batch() { 1.0 } else { FIGURE.forgetting };
            let fresh = || Scheme1::new(form, CHOSEN.period_s, forgetting);
            let mut scheme = fresh();
            let estimate = |k: usize| {
                if method.is_batch() && k == FIGURE.jump_at {
                    scheme = fresh();
                }
                scheme.push(ending[k], speed[k], FORWARD);
                five(scheme.parameters(resistance, None).ok())
            };
            (0..FIGURE.samples).map(estimate).collect()
        }
        Method::InstrumentalVariables => by_instruments(&ending, &speed, resistance, whole_trace),
    }
}

/// Instrumental variables over all samples since the start or the jump, now and then and at the end of each.
fn by_instruments(ending: &[f64], speed: &[f64], resistance: f64, whole_trace: bool) -> Vec<Five> {
    // The auxiliary model starts from rest: it is given the voltage of before, under which it runs up, but no speed.
    let voltage = [&[ending[0]; FIGURE.run_up], ending].concat();
    let mut out: Vec<Five> = Vec::with_capacity(FIGURE.samples);
    let mut before = None;
    for k in 0..FIGURE.samples {
        let begin = if k < FIGURE.jump_at { 0 } else { FIGURE.jump_at };
        let length = k + 1 - begin;
        let at_end = k + 1 == FIGURE.jump_at || k + 1 == FIGURE.samples;
        let due = at_end || (whole_trace && length.is_multiple_of(FIGURE.batch_stride));
        let held = if length > 1 { out[k - 1] } else { five(None) };
        out.push(if due {
            let measured = [&vec![f64::NAN; FIGURE.run_up + begin], &speed[begin..=k]].concat();
            let forward = |w: &f64| if w.is_nan() { 0 } else { FORWARD };
            let direction: Vec<i8> = measured.iter().map(forward).collect();
            let series = Series {
                period_s: CHOSEN.period_s,
                voltage_v: &voltage[..measured.len()],
                speed_rad_s: &measured,
            };
            let found = instrumental_variables(&series, &direction, before);
            let dynamics = found.ok().map(|found| found.dynamics);
            if k + 1 == FIGURE.jump_at {
                // The motor before the jump is the first guess of the one after it.
                before = dynamics;
            }
            five(dynamics.and_then(|dynamics| dynamics.values(resistance, None).ok()))
        } else {
            held
        });
    }
    out
}

/// The motors of the figure turn forward throughout; a test holds them to it.
const FORWARD: i8 = 1;

fn five(values: Option<Scheme1Values>) -> Five {
    values.map_or([f64::NAN; 5], |found| {
        let (ke, inertia) = (found.ke, found.inertia);
        [found.tm_s, found.ta_s, ke, inertia, found.load_torque]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shaft_turns_forward_throughout() {
        for noise in [NoiseModel::EquationError, NoiseModel::Sensor] {
            for seed in 0..CHOSEN.seeds {
                let (_, speed) =
                    record(noise, SignalToNoise::power(FIGURE.signal_to_noise), 1 + seed);
                assert!(speed.iter().all(|w| *w > 0.0), "{noise:?} {seed}");
            }
        }
    }
}

//! Figure 2: scheme 1 (voltage and speed give TM, Ta, Ke, J, Mc), beta 0.97, S/N <= 10, TM doubled at k = 900.
//!
//! The paper says neither where the noise enters nor what S/N is a ratio of. As an equation error, the figure can be met;
//! with the same ratio on the speed sensor it cannot, whatever the form: least squares is then biased. The instrumental
//! variables are not, but they need hundreds of samples, and are told here when the motor has changed.

use std::array::from_fn;
use std::ops::Index;

use rayon::prelude::*;
use serde::{Serialize, Serializer};

use super::machine::{COMPLETE, ZeroOrderHold, figures, forward, motor, value};
use super::machine::{RatioOf, SignalToNoise, Spread, random, random_binary, white, with_noise};
use super::{HOLD, LEVELS_V, NoiseModel, PERIOD_S, SEEDS, SHOWN_SEED, TA_S, TM_S, Trace};
use drivebench::identification::scheme_1::{
    Form, Scheme1, Scheme1Values, Series, instrumental_variables,
};
use drivebench::numerics::statistics::{median, variance};
use drivebench::plant::{Motor, MotorKey};

/// Paper A, Figure 2.
const FORGETTING: f64 = 0.97;
const RATIO: f64 = 10.0;
const JUMP_AT: usize = 900;
const JUMP: f64 = 2.0;
const SAMPLES: usize = 1800;
/// Samples after the start and after the jump in which the memory of 33 samples fills; the spread is told after them.
const FILLING: usize = 300;
/// Samples between two batches of the instrumental variables in the picture, and in the first of them.
const BATCH_STRIDE: usize = 25;

/// Samples in which the auxiliary model of the instrumental variables runs up: many times TM.
const RUN_UP: usize = 150;

/// How the samples become an estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Scheme 1 as printed, eq. (17), with the paper's forgetting.
    Printed,
    /// Eq. (13) and the exact inverse, with the paper's forgetting.
    Exact,
    /// As printed, every sample since the start or the jump counting alike.
    PrintedBatch,
    /// Instrumental variables over every sample since the start or the jump.
    InstrumentalVariables,
}

impl Method {
    /// In file columns.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Printed => "printed",
            Self::Exact => "exact",
            Self::PrintedBatch => "printed_batch",
            Self::InstrumentalVariables => "instrumental_variables",
        }
    }

    /// Told of the jump, and without forgetting.
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
    /// does, or the method is told of the jump.
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
type Ask = (NoiseModel, SignalToNoise, Method);

pub(super) fn figure_2() -> Figure2 {
    use Method::{Exact, InstrumentalVariables, Printed, PrintedBatch};
    use NoiseModel::{EquationError, Sensor};
    let (power, amplitude) = (SignalToNoise::power(RATIO), SignalToNoise::amplitude(RATIO));
    let asked: [Ask; 8] = [
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
        let of = |k: usize| set[usize::from(k >= JUMP_AT)][which];
        (0..SAMPLES).map(of).collect()
    };
    Figure2 {
        forgetting: FORGETTING,
        period_s: PERIOD_S,
        samples: SAMPLES,
        jump_at: JUMP_AT,
        settled_after: FILLING,
        seeds: SEEDS,
        cases: asked.map(case).into(),
        set: ByParameter(from_fn(held)),
    }
}

fn motors() -> [Motor; 2] {
    [motor(TA_S, TM_S), motor(TA_S, JUMP * TM_S)]
}

fn truth(motor: &Motor) -> Five {
    let [ta, tm, ke, inertia, load] = figures(motor);
    [tm, ta, ke, inertia, load].map(|value| value.expect(COMPLETE))
}

fn case(ask: Ask) -> Case {
    let (noise, signal_to_noise, method) = ask;
    let every: Vec<Vec<Five>> = (0..SEEDS)
        .into_par_iter()
        .map(|seed| estimates(ask, SHOWN_SEED + seed, seed == 0))
        .collect();
    let spread = |motor: &Motor, from: usize, to: usize| {
        let truth = truth(motor);
        let first = if method.is_batch() { to - 1 } else { from + FILLING };
        ByParameter(from_fn(|which| {
            let told = every.iter().flat_map(|seed| &seed[first..to]);
            Spread::of(truth[which], told.map(|five| five[which]))
        }))
    };
    let [before, after] = motors();
    Case {
        noise,
        signal_to_noise,
        method,
        before: spread(&before, 0, JUMP_AT),
        after: spread(&after, JUMP_AT, SAMPLES),
        samples_to_follow: (!method.is_batch()).then(|| follows(&every)).flatten(),
        trace: ByParameter(from_fn(|which| {
            Trace(every[0].iter().map(|five| five[which]).collect())
        })),
    }
}

/// Samples after the jump until the median over the seeds has gone nine tenths of the way to the new TM.
fn follows(every: &[Vec<Five>]) -> Option<usize> {
    let goal = TM_S * (1.0 + 0.9 * (JUMP - 1.0));
    let middle = |k: usize| median(&every.iter().map(|seed| seed[k][0]).collect::<Vec<_>>());
    // A scheme that lies there all the time follows nothing.
    let lies_there = middle(JUMP_AT - 1) >= goal;
    (JUMP_AT..SAMPLES).find(|k| middle(*k) >= goal).filter(|_| !lies_there).map(|k| k - JUMP_AT)
}

/// Voltage held from each sample to the next, and the speed that the scheme sees.
fn record(noise: NoiseModel, ratio: SignalToNoise, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let volts = random_binary(&mut random(seed, 1), LEVELS_V, HOLD, SAMPLES);
    let [before, after] = motors();
    let pieces = [(&before, JUMP_AT), (&after, SAMPLES - JUMP_AT)];
    let clean: Vec<f64> =
        forward(&pieces, PERIOD_S, &volts, None).iter().map(|at| at.speed_rad_s).collect();
    let mut errors = white(&mut random(seed, 2), SAMPLES);
    let deviation = match noise {
        NoiseModel::Sensor => ratio.noise_beside(&clean),
        NoiseModel::EquationError => {
            // What the equation error does to the speed: eq. (13) is linear, so it adds to the clean one. The ratio is
            // that of the speed to this part of it.
            let [early, late] = [&before, &after]
                .map(|motor| ZeroOrderHold::new(motor, PERIOD_S).difference_equation());
            for k in 0..SAMPLES {
                let [a1, a2, ..] = if k < JUMP_AT { early } else { late };
                let back = |by: usize| k.checked_sub(by).map_or(0.0, |at| errors[at]);
                errors[k] += a1 * back(1) + a2 * back(2);
            }
            ratio.noise_beside(&clean) / variance(&errors).sqrt()
        }
    };
    let speed = with_noise(&clean, &errors, deviation);
    (volts, speed)
}

/// Estimates after each sample, NaN where there is none.
fn estimates((noise, ratio, method): Ask, seed: u64, whole_trace: bool) -> Vec<Five> {
    let (volts, speed) = record(noise, ratio, seed);
    // Scheme 1 takes with each sample the voltage of the interval that ends there.
    let ending = [&volts[..1], &volts[..SAMPLES - 1]].concat();
    let resistance = value(&motors()[0], MotorKey::Resistance);
    match method {
        Method::Printed | Method::Exact | Method::PrintedBatch => {
            let exact = method == Method::Exact;
            let form = if exact { Form::Exact } else { Form::Printed };
            let forgetting = if method.is_batch() { 1.0 } else { FORGETTING };
            let fresh = || Scheme1::new(form, PERIOD_S, forgetting);
            let mut scheme = fresh();
            let estimate = |k: usize| {
                if method.is_batch() && k == JUMP_AT {
                    scheme = fresh();
                }
                scheme.push(ending[k], speed[k], FORWARD);
                five(scheme.parameters(resistance, None).ok())
            };
            (0..SAMPLES).map(estimate).collect()
        }
        Method::InstrumentalVariables => by_instruments(&ending, &speed, resistance, whole_trace),
    }
}

/// Instrumental variables over all samples since the start or the jump, now and then and at the end of each.
fn by_instruments(ending: &[f64], speed: &[f64], resistance: f64, whole_trace: bool) -> Vec<Five> {
    // The auxiliary model starts from rest: it is given the voltage of before, under which it runs up, but no speed.
    let voltage = [&[ending[0]; RUN_UP], ending].concat();
    let mut out: Vec<Five> = Vec::with_capacity(SAMPLES);
    let mut before = None;
    for k in 0..SAMPLES {
        let begin = if k < JUMP_AT { 0 } else { JUMP_AT };
        let length = k + 1 - begin;
        let at_end = k + 1 == JUMP_AT || k + 1 == SAMPLES;
        let due = at_end || (whole_trace && length.is_multiple_of(BATCH_STRIDE));
        let held = if length > 1 { out[k - 1] } else { five(None) };
        out.push(if due {
            let seen = [&vec![f64::NAN; RUN_UP + begin], &speed[begin..=k]].concat();
            let forward = |w: &f64| if w.is_nan() { 0 } else { FORWARD };
            let direction: Vec<i8> = seen.iter().map(forward).collect();
            let series = Series {
                period_s: PERIOD_S,
                voltage_v: &voltage[..seen.len()],
                speed_rad_s: &seen,
            };
            let found = instrumental_variables(&series, &direction, before);
            let dynamics = found.ok().map(|found| found.dynamics);
            if k + 1 == JUMP_AT {
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
            for seed in 0..SEEDS {
                let (_, speed) = record(noise, SignalToNoise::power(RATIO), SHOWN_SEED + seed);
                assert!(speed.iter().all(|w| *w > 0.0), "{noise:?} {seed}");
            }
        }
    }
}

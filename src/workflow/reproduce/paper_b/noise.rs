//! Variance of the speed with and without compensation: what kind of disturbance it takes, and what it costs.

use serde::Serialize;

use super::{SETTINGS, SPEED_RAD_S, input_noise, paper_machine, without};
use crate::control::{Course, TrialMachine, trial};
use crate::workflow::reproduce::loops::{Bench, cycles, effort_v, std};

const LENGTH_S: f64 = 4.0;
const SETTLED_S: f64 = 0.5;
const SEEDS: u64 = 4;
/// A load that wanders: standard deviation and correlation time.
const WANDER_N_M: f64 = 1.0;
const WANDER_S: f64 = 0.2;

/// What disturbs the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Disturbance {
    /// White noise of the speed sensor, variance R.
    Sensor,
    /// White noise on the input, variance Q.
    Input,
    /// A load torque that wanders.
    Load,
    All,
}

impl Disturbance {
    const ALL: [Self; 4] = [Self::Sensor, Self::Input, Self::Load, Self::All];

    pub const fn text(self) -> &'static str {
        match self {
            Self::Sensor => "white noise of the sensor (R)",
            Self::Input => "white noise on the input (Q)",
            Self::Load => "a load that wanders (1 N.m, 0.2 s)",
            Self::All => "all of them",
        }
    }
}

/// Means over the seeds: without compensation, then with it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Variance {
    pub disturbance: Disturbance,
    /// Variance of the true speed, (rad/s)^2.
    pub speed_variance: [f64; 2],
    pub effort_v: [f64; 2],
}

#[derive(Clone, Debug, Serialize)]
pub struct Noise {
    pub seeds: u64,
    pub variances: Vec<Variance>,
}

impl Noise {
    pub fn of(&self, disturbance: Disturbance) -> Option<&Variance> {
        self.variances
            .iter()
            .find(|found| found.disturbance == disturbance)
    }
}

pub(super) fn noise(bench: &Bench) -> Noise {
    let of = |disturbance| {
        let (mut speed_variance, mut effort) = ([0.0; 2], [0.0; 2]);
        for seed in 1..=SEEDS {
            for (which, settings) in [without(SETTINGS), SETTINGS].into_iter().enumerate() {
                let (variance, volts) = disturbed(bench, disturbance, settings, seed);
                speed_variance[which] += variance / SEEDS as f64;
                effort[which] += volts / SEEDS as f64;
            }
        }
        Variance {
            disturbance,
            speed_variance,
            effort_v: effort,
        }
    };
    Noise {
        seeds: SEEDS,
        variances: Disturbance::ALL.map(of).into(),
    }
}

fn disturbed(
    bench: &Bench,
    disturbance: Disturbance,
    settings: crate::control::PaperBSettings,
    seed: u64,
) -> (f64, f64) {
    let has = |one: Disturbance| disturbance == one || disturbance == Disturbance::All;
    let mut machine = TrialMachine {
        friction_n_m: 0.0,
        ..paper_machine(bench)
    };
    if !has(Disturbance::Sensor) {
        machine.speed_noise_rad_s = 0.0;
    }
    let input = input_noise(bench, seed, LENGTH_S);
    let wander = wandering(seed, LENGTH_S, machine.period_s);
    let load = |t: f64| {
        let input = if has(Disturbance::Input) {
            input(t)
        } else {
            0.0
        };
        let wander = if has(Disturbance::Load) {
            wander(t)
        } else {
            0.0
        };
        input + wander
    };
    let course = Course {
        reference_rad_s: &|_| SPEED_RAD_S,
        inertia_kg_m2: &|_| bench.inertia(),
        load_n_m: &load,
    };
    let length = cycles(LENGTH_S, machine.period_s);
    let mut controller = bench.paper_b(settings);
    let mut limiter = bench.limiter();
    limiter.current = None;
    let trace = trial(&machine, &course, &mut controller, &limiter, length, seed);
    let settled = &trace[cycles(SETTLED_S, machine.period_s)..];
    let speeds: Vec<f64> = settled.iter().map(|point| point.speed_rad_s).collect();
    (std(&speeds).powi(2), effort_v(settled))
}

/// A load torque of first order, N.m, held over each period.
fn wandering(seed: u64, length_s: f64, period_s: f64) -> impl Fn(f64) -> f64 {
    let decay = (-period_s / WANDER_S).exp();
    let push = WANDER_N_M * (1.0 - decay * decay).sqrt();
    let mut now = 0.0;
    super::held(seed, super::LOAD_PURPOSE, length_s, move |draw| {
        now = decay * now + push * draw;
        now
    })
}

//! Variance of the speed with and without compensation: what kind of disturbance it takes, and what it costs.

use serde::Serialize;

use super::{PERIOD_S, SETTINGS, SPEED_RAD_S, input_noise, on_paper, without};
use crate::control::PaperBSettings;
use crate::workflow::reproduce::loops::{Bench, cycles, effort_v, mean_and_std};

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
    settings: PaperBSettings,
    seed: u64,
) -> (f64, f64) {
    let has = |one: Disturbance| disturbance == one || disturbance == Disturbance::All;
    let input = input_noise(bench, seed, LENGTH_S);
    let wander = wandering(seed, LENGTH_S);
    let part = |of, value: f64| if has(of) { value } else { 0.0 };
    let load = |t| part(Disturbance::Input, input(t)) + part(Disturbance::Load, wander(t));
    let mut trial = on_paper(bench, |_| SPEED_RAD_S).with_load(load);
    trial.seed = seed;
    trial.limiter.current = None;
    trial.machine.friction_n_m = 0.0;
    if !has(Disturbance::Sensor) {
        trial.machine.speed_noise_rad_s = 0.0;
    }
    let trace = trial.run(&mut bench.paper_b(settings), LENGTH_S);
    let settled = &trace[cycles(SETTLED_S, PERIOD_S)..];
    (mean_and_std(settled).1.powi(2), effort_v(settled))
}

/// A load torque of first order, N.m, held over each period.
fn wandering(seed: u64, length_s: f64) -> impl Fn(f64) -> f64 {
    let decay = (-PERIOD_S / WANDER_S).exp();
    let push = WANDER_N_M * (1.0 - decay * decay).sqrt();
    let mut now = 0.0;
    super::held(seed, super::LOAD_PURPOSE, length_s, move |draw| {
        now = decay * now + push * draw;
        now
    })
}

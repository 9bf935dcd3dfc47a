//! Where the iterations of K and gamma stop, what Q/R does, and what K3 and mu do to stability.

use serde::Serialize;

use super::{PERIOD_S, SETTINGS, SPEED_RAD_S, input_noise, on_paper, without};
use crate::control::{PaperB, PaperBError, PaperBSettings, TrialPoint};
use crate::workflow::reproduce::loops::{Bench, effort_v, mean_and_std, steps};

const TOLERANCES: [f64; 3] = [1e-3, 1e-6, 1e-9];
const RATIOS: [f64; 7] = [1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0];
const SHARES: [f64; 5] = [1.0, 0.3, 0.1, 0.05, 0.02];
const FILTERS: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 1.0];
const LENGTH_S: f64 = 3.0;
/// From here on the speed has settled, s.
const SETTLED_S: f64 = 0.5;
/// With a slow filter the speed takes its time to come to rest, s.
const AT_REST_S: f64 = 2.0;

/// Iterations until the relative change falls below a tolerance.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stop {
    pub tolerance: f64,
    pub filter_iterations: usize,
    pub feedback_iterations: usize,
}

/// One ratio of the noises, without compensation.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct WithRatio {
    /// Q/R over the chosen one; Q is changed.
    pub factor: f64,
    pub process_noise: f64,
    pub filter_gain: [f64; 2],
    pub iterations: usize,
    pub overshoot_percent: f64,
    pub settling_s: Option<f64>,
    /// Standard deviation of the true speed at constant reference, and of the output, with both noises.
    pub speed_std_rad_s: f64,
    pub effort_v: f64,
    /// Mean error, rad/s: what friction leaves.
    pub lasting_rad_s: f64,
}

/// Stability by share of K3 (rows) and mu (columns).
#[derive(Clone, Debug, Serialize)]
pub struct Radii {
    pub shares: [f64; 5],
    pub filters: [f64; 5],
    /// Largest eigenvalue of the whole loop.
    pub radius: Vec<Vec<f64>>,
    /// Damping ratio of the compensation's own pair of eigenvalues; 1 where they are real.
    pub damping: Vec<Vec<f64>>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Design {
    pub filter_gain: [f64; 2],
    pub feedback_gain: [f64; 2],
    pub radius: f64,
    /// Relative change of K and of gamma, iteration by iteration, down to the smallest tolerance.
    pub filter_changes: Vec<f64>,
    pub feedback_changes: Vec<f64>,
    pub stops: Vec<Stop>,
    pub ratios: Vec<WithRatio>,
    pub radii: Radii,
}

pub(super) fn design(bench: &Bench) -> Design {
    let finest = PaperBSettings {
        tolerance: TOLERANCES[TOLERANCES.len() - 1],
        ..SETTINGS
    };
    let made = bench.paper_b(finest);
    let (filter, feedback) = made.convergence();
    let (filter_gain, feedback_gain) = made.gains();
    let below = |changes: &[f64], tolerance: f64| {
        let found = changes.iter().position(|change| *change < tolerance);
        found.map_or(changes.len(), |index| index + 1)
    };
    let stop = |tolerance: f64| Stop {
        tolerance,
        filter_iterations: below(filter, tolerance),
        feedback_iterations: below(feedback, tolerance),
    };
    Design {
        filter_gain: [filter_gain[0], filter_gain[1]],
        feedback_gain: [feedback_gain[0], feedback_gain[1]],
        radius: bench.paper_b(SETTINGS).radius(),
        stops: TOLERANCES.map(stop).into(),
        filter_changes: filter.to_vec(),
        feedback_changes: feedback.to_vec(),
        ratios: RATIOS.map(|factor| with_ratio(bench, factor)).into(),
        radii: radii(bench),
    }
}

fn with_ratio(bench: &Bench, factor: f64) -> WithRatio {
    let settings = PaperBSettings {
        process_noise: factor * SETTINGS.process_noise,
        ..without(SETTINGS)
    };
    let made = bench.paper_b(settings);
    let gain = made.gains().0;
    let noise = input_noise(bench, super::SEED, LENGTH_S);
    let trace = on_paper(bench, |_| SPEED_RAD_S)
        .with_load(noise)
        .run(&mut bench.paper_b(settings), LENGTH_S);
    let mut quiet = on_paper(bench, |t| {
        let stepped = t >= SETTLED_S - 0.5 * PERIOD_S;
        if stepped { 51.0 } else { 50.0 }
    });
    quiet.machine.speed_noise_rad_s = 0.0;
    quiet.machine.friction_n_m = 0.0;
    let step = steps(&quiet.run(&mut bench.paper_b(settings), 2.0 * SETTLED_S));
    let last = &step[step.len() - 1].response;
    let is_settled = |point: &TrialPoint| point.time_s > AT_REST_S;
    let settled: Vec<TrialPoint> = trace.into_iter().filter(is_settled).collect();
    let (mean, std) = mean_and_std(&settled);
    WithRatio {
        factor,
        process_noise: settings.process_noise,
        filter_gain: [gain[0], gain[1]],
        iterations: made.convergence().0.len(),
        overshoot_percent: last.overshoot_percent,
        settling_s: last.settling_s,
        speed_std_rad_s: std,
        effort_v: effort_v(&settled),
        lasting_rad_s: SPEED_RAD_S - mean,
    }
}

fn radii(bench: &Bench) -> Radii {
    let radius = |compensation: f64, filter_share: f64| {
        let settings = PaperBSettings {
            filter_share,
            compensation,
            ..SETTINGS
        };
        match PaperB::new(bench.paper_b_plant(), settings) {
            Ok(made) => made.radius(),
            Err(PaperBError::Unstable { radius }) => radius,
            Err(_) => f64::NAN,
        }
    };
    let plant = bench.paper_b_plant();
    let split = plant.a / (plant.a + plant.b);
    let table = |of: &dyn Fn(f64, f64) -> f64| {
        let row = |share: &f64| FILTERS.iter().map(|filter| of(*share, *filter)).collect();
        SHARES.iter().map(row).collect()
    };
    Radii {
        shares: SHARES,
        filters: FILTERS,
        radius: table(&radius),
        damping: table(&|share, filter| damping(share, filter, split)),
    }
}

/// Damping ratio of `(z - 1)(z - 1 + mu) + c mu (a z + 1 - a) = 0`: the predictor works on measured speeds and is fed u*,
/// so that the compensation is a loop of its own. `a` is A/(A+B).
fn damping(share: f64, filter: f64, split: f64) -> f64 {
    let sum = 2.0 - filter - share * filter * split;
    let product = 1.0 - filter + share * filter * (1.0 - split);
    if sum * sum >= 4.0 * product {
        return 1.0;
    }
    let decay = -0.5 * product.ln();
    let angle = (0.5 * sum / product.sqrt()).acos();
    decay / decay.hypot(angle)
}

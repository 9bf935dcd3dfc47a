//! Batch output-error fit: the free run of a model is brought as near to the measurement as its parameters allow.
//!
//! ```text
//! Model, Scenario, NoiseFloor --(FreeRun: x -> weighted residual)--> Levenberg-Marquardt --> Fit
//!                                                                        block-clustered covariance
//! ```
//!
//! DISCOVERY.md 2.4 and 2.12. Positive parameters are fitted as logarithms; the initial state is a nuisance where the
//! run does not start at rest. The residual is `[(i - i^)/sigma_i ; (w - w^)/sigma_w]` over the scored samples.

mod covariance;
mod delayed;
mod free_run;

use thiserror::Error;

use crate::numerics::levenberg_marquardt::{self, Minimum, Options};
use crate::plant::{Model, ModelError, ParameterRole, Scenario, Slot, State, Trajectory};
use crate::sample::{ParameterEstimate, Verdict};

pub use covariance::BLOCK_S;
pub use delayed::fit_delayed;
pub use free_run::{FreeRun, weighted_residual};

use super::noise::NoiseFloor;
use super::verdict::judge;

#[derive(Clone, Debug, Error, PartialEq)]
pub enum FitError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error("{runs} runs were recorded, {needed} are needed")]
    TooFewRuns { runs: usize, needed: usize },
    #[error("no free parameter: every parameter of the model is fixed")]
    NothingFree,
    #[error(
        "run {run:?}: neither current nor speed can be compared: each is missing or the same throughout"
    )]
    NothingMeasured { run: String },
    #[error("run {run:?}: {rows} rows of the torque balance, at least {needed} are needed")]
    NoTorqueBalance {
        run: String,
        rows: usize,
        needed: usize,
    },
    #[error("run {run:?}: the model cannot be simulated from its starting values")]
    CannotSimulate { run: String },
}

impl FitError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Model(error) => error.help(),
            Self::TooFewRuns { .. } => "record the missing runs",
            Self::NothingFree => "take a key out of `fixed` in the model file",
            Self::NothingMeasured { .. } => {
                "map a column with --map speed_rad_s=HEADER or current_a=HEADER"
            }
            Self::NoTorqueBalance { .. } => {
                "the shaft must turn for some seconds; map torque_n_m (or current_a) and speed_rad_s or angle_rad"
            }
            Self::CannotSimulate { .. } => {
                "check the units of voltage, current and speed, and the model's values"
            }
        }
    }
}

/// A fitted model with what is known about its parameters.
#[derive(Clone, Debug)]
pub struct Fit {
    pub model: Model,
    pub noise: NoiseFloor,
    /// Every parameter of the model, in the order of its slots.
    pub parameters: Vec<ParameterEstimate>,
    /// What the standard deviations above were multiplied by: more than one where more than noise is left over, so that
    /// they hold only if nothing else is missing.
    pub interval_factor: f64,
    /// Root of the mean over the signals of `(rmse / noise)^2` on the scored samples, as `diagnosis::Score` has it: a signal
    /// that was sampled more often does not count more. The cost of the minimum weighs every sample alike.
    pub nrms: f64,
    pub start: State,
    pub iterations: usize,
    pub minimum: Minimum,
    pub free: Vec<Slot>,
}

/// Fits the free parameters of each start's model and keeps the better minimum. Every start must have the same effects.
pub fn fit(starts: &[Model], scenario: &Scenario, noise: &NoiseFloor) -> Result<Fit, FitError> {
    fit_with(starts, scenario, noise, Options::default())
}

/// The same with other limits of the search.
pub fn fit_with(
    starts: &[Model],
    scenario: &Scenario,
    noise: &NoiseFloor,
    options: Options,
) -> Result<Fit, FitError> {
    let mut best: Option<Fit> = None;
    let mut failure = FitError::CannotSimulate {
        run: scenario.name.clone(),
    };
    for start in starts {
        match fit_from(start, scenario, noise, options) {
            Ok(found)
                if best
                    .as_ref()
                    .is_none_or(|best| found.minimum.cost < best.minimum.cost) =>
            {
                best = Some(found);
            }
            Ok(_) => {}
            Err(error) => failure = error,
        }
    }
    best.ok_or(failure)
}

fn fit_from(
    start: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
    options: Options,
) -> Result<Fit, FitError> {
    let problem = FreeRun::new(start, scenario, *noise)?;
    if problem.free_slots().is_empty() {
        return Err(FitError::NothingFree);
    }
    let x0 = problem.start();
    let minimum = levenberg_marquardt::minimise(&problem, &x0, options).ok_or_else(|| {
        FitError::CannotSimulate {
            run: scenario.name.clone(),
        }
    })?;
    let model = problem.model_at(&minimum.x);
    let interval_factor = covariance::interval_factor(&minimum, problem.rows(), noise);
    let parameters = estimates(&problem, &minimum, scenario, interval_factor, &[]);
    Ok(Fit {
        nrms: nrms(&minimum, problem.rows()),
        start: problem.initial_state(&minimum.x),
        iterations: minimum.iterations,
        free: problem.free_slots().to_vec(),
        noise: *noise,
        model,
        parameters,
        interval_factor,
        minimum,
    })
}

/// Root of the mean over the signals of the mean square of their weighted residuals; a row is `(sample, is_speed)`.
fn nrms(minimum: &Minimum, rows: &[(usize, bool)]) -> f64 {
    let mut sums = [(0.0, 0.0); 2];
    for ((_, is_speed), value) in rows.iter().zip(minimum.residual.as_slice()) {
        let (squares, count) = &mut sums[usize::from(*is_speed)];
        *squares += value * value;
        *count += 1.0;
    }
    let present = sums.iter().filter(|(_, count)| *count > 0.0);
    let (sum, signals) = present.fold((0.0, 0.0), |(sum, signals), (squares, count)| {
        (sum + squares / count, signals + 1.0)
    });
    (sum / f64::max(signals, 1.0)).sqrt()
}

/// Estimates of every slot of the model, free and fixed; `shared` is what a common unknown of the record adds to the
/// deviation of each coordinate.
fn estimates(
    problem: &FreeRun<'_>,
    minimum: &Minimum,
    scenario: &Scenario,
    interval_factor: f64,
    shared: &[f64],
) -> Vec<ParameterEstimate> {
    let model = &problem.model_at(&minimum.x);
    let covariance = covariance::at_minimum(minimum, problem.rows(), scenario);
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let slopes = problem.slopes(&minimum.x);
    let still = problem.why_still(&minimum.residual);
    model
        .slots()
        .iter()
        .map(|slot| {
            let key = slot.key();
            let value = model.get(slot);
            let Some(index) = problem
                .free_slots()
                .iter()
                .position(|free| free.key() == key)
            else {
                let (std, reason) = (Some(0.0), None);
                return ParameterEstimate {
                    key,
                    value,
                    std,
                    unit: slot.unit(),
                    verdict: Verdict::Fixed,
                    reason,
                };
            };
            if let Some(reason) = &still {
                return ParameterEstimate::not_observable(&key, slot.unit(), reason.clone());
            }
            let variance = covariance[(index, index)];
            let std = variance.is_finite().then(|| {
                let own = interval_factor * variance.max(0.0).sqrt();
                own.hypot(shared.get(index).copied().unwrap_or(0.0)) * slopes[index].abs()
            });
            let mut judged = judge(slot, value.unwrap_or(f64::NAN), std, period_s);
            if !minimum.converged && judged.verdict == Verdict::Settled {
                judged.verdict = Verdict::Searching;
                judged.reason = Some("the fit had not converged".to_owned());
            }
            judged
        })
        .collect()
}

/// The model as given on a run: only the initial state is fitted, and only where the run does not start at rest, and the
/// times of events, which are another in each run.
#[derive(Clone, Debug)]
pub struct Prediction {
    pub trajectory: Trajectory,
    pub start: State,
    /// The model with its events where they are in this run.
    pub model: Model,
}

/// Free run of a complete model over a scenario.
pub fn predict(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Prediction, FitError> {
    let mut held = model.clone();
    let is_event = |slot: &Slot| slot.has_role(ParameterRole::EventTime);
    let events: Vec<Slot> = held.free_slots().into_iter().filter(is_event).collect();
    held.fixed = held.slots().iter().map(Slot::key).collect();
    held.fixed
        .retain(|key| !events.iter().any(|event| event.key() == *key));
    if held.free_slots().is_empty() {
        let options = Options::default();
        return predict_from(&held, scenario, noise, options).map(|(prediction, _)| prediction);
    }
    // Each place costs one simulation; only the best few are worth a search.
    let placed_only = Options {
        most_iterations: 0,
        ..Options::default()
    };
    let mut placed: Vec<(f64, Model)> = event_starts(&held, &events, scenario)
        .into_iter()
        .filter_map(|start| {
            let (_, cost) = predict_from(&start, scenario, noise, placed_only).ok()?;
            Some((cost, start))
        })
        .collect();
    placed.sort_by(|a, b| a.0.total_cmp(&b.0));
    placed
        .iter()
        .take(BEST_PLACES)
        .filter_map(|(_, start)| predict_from(start, scenario, noise, Options::thrifty()).ok())
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(prediction, _)| prediction)
        .ok_or_else(|| FitError::CannotSimulate {
            run: scenario.name.clone(),
        })
}

/// Time behind a run's end at which what begins there does nothing in it, s.
const BEHIND_S: f64 = 1.0;
/// Places of an event from which a search starts.
const BEST_PLACES: usize = 3;

/// Free run from one start with its cost.
fn predict_from(
    held: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
    options: Options,
) -> Result<(Prediction, f64), FitError> {
    let problem = FreeRun::new(held, scenario, *noise)?.with_free_effect_states()?;
    let x0 = problem.start();
    let minimum = levenberg_marquardt::minimise(&problem, &x0, options).ok_or_else(|| {
        FitError::CannotSimulate {
            run: scenario.name.clone(),
        }
    })?;
    let prediction = Prediction {
        trajectory: problem.trajectory(&minimum.x)?,
        start: problem.initial_state(&minimum.x),
        model: problem.model_at(&minimum.x),
    };
    Ok((prediction, minimum.cost))
}

/// The model with every event at every place of its grid, and behind the end: an event of another run stands anywhere in
/// this one or nowhere, and a fit finds it only from nearby.
fn event_starts(model: &Model, events: &[Slot], scenario: &Scenario) -> Vec<Model> {
    let mut starts = vec![model.clone()];
    let length_s = scenario.sample_time_s[scenario.samples() - 1] - scenario.begin_s();
    for slot in events {
        let Slot::Effect { spec, .. } = slot else {
            continue;
        };
        starts = starts
            .iter()
            .flat_map(|start| {
                let mut placed: Vec<Model> = vec![start.clone()];
                let mut put = |time_s: f64| {
                    let mut there = start.clone();
                    there.set(slot, time_s);
                    placed.push(there);
                };
                for share in spec.shapes {
                    put(share * length_s);
                }
                // It need not happen in this run at all.
                put(length_s + BEHIND_S);
                placed
            })
            .collect();
    }
    starts
}

#[cfg(test)]
mod tests;

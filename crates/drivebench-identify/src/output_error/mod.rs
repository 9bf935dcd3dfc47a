//! Output-error method (Ljung 1999, section 4.2): weighted nonlinear least squares of the free run of a model to the measurement.
//!
//! ```text
//! Model, Scenario, NoiseFloor --(FreeRun: x -> weighted residual)--> Levenberg-Marquardt --> Fit
//!                                                                        block-clustered covariance
//! ```
//!
//! Positive parameters are fitted as logarithms; the initial state is a nuisance where the
//! run does not start at rest. The residual is `[(i - i^)/sigma_i ; (w - w^)/sigma_w]` over the scored samples.

mod free_run;
mod rounding;

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares::{clustered, inverse_where_determined};
use drivebench_model::numerics::levenberg_marquardt::{self, Minimum, Options};
use drivebench_model::numerics::statistics;
use drivebench_model::plant::{
    Model, ModelError, ParameterRole, Scenario, Slot, State, Trajectory,
};
use drivebench_model::sample::{ParameterEstimate, Reason};

pub use free_run::{FreeRun, weighted_residual};

use super::noise::{FloorSource, NoiseFloor};
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
    NoTorqueBalance { run: String, rows: usize, needed: usize },
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

pub(super) fn cannot_simulate(scenario: &Scenario) -> FitError {
    FitError::CannotSimulate { run: scenario.name.clone() }
}

#[derive(Clone, Debug)]
pub struct Fit {
    pub model: Model,
    pub noise: NoiseFloor,
    /// Every parameter of the model, in the order of its slots.
    pub parameters: Vec<ParameterEstimate>,
    /// Factor of the standard deviations above: more than one where the residual is more than noise, so that they hold only if no
    /// other effect is missing.
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
    let mut failure = cannot_simulate(scenario);
    for start in starts {
        match fit_from(start, scenario, noise, options) {
            Ok(found) => {
                let better = |best: &Fit| found.minimum.cost < best.minimum.cost;
                if best.as_ref().is_none_or(better) {
                    best = Some(found);
                }
            }
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
    let minimum = levenberg_marquardt::minimise(&problem, &problem.start(), options)
        .ok_or_else(|| cannot_simulate(scenario))?;
    let model = problem.model_at(&minimum.x);
    let interval_factor = interval_factor(&minimum, problem.rows(), noise);
    let parameters = estimates(&problem, &minimum, scenario, noise, interval_factor, &[]);
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
    let means: Vec<f64> = present.map(|(squares, count)| squares / count).collect();
    (means.iter().sum::<f64>() / f64::max(means.len() as f64, 1.0)).sqrt()
}

/// Estimates of every slot of the model, free and fixed; `shared` is what a common unknown of the record adds to the
/// deviation of each coordinate.
fn estimates(
    problem: &FreeRun<'_>,
    minimum: &Minimum,
    scenario: &Scenario,
    noise: &NoiseFloor,
    interval_factor: f64,
    shared: &[f64],
) -> Vec<ParameterEstimate> {
    let model = &problem.model_at(&minimum.x);
    let covariance = covariance_at(minimum, problem.rows(), scenario);
    let period_s = statistics::mean_step(&scenario.sample_time_s);
    let (bread, _) = inverse_where_determined(&minimum.jacobian);
    let rows = problem.rows();
    let by_rounding = rounding::shared_variance(&minimum.jacobian, &bread, rows, scenario, noise);
    let slopes = problem.slopes(&minimum.x);
    let still = problem.why_still(&minimum.residual);
    model
        .slots()
        .iter()
        .map(|slot| {
            let key = slot.key();
            let value = model.get(slot);
            let mut free = problem.free_slots().iter();
            let Some(index) = free.position(|free| free.key() == key) else {
                let fixed = ParameterEstimate::fixed(key, slot.unit(), f64::NAN);
                return ParameterEstimate { value, ..fixed };
            };
            if let Some(reason) = &still {
                let (code, reason) = (Reason::NotExcited, reason.clone());
                return ParameterEstimate::not_observable(&key, slot.unit(), code, reason);
            }
            let variance = covariance[(index, index)];
            let std = variance.is_finite().then(|| {
                let own = interval_factor * variance.max(0.0).sqrt();
                let shared = shared.get(index).copied().unwrap_or(0.0);
                own.hypot(shared).hypot(by_rounding[index].sqrt()) * slopes[index].abs()
            });
            let mut judged = judge(slot, value.unwrap_or(f64::NAN), std, period_s);
            if !minimum.converged {
                judged.unsettle(Reason::NotConverged, "the fit had not converged");
            }
            judged
        })
        .collect()
}

/// Block-clustered covariance at a minimum; NaN on the diagonal where the data leave a parameter undetermined. A variance
/// from some ten blocks is itself uncertain by a quarter: none counts that is below what white residuals of this size
/// would make.
fn covariance_at(minimum: &Minimum, rows: &[(usize, bool)], scenario: &Scenario) -> DMatrix<f64> {
    let (bread, determined) = inverse_where_determined(&minimum.jacobian);
    let times: Vec<f64> = rows.iter().map(|row| scenario.sample_time_s[row.0]).collect();
    let block_s = scenario.scales.block_s();
    let block = |time_s: &f64| whole((time_s - times[0]) / block_s);
    let blocks: Vec<usize> = times.iter().map(block).collect();
    let residual = DVector::from_column_slice(&minimum.residual);
    let freedom = residual.len().saturating_sub(bread.ncols()).max(1) as f64;
    let white = bread.diagonal() * (residual.norm_squared() / freedom);
    let mut covariance = clustered(&minimum.jacobian, &residual, &blocks, bread, &determined);
    for (index, least) in white.iter().enumerate() {
        if covariance[(index, index)] < *least {
            covariance[(index, index)] = *least;
        }
    }
    covariance
}

/// Factor on every standard deviation of a fit. Blocks cover what neighbouring samples share, but not what a missing effect
/// puts into whole stretches of the run: where the error stands above the noise, or is coloured, the interval is doubled.
/// It then holds if nothing else is missing.
fn interval_factor(minimum: &Minimum, rows: &[(usize, bool)], noise: &NoiseFloor) -> f64 {
    let residual = minimum.residual.as_slice();
    let nrms = nrms(minimum, rows);
    let above = noise.source != FloorSource::None && !noise.is_at_the_floor(nrms);
    let is_coloured = |speed: bool| {
        let of_signal = rows.iter().zip(residual).filter(|(row, _)| row.1 == speed);
        statistics::is_coloured(&of_signal.map(|(_, value)| *value).collect::<Vec<f64>>())
    };
    let widened = above || is_coloured(false) || is_coloured(true);
    if widened { 2.0 } else { 1.0 }
}

/// Output-error fit where the host stamped samples and commands: by how much the input came later than its stamps say is
/// one more unknown of the record, with what is known of it beforehand; the fitted model has it.
///
/// Gauss-Newton by blocks: the parameters at a delay, then the delay along what they cannot follow, `g - J (J'J)^-1 J'g`.
/// What is left unknown of it enters every parameter's interval along `(J'J)^-1 J'g`.
///
/// As [`fit`]; the same where the drive stamped everything itself.
pub fn fit_delayed(
    starts: &[Model],
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Fit, FitError> {
    let Some((mean_s, prior_s)) = scenario.input_delay_s() else {
        return fit(starts, scenario, noise);
    };
    let with = |model: &Model, delay_s| Model { input_delay_s: Some(delay_s), ..model.clone() };
    let known_s = starts.first().and_then(|start| start.input_delay_s);
    let mut delay_s = known_s.unwrap_or(mean_s);
    let starts: Vec<Model> = starts.iter().map(|start| with(start, delay_s)).collect();
    let mut found = fit(&starts, scenario, noise)?;
    for round in 0..6 {
        let x = &found.minimum.x;
        let residual_at = |delay_s: f64| -> Result<DVector<f64>, FitError> {
            let problem = FreeRun::new(&with(&found.model, delay_s), scenario, *noise)?;
            problem.residuals(x).map(DVector::from_vec)
        };
        let half_s = 0.02 * prior_s;
        let gradient =
            (residual_at(delay_s + half_s)? - residual_at(delay_s - half_s)?) / (2.0 * half_s);
        let jacobian = &found.minimum.jacobian;
        let (bread, _) = inverse_where_determined(jacobian);
        let along = bread * jacobian.tr_mul(&gradient);
        let own = &gradient - jacobian * &along;
        let residual = DVector::from_column_slice(&found.minimum.residual);
        let problem = FreeRun::new(&found.model, scenario, *noise)?;
        let left = (found.interval_factor * found.nrms.max(1.0)).powi(2);
        let information = own.norm_squared() / left + prior_s.powi(-2);
        let pull = own.dot(&residual) / left + (delay_s - mean_s) / prior_s.powi(2);
        let white_s = information.sqrt().recip();
        let step_s = -pull / information;
        if step_s.abs() > 0.1 * white_s && round < 5 {
            let cost = |fit: &Fit, delay_s: f64| {
                let residual = DVector::from_column_slice(&fit.minimum.residual);
                residual.norm_squared() / left + ((delay_s - mean_s) / prior_s).powi(2)
            };
            // Where the error is large the derivatives do not hold for the whole step: a fit went from 2.0 to 8.7 times the noise.
            let lengths = [1.0, 0.25, 0.0625].map(|share| share * step_s.clamp(-prior_s, prior_s));
            let better = lengths.into_iter().find_map(|length_s| {
                let next_s = delay_s + length_s;
                let next = fit(&[with(&found.model, next_s)], scenario, noise).ok()?;
                (cost(&next, next_s) < cost(&found, delay_s)).then_some((next, next_s))
            });
            if let Some((next, next_s)) = better {
                (found, delay_s) = (next, next_s);
                continue;
            }
        }
        // What neighbouring samples err by together, as the parameters' own intervals have it.
        let rows: Vec<(usize, usize)> =
            problem.rows().iter().map(|row| row.0).enumerate().collect();
        let block_s = scenario.scales.block_s();
        let block = |row: &(usize, usize)| (scenario.sample_time_s[row.1] / block_s).floor();
        let scores = rows.chunk_by(|a, b| block(a).total_cmp(&block(b)).is_eq()).map(|block| {
            let score: f64 = block.iter().map(|(row, _)| own[*row] * residual[*row]).sum();
            score * score
        });
        let scores: f64 = scores.sum();
        let clustered_s = found.interval_factor * scores.sqrt() / (left * information);
        let std_s = white_s.max(clustered_s).min(prior_s);
        let shared: Vec<f64> = along.iter().map(|share| share * std_s).collect();
        let factor = found.interval_factor;
        found.parameters = estimates(&problem, &found.minimum, scenario, noise, factor, &shared);
        break;
    }
    Ok(found)
}

/// By how much the input of a run comes later, s, than a model says that was fitted to another run of the same motor: the clock of
/// a drive with a resolution of 1 ms is known to a part of that in each connection. By its free run, with what is known of both
/// stamps beforehand; `None` where it does not differ by three standard deviations, where no host stamped the samples, and where the
/// instants of holes, sampled changes or limits are known from the same stamps.
pub fn offset_in(model: &Model, scenario: &Scenario, noise: &NoiseFloor) -> Option<f64> {
    let half_width_s = scenario.typical_half_width_s()?;
    if !scenario.unknown_input.is_empty() || !scenario.limits.is_empty() {
        return None;
    }
    // Of the difference of two uniform errors.
    let prior_s = half_width_s * (2.0_f64 / 3.0).sqrt();
    let mut held = model.clone();
    held.fixed = held.slots().iter().map(Slot::key).collect();
    let squares = |offset_s: f64| {
        let moved = scenario.with_input_later(offset_s);
        predict_from(&held, &moved, noise, Options::thrifty()).ok().map(|found| found.1)
    };
    let steps = (-3..=3).map(|step| f64::from(step) * prior_s);
    let tried: Vec<(f64, f64)> =
        steps.map(|offset_s| Some((offset_s, squares(offset_s)?))).collect::<Option<_>>()?;
    let best = tried.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    // As the intervals of an error above the noise.
    let left = 4.0 * (best.1 / scenario.samples() as f64).max(1.0);
    let cost = |offset_s: f64| Some(squares(offset_s)? / left + (offset_s / prior_s).powi(2));
    let mut offset_s = best.0;
    for step_s in [prior_s, 0.25 * prior_s] {
        // The vertex of the parabola through three.
        let [before, at, after] = [offset_s - step_s, offset_s, offset_s + step_s].map(cost);
        let (before, at, after) = (before?, at?, after?);
        let bend = before - 2.0 * at + after;
        if bend <= 0.0 {
            return None;
        }
        offset_s += (step_s * 0.5 * (before - after) / bend).clamp(-step_s, step_s);
    }
    (cost(0.0)? - cost(offset_s)? > 9.0).then_some(offset_s)
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
    held.fixed.retain(|key| !events.iter().any(|event| event.key() == *key));
    if held.free_slots().is_empty() {
        let options = Options::default();
        return predict_from(&held, scenario, noise, options).map(|(prediction, _)| prediction);
    }
    // Each place costs one simulation; only the best few are worth a search. Events are placed one after the other: all
    // places of one with all of the others are a power of their number.
    let placed_only = Options { most_iterations: 0, ..Options::default() };
    let mut placed: Vec<(f64, Model)> = vec![(f64::INFINITY, held)];
    for event in &events {
        placed = placed
            .iter()
            .flat_map(|(_, model)| event_starts(model, event, scenario))
            .filter_map(|start| {
                let (_, cost) = predict_from(&start, scenario, noise, placed_only).ok()?;
                Some((cost, start))
            })
            .collect();
        placed.sort_by(|a, b| a.0.total_cmp(&b.0));
        placed.truncate(3);
    }
    placed
        .iter()
        .filter_map(|(_, start)| predict_from(start, scenario, noise, Options::thrifty()).ok())
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(prediction, _)| prediction)
        .ok_or_else(|| cannot_simulate(scenario))
}

/// Free run from one start with its cost.
fn predict_from(
    held: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
    options: Options,
) -> Result<(Prediction, f64), FitError> {
    let problem = FreeRun::new(held, scenario, *noise)?.with_free_effect_states()?;
    let start = problem.start();
    if start.is_empty() {
        let trajectory = problem.trajectory(&start)?;
        let weighted = |row: &(usize, bool)| weighted_residual(*row, &trajectory, scenario, noise);
        let cost: f64 = problem.rows().iter().map(|row| weighted(row).powi(2)).sum();
        if !cost.is_finite() {
            return Err(cannot_simulate(scenario));
        }
        let start = problem.initial_state(&start);
        return Ok((Prediction { trajectory, start, model: held.clone() }, cost));
    }
    let minimum = levenberg_marquardt::minimise(&problem, &start, options)
        .ok_or_else(|| cannot_simulate(scenario))?;
    let prediction = Prediction {
        trajectory: problem.trajectory(&minimum.x)?,
        start: problem.initial_state(&minimum.x),
        model: problem.model_at(&minimum.x),
    };
    Ok((prediction, minimum.cost))
}

/// The model with an event at every place of its grid, and behind the end: an event of another run stands anywhere in this
/// one or nowhere, and a fit finds it only from nearby.
fn event_starts(model: &Model, event: &Slot, scenario: &Scenario) -> Vec<Model> {
    let length_s = scenario.sample_time_s[scenario.samples() - 1] - scenario.begin_s();
    let Slot::Effect { spec, .. } = event else {
        return vec![model.clone()];
    };
    let places = spec.in_run(&scenario.scales).shapes();
    // It need not happen in this run at all: behind the end what begins there does nothing.
    let there = places.chain([length_s + 1.0]).map(|time_s| {
        let mut there = model.clone();
        there.set(event, time_s);
        there
    });
    std::iter::once(model.clone()).chain(there).collect()
}

#[cfg(test)]
mod tests;

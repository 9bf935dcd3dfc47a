//! A model beside a measurement: free run first, one-step and training figures small beside it.

use serde::Serialize;

use super::evidence::{Evidence, HoldoutFrom};
use super::location::{EquationBalance, ErrorMap, ErrorOf, FailureLocation, locate, undecided};
use super::mechanical::{self, TorqueComparison};
use super::residual::ResidualLights;
use super::score::{Score, SignalScore};
use crate::identification::noise::FloorSource;
use crate::identification::output_error::{self, FitError};
use crate::plant::{Input, Model, Plant, Scenario};

/// Figures of one held-out signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HoldoutFigures {
    pub fit_percent: f64,
    pub rmse: f64,
}

/// Figures of one signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SignalComparison {
    pub fit_percent: f64,
    pub rmse: f64,
    /// Null where no floor is known.
    pub noise_floor: Option<f64>,
    pub one_step_rmse: f64,
    pub holdout: HoldoutFigures,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Signals {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_rad_s: Option<SignalComparison>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_a: Option<SignalComparison>,
    /// Of runs without a voltage: the inverse model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub torque_n_m: Option<TorqueComparison>,
    /// Length of the windows in which the speed is simulated; left out where it is one free run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_windows_s: Option<f64>,
}

impl Signals {
    /// What the speed's figures are of: those of windows must not pass for those of a free run.
    pub fn speed_name(&self) -> String {
        self.speed_windows_s.map_or_else(
            || "speed".to_owned(),
            |length_s| format!("speed ({length_s} s windows)"),
        )
    }
}

/// The comparison, as `compare --json` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    pub signals: Signals,
    #[serde(rename = "where")]
    pub locations: Vec<FailureLocation>,
    /// What each equation lacks, the worse first.
    pub balances: Vec<EquationBalance>,
    /// The error over speed x current, on the hold-out.
    pub map: Option<ErrorMap>,
    pub residual: ResidualLights,
    pub noise_floor_from: FloorSource,
    pub holdout_from: HoldoutFrom,
    /// Root of the mean over the signals of `(rmse / noise)^2`, on the hold-out.
    pub holdout_rmse: f64,
    /// What could not be asked of these runs, and why.
    pub limits: Vec<String>,
}

impl Comparison {
    /// That it is not known which equation, or which variable, where two are within their uncertainty.
    pub fn undecided(&self) -> Option<String> {
        undecided(&self.balances, &self.locations)
    }

    /// Where it fails, in one sentence that holds for models that are nearly the same too.
    pub fn headline(&self) -> String {
        let first = || {
            self.locations
                .first()
                .map(|location| location.sentence.clone())
        };
        self.undecided()
            .or_else(first)
            .unwrap_or_else(|| "the error follows nothing in particular".to_owned())
    }
}

/// Compares a complete model as it is; only the initial state is fitted. `error_of` says what the locations are of.
pub fn compare(
    model: &Model,
    evidence: &Evidence,
    error_of: ErrorOf,
) -> Result<Comparison, FitError> {
    if evidence.training.input != Input::Voltage {
        return mechanical::compare(model, evidence, error_of);
    }
    let noise = &evidence.noise;
    let training = Score::of(model, &evidence.training, noise)?;
    let holdout = Score::of(model, &evidence.holdout, noise)?;
    let one_step = one_step_rmse(model, evidence)?;
    let known =
        |level: f64| (noise.source != FloorSource::None && level.is_finite()).then_some(level);
    let signal =
        |here: Option<SignalScore>, there: Option<SignalScore>, level: f64, one_step_rmse: f64| {
            let (here, there) = (here?, there?);
            Some(SignalComparison {
                fit_percent: here.fit_percent,
                rmse: here.rmse,
                noise_floor: known(level),
                one_step_rmse,
                holdout: HoldoutFigures {
                    fit_percent: there.fit_percent,
                    rmse: there.rmse,
                },
            })
        };
    let judged = |residual: Vec<(f64, f64)>, level: f64| {
        if level.is_finite() {
            with_input(&residual, &evidence.holdout)
        } else {
            Vec::new()
        }
    };
    let located = locate(model, &evidence.holdout, noise, error_of)?;
    Ok(Comparison {
        signals: Signals {
            speed_rad_s: signal(training.speed, holdout.speed, noise.speed_rad_s, one_step.1),
            current_a: signal(
                training.current,
                holdout.current,
                noise.current_a,
                one_step.0,
            ),
            torque_n_m: None,
            speed_windows_s: None,
        },
        locations: located.locations,
        balances: located.balances,
        map: located.map,
        residual: ResidualLights::of(
            &judged(holdout.current_residual(), noise.current_a),
            &judged(holdout.speed_residual(), noise.speed_rad_s),
        ),
        noise_floor_from: noise.source,
        holdout_from: evidence.holdout_from,
        holdout_rmse: holdout.nrms,
        limits: limits(evidence, located.notes),
    })
}

/// What these runs cannot answer.
fn limits(evidence: &Evidence, mut notes: Vec<String>) -> Vec<String> {
    if evidence.noise.source == FloorSource::None {
        notes.insert(
            0,
            "the run does not begin with a standstill at zero input (20 samples are needed): no noise floor is known, so \
             that an error cannot be told from noise; errors are shown beside the drive instead"
                .to_owned(),
        );
    }
    notes.extend(evidence.unjudged());
    if evidence.holdout_from == HoldoutFrom::Split {
        notes.push(
            "no hold-out was given: the last 40 % of the run are held out, which share its day and its excitation".to_owned(),
        );
    }
    notes
}

/// Each residual with the input that held then; the times ascend.
fn with_input(residual: &[(f64, f64)], scenario: &Scenario) -> Vec<(f64, f64)> {
    let events = &scenario.events;
    let mut event = 0;
    residual
        .iter()
        .map(|(time_s, value)| {
            while event + 1 < events.len() && events[event + 1].0 < *time_s {
                event += 1;
            }
            (*value, events[event].1)
        })
        .collect()
}

/// Root mean square of the one-step prediction errors of current and speed on the training run.
fn one_step_rmse(model: &Model, evidence: &Evidence) -> Result<(f64, f64), FitError> {
    let scenario = &evidence.training;
    let start = output_error::predict(model, scenario, &evidence.noise)?.start;
    let ahead = Plant::new(model, scenario.input)?.predict_ahead(scenario, start, 1);
    Ok((
        rms_error(&ahead.current_a, &scenario.current_a, scenario),
        rms_error(&ahead.speed_rad_s, &scenario.speed_rad_s, scenario),
    ))
}

fn rms_error(predicted: &[f64], measured: &[f64], scenario: &Scenario) -> f64 {
    let errors: Vec<f64> = scenario
        .scored
        .clone()
        .map(|sample| predicted[sample] - measured[sample])
        .filter(|error| error.is_finite())
        .collect();
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len().max(1) as f64).sqrt()
}

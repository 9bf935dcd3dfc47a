//! The torque that the model asks for beside the motor's, and its speed in short windows.

use serde::Serialize;

use super::regression;
use super::sides::{Balance, Scale, Sides};
use crate::diagnosis::compare::{Comparison, HoldoutFigures, SignalComparison, Signals};
use crate::diagnosis::evidence::Evidence;
use crate::diagnosis::location::{ErrorOf, locate};
use crate::diagnosis::residual::ResidualLights;
use crate::diagnosis::score::Score;
use crate::identification::noise::FloorSource;
use crate::identification::output_error::FitError;
use crate::identification::torque_rows::{Method, TorqueRows};
use crate::numerics::count::whole;
use crate::plant::{Model, Plant, Scenario, State};

/// Length of the windows in which the speed is simulated, s: an axis in a closed loop is an integrator, whose long free
/// run only shows how the least offset adds up.
const SPEED_WINDOW_S: f64 = 0.75;

/// The motor's torque beside that of the inverse model; the figures are those of the weak form.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TorqueComparison {
    pub fit_percent: f64,
    /// N.m, averaged over a window.
    pub rmse: f64,
    /// Null where no floor is known.
    pub noise_floor: Option<f64>,
    pub holdout: HoldoutFigures,
    /// The relative error under each processing of the data: it depends on it, so it is never shown without it.
    pub processing: Vec<ProcessingError>,
}

/// Relative torque error of one processing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProcessingError {
    pub method: Method,
    /// Root mean square of the residual over that of the torque, on the fitted rows, on the held-out ones, and on a
    /// confirming run.
    pub relative_error_percent: f64,
    pub holdout_relative_error_percent: f64,
    /// On the whole run where it was split, fitted to the whole of it where `fitted`: what published figures are of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub whole_run_relative_error_percent: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub confirm_relative_error_percent: Option<f64>,
    /// Whether the parameters were fitted under this processing, or taken as they are.
    pub fitted: bool,
    pub sentence: String,
}

impl TorqueComparison {
    /// The figures of one processing.
    pub fn under(&self, method: Method) -> Option<&ProcessingError> {
        self.processing.iter().find(|error| error.method == method)
    }
}

/// Compares a complete model as it is with runs that have no voltage.
pub(in crate::diagnosis) fn compare(
    model: &Model,
    evidence: &Evidence,
    error_of: ErrorOf,
) -> Result<Comparison, FitError> {
    let sides = Sides::weak_form(model, evidence)?;
    let baseline = sides.fit(model);
    let scale = baseline.map(|fit| Scale::of(model, &evidence.training, &sides.training, &fit));
    let scale = scale.unwrap_or(Scale {
        unit_n_m: f64::NAN,
        source: FloorSource::None,
    });
    let balance = Balance { sides, scale };
    let under = |sides: &Sides| Some(processing_error(sides, model, false));
    let processing = balance.under_both(model, evidence, under);
    Ok(comparison(model, &balance, processing, evidence, error_of))
}

impl Balance {
    /// Compares a fitted model on these rows; the reference processing has a fit of its own, since what a processing makes
    /// of the data is part of what it finds.
    pub(in crate::diagnosis) fn compare(&self, model: &Model, evidence: &Evidence) -> Comparison {
        let under = |sides: &Sides| {
            let own = sides.fit(model)?;
            Some(processing_error(sides, &own.model, true))
        };
        let processing = self.under_both(model, evidence, under);
        comparison(model, self, processing, evidence, ErrorOf::Structure)
    }

    /// The errors under this processing and under the reference one, where that has rows.
    fn under_both(
        &self,
        model: &Model,
        evidence: &Evidence,
        under: impl Fn(&Sides) -> Option<ProcessingError>,
    ) -> Vec<ProcessingError> {
        let reference = Sides::new(Method::InverseDynamics, model, evidence).ok();
        let both = [Some(&self.sides), reference.as_ref()];
        both.into_iter().flatten().filter_map(under).collect()
    }
}

/// Errors of a model under one processing.
fn processing_error(sides: &Sides, model: &Model, fitted: bool) -> ProcessingError {
    let relative = |model: &Model, rows: &TorqueRows| {
        let predicted = regression::predicted(&regression::with_events_of(model, rows), rows);
        let pairs = rows.left.iter().zip(&predicted);
        let squares: f64 = pairs.map(|(left, sum)| (left - sum).powi(2)).sum();
        let whole: f64 = rows.left.iter().map(|left| left * left).sum();
        100.0 * (squares / whole.max(f64::MIN_POSITIVE)).sqrt()
    };
    let of_the_whole = |rows: &TorqueRows| {
        if fitted {
            let fit = regression::fit(model, rows)?;
            Some(relative(&fit.model, rows))
        } else {
            Some(relative(model, rows))
        }
    };
    ProcessingError {
        whole_run_relative_error_percent: sides.whole.as_ref().and_then(of_the_whole),
        method: sides.training.method,
        relative_error_percent: relative(model, &sides.training),
        holdout_relative_error_percent: relative(model, &sides.holdout),
        confirm_relative_error_percent: sides.confirm.as_ref().map(|rows| relative(model, rows)),
        fitted,
        sentence: sides.training.sentence.clone(),
    }
}

fn comparison(
    model: &Model,
    balance: &Balance,
    processing: Vec<ProcessingError>,
    evidence: &Evidence,
    error_of: ErrorOf,
) -> Comparison {
    let Balance { sides, scale } = balance;
    let score = |rows| balance.score(model, rows);
    let (training, holdout) = (score(&sides.training), score(&sides.holdout));
    let known = scale.source != FloorSource::None;
    let noise_floor = known.then_some(scale.unit_n_m);
    let figures = |score: &Score| HoldoutFigures {
        fit_percent: score.torque.map_or(f64::NAN, |torque| torque.fit_percent),
        rmse: score.torque.map_or(f64::NAN, |torque| torque.rmse),
    };
    let here = figures(&training);
    let speed_rad_s = speed(model, evidence);
    // Where it fails is a help; a run that it cannot be told for is still compared.
    let located = locate(model, &evidence.holdout, &evidence.noise, error_of).unwrap_or_default();
    let torque = sides.holdout.left.iter().copied();
    let left = holdout.torque_residual().into_iter();
    let with_torque: Vec<(f64, f64)> = left.map(|(_, left)| left).zip(torque).collect();
    Comparison {
        signals: Signals {
            speed_windows_s: speed_rad_s.map(|_| SPEED_WINDOW_S),
            speed_rad_s,
            current_a: None,
            torque_n_m: Some(TorqueComparison {
                fit_percent: here.fit_percent,
                rmse: here.rmse,
                noise_floor,
                holdout: figures(&holdout),
                processing,
            }),
        },
        locations: located.locations,
        balances: located.balances,
        map: located.map,
        limits: located.notes,
        residual: ResidualLights::of_torque(&with_torque),
        noise_floor_from: scale.source,
        holdout_from: evidence.holdout_from,
        holdout_rmse: holdout.nrms,
    }
}

/// The speed simulated in windows, each started from the measurement; `None` where the model is not complete or runs away.
fn speed(model: &Model, evidence: &Evidence) -> Option<SignalComparison> {
    let (training, one_step_rmse) = in_windows(model, &evidence.training)?;
    let (holdout, _) = in_windows(model, &evidence.holdout)?;
    Some(SignalComparison {
        fit_percent: training.fit_percent,
        rmse: training.rmse,
        noise_floor: None,
        one_step_rmse,
        holdout,
    })
}

fn in_windows(model: &Model, scenario: &Scenario) -> Option<(HoldoutFigures, f64)> {
    let mut plant = Plant::new(model, scenario.input).ok()?;
    let times = &scenario.sample_time_s;
    let period_s = (times.last()? - times.first()?) / (times.len() - 1).max(1) as f64;
    let start = State::at(
        0.0,
        *scenario
            .speed_rad_s
            .iter()
            .find(|speed| speed.is_finite())?,
    );
    let mut figures = |horizon: usize| {
        let ahead = plant.predict_ahead(scenario, start, horizon);
        let pairs: Vec<(f64, f64)> = scenario
            .scored
            .clone()
            .map(|sample| (ahead.speed_rad_s[sample], scenario.speed_rad_s[sample]))
            .filter(|pair| pair.0.is_finite() && pair.1.is_finite())
            .collect();
        let n = pairs.len().max(1) as f64;
        let mean = pairs.iter().map(|pair| pair.1).sum::<f64>() / n;
        let spread = pairs
            .iter()
            .map(|pair| (pair.1 - mean).powi(2))
            .sum::<f64>();
        let squares = pairs
            .iter()
            .map(|pair| (pair.0 - pair.1).powi(2))
            .sum::<f64>();
        HoldoutFigures {
            fit_percent: 100.0 * (1.0 - (squares / spread.max(f64::MIN_POSITIVE)).sqrt()),
            rmse: (squares / n).sqrt(),
        }
    };
    let found = figures(whole((SPEED_WINDOW_S / period_s).round()).max(1));
    let one_step = figures(1).rmse;
    found.rmse.is_finite().then_some((found, one_step))
}

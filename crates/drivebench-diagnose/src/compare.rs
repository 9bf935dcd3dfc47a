//! Comparison of a model with a measurement: free run, one-step and training errors; of a run without a voltage
//! the torque of the inverse model and the motor's, and its speed in short windows.

use serde::Serialize;

use super::evidence::{Evidence, HoldoutFrom};
use super::limits::Limit;
use super::location::{
    EquationBalance, ErrorMap, ErrorOf, FailureLocation, Located, Undecided, locate, undecided,
};
use super::mechanical::{self, Balance, Sides};
use super::residual::ResidualLights;
use super::score::{Score, SignalScore, signal_score};
use super::trivial::{self, TrivialPrediction};
use drivebench_identify::balance::{Derivation, Method, TorqueRows};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_identify::output_error::{self, FitError};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{Input, Model, Plant, Scenario, State};

/// Figures of one signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SignalComparison {
    pub fit_percent: f64,
    pub rmse: f64,
    /// Null where no floor is known.
    pub noise_floor: Option<f64>,
    pub one_step_rmse: f64,
    pub holdout: SignalScore,
}

/// The motor's torque and that of the inverse model; the figures are those of the weak form.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TorqueComparison {
    pub fit_percent: f64,
    /// N.m, averaged over a window.
    pub rmse: f64,
    /// Null where no floor is known.
    pub noise_floor: Option<f64>,
    pub holdout: SignalScore,
    /// The relative error under each processing of the data, on which it depends.
    pub processing: Vec<ProcessingError>,
}

impl TorqueComparison {
    /// The figures of one processing.
    pub fn under(&self, method: Method) -> Option<&ProcessingError> {
        self.processing.iter().find(|error| error.method == method)
    }
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
    #[serde(rename = "code")]
    pub derivation: Derivation,
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

/// The comparison; `compare --json` prints it with its sentences.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    pub signals: Signals,
    #[serde(rename = "where")]
    pub locations: Vec<FailureLocation>,
    /// Error of each equation's balance, the larger first.
    pub balances: Vec<EquationBalance>,
    /// The error over speed x current, on the hold-out.
    pub map: Option<ErrorMap>,
    pub residual: ResidualLights,
    pub noise_floor_from: FloorSource,
    #[serde(skip)]
    pub noise: NoiseFloor,
    pub holdout_from: HoldoutFrom,
    /// Root of the mean over the signals of `(rmse / noise)^2`, on the hold-out.
    pub holdout_rmse: f64,
    /// What predicts the hold-out as well as the fitted model does; then no locations are reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_fitted: Option<TrivialPrediction>,
    /// What these runs cannot judge, and why.
    pub limits: Vec<Limit>,
}

impl Comparison {
    /// Whether the held-out error is no more than the noise.
    pub fn is_at_the_floor(&self) -> bool {
        self.noise.is_at_the_floor(self.holdout_rmse)
    }

    /// The comparison of a fitted model without predictive power: without locations.
    fn without_locations(mut self, not_fitted: Option<TrivialPrediction>) -> Self {
        if not_fitted.is_some() {
            (self.locations, self.balances, self.map) = (Vec::new(), Vec::new(), None);
        }
        Self { not_fitted, ..self }
    }

    /// The equation with the larger error; none where none fails.
    pub fn failing(&self) -> Option<&EquationBalance> {
        self.balances.first().filter(|balance| balance.fails)
    }

    /// Whether the equation, or the variable, is undecided because two are within their uncertainty.
    pub fn undecided(&self) -> Option<Undecided> {
        undecided(&self.balances, &self.locations)
    }

    /// The location of the error, and the further ones. The balances of short windows and the residual of the whole
    /// run are two tests, which may disagree.
    pub fn where_it_fails(&self) -> (Where, &[FailureLocation]) {
        match (self.undecided(), self.locations.as_slice()) {
            (Some(undecided), places) => (Where::Undecided(undecided), places),
            (None, [_, others @ ..]) => (Where::First, others),
            (None, []) => (self.without_location(), &[]),
        }
    }

    /// Why there is no location.
    fn without_location(&self) -> Where {
        let lights = &self.residual;
        if self.not_fitted.is_some() {
            Where::NotFitted
        } else if self.balances.is_empty() {
            Where::NoBalance
        } else if self.balances.iter().any(|own| own.fails) {
            Where::AlongNothing
        } else if self.balances.iter().any(|own| own.nres.is_none()) {
            Where::NoNoiseFloor
        } else if lights.enough_samples && !lights.is_noise() {
            Where::OverTheWholeRun
        } else {
            Where::Nowhere
        }
    }
}

/// Where a model fails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Where {
    /// At the first of the locations.
    First,
    Undecided(Undecided),
    /// The model follows the run no better than a trivial prediction.
    NotFitted,
    NoBalance,
    /// An equation fails, and its error depends on none of the variables.
    AlongNothing,
    /// The errors depend on no variable, and no noise is known to compare them with.
    NoNoiseFloor,
    /// No equation fails in short windows, yet more than noise is left over the whole run.
    OverTheWholeRun,
    Nowhere,
}

/// Compares a complete model; only the initial state is fitted. `error_of` selects the located error: a fitted
/// model ([`ErrorOf::Structure`]) that predicts the hold-out no better than a trivial prediction has none.
pub fn compare(
    model: &Model,
    evidence: &Evidence,
    error_of: ErrorOf,
) -> Result<Comparison, FitError> {
    let (evidence, aside) = evidence.fitted_with(&model.effect_ids());
    let evidence = &*evidence;
    if evidence.training.input != Input::Voltage {
        let (balance, _) = Balance::new(model, evidence)?;
        return Ok(balance.compare(model, evidence, error_of, false));
    }
    let noise = &evidence.noise;
    let training = Score::of(model, &evidence.training, noise)?;
    let holdout = Score::of(model, &evidence.holdout, noise)?;
    let [current_one_step, speed_one_step] = one_step_rmse(model, evidence)?;
    let known =
        |level: f64| (noise.source != FloorSource::None && level.is_finite()).then_some(level);
    let signal = |of: fn(&Score) -> Option<SignalScore>, level, one_step_rmse| {
        let (fitted, held_out) = (of(&training)?, of(&holdout)?);
        Some(SignalComparison {
            fit_percent: fitted.fit_percent,
            rmse: fitted.rmse,
            noise_floor: known(level),
            one_step_rmse,
            holdout: held_out,
        })
    };
    let judged = |residual: &[(f64, f64)], level: f64| {
        let residual = if level.is_finite() { residual } else { &[] };
        with_input(residual, &evidence.holdout)
    };
    let located = locate(model, &evidence.holdout, noise, error_of)?;
    let is_fitted = error_of == ErrorOf::Structure;
    let not_fitted = is_fitted.then(|| trivial::as_good(&holdout, evidence, None));
    let compared = Comparison {
        signals: Signals {
            speed_rad_s: signal(|score| score.speed, noise.speed_rad_s, speed_one_step),
            current_a: signal(|score| score.current, noise.current_a, current_one_step),
            ..Signals::default()
        },
        residual: ResidualLights::of(
            &judged(&holdout.current_residual, noise.current_a),
            &judged(&holdout.speed_residual, noise.speed_rad_s),
        ),
        noise_floor_from: noise.source,
        noise: *noise,
        holdout_from: evidence.holdout_from,
        holdout_rmse: holdout.nrms,
        not_fitted: None,
        limits: limits(evidence, aside.map(Limit::RunsSetAside).into_iter().chain(located.notes)),
        locations: located.locations,
        balances: located.balances,
        map: located.map,
    };
    Ok(compared.without_locations(not_fitted.flatten()))
}

/// Limits of these runs.
fn limits(evidence: &Evidence, notes: impl Iterator<Item = Limit>) -> Vec<Limit> {
    let floor = evidence.noise.source == FloorSource::None;
    let split = evidence.holdout_from == HoldoutFrom::Split;
    let mut limits: Vec<Limit> = floor.then_some(Limit::NoNoiseFloor).into_iter().collect();
    limits.extend(notes.chain(evidence.unjudged()));
    limits.extend(split.then(|| Limit::NoOtherRun { share: evidence.held_out_share() }));
    limits
}

/// Each residual with the input at its time; the times ascend.
fn with_input(residual: &[(f64, f64)], scenario: &Scenario) -> Vec<(f64, f64)> {
    let events = &scenario.events;
    let mut event = 0;
    let mut held = |time_s: f64| {
        while event + 1 < events.len() && events[event + 1].0 < time_s {
            event += 1;
        }
        events[event].1
    };
    residual.iter().map(|(time_s, value)| (*value, held(*time_s))).collect()
}

/// Root mean square of the one-step prediction errors of current and speed on the training run.
fn one_step_rmse(model: &Model, evidence: &Evidence) -> Result<[f64; 2], FitError> {
    let scenario = &evidence.training;
    let start = output_error::predict(model, scenario, &evidence.noise)?.start;
    let ahead = Plant::new(model, scenario.input)?.predict_ahead(scenario, start, 1, 0);
    let rmse = |predicted: &[f64], measured: &[f64]| {
        scored(predicted, measured, scenario).map_or(f64::NAN, |signal| signal.rmse)
    };
    let current = rmse(&ahead.current_a, &scenario.current_a);
    Ok([current, rmse(&ahead.speed_rad_s, &scenario.speed_rad_s)])
}

fn scored(predicted: &[f64], measured: &[f64], scenario: &Scenario) -> Option<SignalScore> {
    let samples = scenario.scored.clone();
    let errors: Vec<f64> = samples.clone().map(|k| predicted[k] - measured[k]).collect();
    signal_score(&errors, &measured[samples])
}

/// Length of the windows in which the speed is simulated, s: an axis in a closed loop is an integrator, whose long free
/// run only shows how the least offset adds up.
const SPEED_WINDOW_S: f64 = 0.75;

impl Balance {
    /// Compares a model on these rows, as it is or fitted to them; where it is fitted the reference processing has a fit of
    /// its own, since what a processing makes of the data is part of what it finds.
    pub(super) fn compare(
        &self,
        model: &Model,
        evidence: &Evidence,
        error_of: ErrorOf,
        fitted: bool,
    ) -> Comparison {
        let reference = Sides::new(Method::InverseDynamics, model, evidence).ok();
        let both = [Some(&self.sides), reference.as_ref()].into_iter().flatten();
        let processing = both.filter_map(|sides| processing_error(sides, model, fitted)).collect();
        let training = self.score(model, &self.sides.training);
        let holdout = self.score(model, &self.sides.holdout);
        let figures = |score: &Score| score.torque.unwrap_or(SignalScore::UNKNOWN);
        let SignalScore { fit_percent, rmse, .. } = figures(&training);
        let speed_rad_s = speed(model, evidence);
        // A run without a location is still compared.
        let Located { locations, balances, map, notes } =
            locate(model, &evidence.holdout, &evidence.noise, error_of).unwrap_or_default();
        let torques: [&[f64]; 2] = [&self.sides.training.left, &self.sides.holdout.left];
        let left = holdout.torque_residual.iter().map(|point| point.1);
        let with_torque: Vec<(f64, f64)> = left.zip(torques[1].iter().copied()).collect();
        let is_fitted = error_of == ErrorOf::Structure;
        let not_fitted = is_fitted.then(|| trivial::as_good(&holdout, evidence, Some(torques)));
        let compared = Comparison {
            signals: Signals {
                speed_windows_s: speed_rad_s.map(|_| SPEED_WINDOW_S),
                speed_rad_s,
                current_a: None,
                torque_n_m: Some(TorqueComparison {
                    fit_percent,
                    rmse,
                    noise_floor: (self.source != FloorSource::None).then_some(self.unit_n_m),
                    holdout: figures(&holdout),
                    processing,
                }),
            },
            locations,
            balances,
            map,
            not_fitted: None,
            limits: notes,
            residual: ResidualLights::of_torque(&with_torque),
            noise_floor_from: self.source,
            noise: NoiseFloor { source: self.source, ..evidence.noise },
            holdout_from: evidence.holdout_from,
            holdout_rmse: holdout.nrms,
        };
        compared.without_locations(not_fitted.flatten())
    }
}

/// Errors of a model under one processing, fitted to it where `fitted`.
fn processing_error(sides: &Sides, model: &Model, fitted: bool) -> Option<ProcessingError> {
    let relative = |rows: &TorqueRows, model: &Model| {
        let predicted = mechanical::predicted(&mechanical::with_events_of(model, rows), rows);
        let squares: f64 = rows.residual(&predicted).iter().map(|own| own * own).sum();
        let left = rows.weighted(rows.left.iter().copied());
        let whole: f64 = left.iter().map(|left| left * left).sum();
        100.0 * (squares / whole.max(f64::MIN_POSITIVE)).sqrt()
    };
    let on = |rows: &TorqueRows, model: &Model| {
        let own = if fitted { mechanical::fit(model, rows)?.model } else { model.clone() };
        Some((relative(rows, &own), own))
    };
    let (relative_error_percent, model) = on(&sides.training, model)?;
    let whole = sides.whole.as_ref().and_then(|rows| on(rows, &model));
    Some(ProcessingError {
        whole_run_relative_error_percent: whole.map(|whole| whole.0),
        method: sides.training.method,
        relative_error_percent,
        holdout_relative_error_percent: relative(&sides.holdout, &model),
        confirm_relative_error_percent: sides.confirm.as_ref().map(|rows| relative(rows, &model)),
        fitted,
        derivation: sides.training.derivation.clone(),
    })
}

/// The speed simulated in windows, each started from the measurement; `None` where the model is not complete or errs by more
/// than the largest speed of the run, as with an inertia that the run does not show.
fn speed(model: &Model, evidence: &Evidence) -> Option<SignalComparison> {
    let [training, one_step] = in_windows(model, &evidence.training)?;
    let [holdout, _] = in_windows(model, &evidence.holdout)?;
    if holdout.rmse > largest(&evidence.holdout.speed_rad_s) {
        return None;
    }
    Some(SignalComparison {
        fit_percent: training.fit_percent,
        rmse: training.rmse,
        noise_floor: None,
        one_step_rmse: one_step.rmse,
        holdout,
    })
}

/// The same for one run, and one step ahead.
fn in_windows(model: &Model, scenario: &Scenario) -> Option<[SignalScore; 2]> {
    let mut plant = Plant::new(model, scenario.input).ok()?;
    let mut speeds = scenario.speed_rad_s.iter().copied();
    let start = State::at(0.0, speeds.find(|speed| speed.is_finite())?);
    let mut figures = |horizon: usize| {
        let ahead = plant.predict_ahead(scenario, start, horizon, 0);
        scored(&ahead.speed_rad_s, &scenario.speed_rad_s, scenario)
    };
    let found = figures(whole((SPEED_WINDOW_S / scenario.mean_period_s()).round()).max(1))?;
    let one_step = figures(1)?;
    found.rmse.is_finite().then_some([found, one_step])
}

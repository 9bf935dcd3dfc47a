//! The methods of identification by name: what `identify --scheme` offers.
//!
//! ```text
//! Data { run, scenario, model } -> CATALOGUE[id].identify -> Identified { model, parameters, notes }
//! ```
//!
//! A new method is one file here and one line in [`CATALOGUE`]; its arithmetic lives in a room of its own.

mod balances;
mod contract_tests;
mod known_arm;
mod online;
mod output_error;
mod scheme_1;
mod scheme_1_tests;

use std::borrow::Cow;

use thiserror::Error;

use super::misfit::Misfit;
use super::output_error::FitError;
use super::step_response;
use drivebench_model::plant::{ActiveEffect, Input, Model, ModelError, MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Run};

#[derive(Clone, Copy, Debug)]
pub struct Data<'a> {
    /// The record, row by row.
    pub run: &'a Run,
    /// The same record prepared for simulation.
    pub scenario: &'a Scenario,
    /// Which parameters are sought and which are fixed, and where to start; values may be missing.
    pub model: &'a Model,
}

impl Data<'_> {
    /// The run with the voltage that the scenario takes, and no other: a foreign file may hold a command besides a
    /// voltage that was applied, and every scheme has to take the same one. Where rows were lost its estimate stands in a
    /// row of its own, and what is not known well enough counts as held back by a limit of the drive.
    fn run_as_used(&self) -> Cow<'_, Run> {
        let command = Channel::VoltageCmd;
        let mut run = Cow::Borrowed(self.run);
        if self.scenario.input_channel == Channel::Voltage && self.run.column(command).is_some() {
            run = Cow::Owned(self.run.without(command));
        }
        if self.scenario.unknown_input.is_empty() {
            return run;
        }
        online::with_lost_voltages(&run, self.scenario).map_or(run, Cow::Owned)
    }

    /// That `scheme` cannot use this run.
    fn refused(
        &self,
        scheme: &'static str,
        reason: impl Into<String>,
        help: &'static str,
    ) -> IdentifyError {
        IdentifyError::Unusable { scheme, run: self.run.name.clone(), reason: reason.into(), help }
    }
}

#[derive(Clone, Debug)]
pub struct Identified {
    pub scheme: &'static str,
    /// The model with every value that was found.
    pub model: Model,
    pub parameters: Vec<ParameterEstimate>,
    /// What the model leaves beside the noise, where the method gives it.
    pub misfit: Option<Misfit>,
    /// What the reader has to know about the method's limits on these data.
    pub notes: Vec<String>,
}

impl Identified {
    /// The values found are taken over into a copy of `model`.
    pub fn new(scheme: &'static str, model: &Model, parameters: Vec<ParameterEstimate>) -> Self {
        let mut model = model.clone();
        for slot in model.slots() {
            if let Some(value) = ParameterEstimate::value_of(&parameters, &slot.key()) {
                model.set(&slot, value);
            }
        }
        // A torque constant that was found on its own ends the rule that it equals the back-EMF constant.
        let torque = MotorKey::TorqueConstant;
        if let Some(value) = ParameterEstimate::value_of(&parameters, torque.key()) {
            model.motor.set(torque, value);
        }
        Self { scheme, model, parameters, misfit: None, notes: Vec::new() }
    }

    #[must_use]
    pub fn with_note(mut self, note: impl Into<String>) -> Self {
        self.notes.push(note.into());
        self
    }
}

#[derive(Debug)]
pub struct Scheme {
    id: &'static str,
    summary: &'static str,
    identify: fn(&'static str, &Data<'_>) -> Result<Identified, IdentifyError>,
}

impl Scheme {
    /// The name on the command line and in results.
    pub const fn id(&self) -> &'static str {
        self.id
    }

    /// One line for `--help`.
    pub const fn summary(&self) -> &'static str {
        self.summary
    }

    pub fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        (self.identify)(self.id, data)
    }
}

/// Every scheme, in the order in which help shows them.
pub static CATALOGUE: &[&Scheme] = &[
    &output_error::OUTPUT_ERROR,
    &balances::WEAK_FORM,
    &scheme_1::PRINTED,
    &scheme_1::EXACT,
    &scheme_1::WITH_INSTRUMENTS,
    &balances::INVERSE_DYNAMICS,
    &online::SCHEME_2,
    &online::RECTANGLE,
    &online::SCHEME_3,
    &STEP_RESPONSE,
    &online::EKF,
];

/// Readings from one step of voltage: the plain baseline.
const STEP_RESPONSE: Scheme = Scheme {
    id: "step-response",
    summary: "graphical readings from one step of voltage out of rest: a plain baseline, crude",
    identify: |id, data| {
        let (parameters, notes) = step_response::estimates(data.model, data.scenario);
        let mut identified = Identified::new(id, data.model, parameters);
        identified.notes = notes;
        Ok(identified.leaving_out(data.model, motor_alone))
    },
};

/// Name of the scheme that fits the free run of a model.
pub const FREE_RUN: &str = output_error::OUTPUT_ERROR.id;

/// Name of the scheme for a known weight on an arm. It is not in the catalogue, as the model must have that weight.
pub const KNOWN_ARM: &str = known_arm::KNOWN_ARM.id;

/// The scheme of that name.
pub fn find(id: &str) -> Result<&'static Scheme, IdentifyError> {
    let mut all = CATALOGUE.iter().copied().chain([&known_arm::KNOWN_ARM]);
    all.find(|scheme| scheme.id() == id).ok_or_else(|| IdentifyError::UnknownScheme {
        id: id.to_owned(),
        allowed: CATALOGUE.iter().map(|scheme| scheme.id()).collect::<Vec<_>>().join(", "),
    })
}

/// The scheme for a run when none is named: the free run where there is a voltage, else the torque balance.
pub fn default_for(scenario: &Scenario) -> &'static Scheme {
    if scenario.input == Input::Voltage {
        &output_error::OUTPUT_ERROR
    } else {
        &balances::WEAK_FORM
    }
}

/// Why a scheme for the motor alone carries no effect.
#[expect(clippy::unnecessary_wraps, reason = "one of the answers that a scheme may give")]
fn motor_alone(_: &ActiveEffect) -> Option<&'static str> {
    Some("this scheme has the motor's own parameters only")
}

impl Identified {
    /// Says which effects of `model` were left out and why; `why` gives the reason, `None` for one that was carried.
    #[must_use]
    fn leaving_out(
        mut self,
        model: &Model,
        why: impl Fn(&ActiveEffect) -> Option<&'static str>,
    ) -> Self {
        for active in &model.effects {
            let id = active.id();
            let Some(reason) = why(active) else {
                self.notes.extend(guessed(active));
                continue;
            };
            self.notes.push(format!(
                "{id} is left out: {reason}; what it does goes into the other parameters. \
                 The output-error fit carries it"
            ));
            for (spec, value) in active.effect.parameters().iter().zip(&active.values) {
                let key = format!("{id}.{}", spec.key);
                self.parameters.retain(|parameter| parameter.key != key);
                if value.is_none() {
                    let code = Reason::NotInScheme;
                    self.parameters
                        .push(ParameterEstimate::not_observable(&key, spec.unit, code, reason));
                }
            }
        }
        self
    }
}

/// A value that gives an effect its form, which a linear scheme takes as it is, and which the model does not give.
fn guessed(active: &ActiveEffect) -> Vec<String> {
    let specs = active.effect.parameters().iter();
    specs
        .zip(&active.values)
        .filter(|(spec, value)| !spec.is_coefficient() && value.is_none())
        .map(|(spec, _)| {
            format!(
                "{}.{} is not given and this scheme cannot find it: {} {} is taken; the output-error fit finds it",
                active.id(),
                spec.key,
                spec.guess(),
                spec.unit
            )
        })
        .collect()
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum IdentifyError {
    #[error("scheme {id:?} is not known (allowed: {allowed})")]
    UnknownScheme { id: String, allowed: String },
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Fit(FitError),
    /// The data cannot serve this scheme; another one may do.
    #[error("scheme {scheme} cannot use run {run:?}: {reason}")]
    Unusable { scheme: &'static str, run: String, reason: String, help: &'static str },
}

impl IdentifyError {
    pub fn help(&self) -> &'static str {
        match self {
            Self::UnknownScheme { .. } => "see drivebench identify --help",
            Self::Model(error) => error.help(),
            Self::Fit(error) => error.help(),
            Self::Unusable { help, .. } => help,
        }
    }

    /// Whether the request is wrong, rather than the data too poor for it.
    pub const fn is_usage(&self) -> bool {
        matches!(self, Self::UnknownScheme { .. } | Self::Model(_))
    }
}

impl From<FitError> for IdentifyError {
    fn from(error: FitError) -> Self {
        match error {
            FitError::Model(error) => Self::Model(error),
            error => Self::Fit(error),
        }
    }
}

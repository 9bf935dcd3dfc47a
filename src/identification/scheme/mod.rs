//! The methods of identification by name: what `identify --scheme` offers.
//!
//! ```text
//! Data { run, scenario, model } -> CATALOGUE[id].identify -> Identified { model, parameters, notes }
//! ```
//!
//! A new method is one file here and one line in [`CATALOGUE`]; its arithmetic lives in a room of its own.

mod contract_tests;
mod ekf;
mod error;
mod inverse_dynamics;
mod left_out;
mod lost_rows;
mod online;
mod output_error;
mod scheme_1;
mod scheme_1_tests;
mod scheme_2_rectangle;
mod step_response;
mod weak_form;

pub use error::IdentifyError;

use std::borrow::Cow;

use crate::plant::{Input, Model, MotorKey, Scenario};
use crate::sample::{Channel, ParameterEstimate, Run};

/// What a scheme works on.
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
    /// voltage that was applied, and every scheme has to see the same one. Where rows were lost its estimate stands in a
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
        lost_rows::estimated(&run, self.scenario).map_or(run, Cow::Owned)
    }
}

/// What a scheme found.
#[derive(Clone, Debug)]
pub struct Identified {
    pub scheme: &'static str,
    /// The model with every value that was found.
    pub model: Model,
    pub parameters: Vec<ParameterEstimate>,
    /// What the reader has to know about the method's limits on these data.
    pub notes: Vec<String>,
}

impl Identified {
    /// The values found are taken over into a copy of `model`.
    pub fn new(scheme: &'static str, model: &Model, parameters: Vec<ParameterEstimate>) -> Self {
        let mut model = model.clone();
        for slot in model.slots() {
            let found = parameters
                .iter()
                .find(|parameter| parameter.key == slot.key());
            if let Some(value) = found.and_then(|parameter| parameter.value) {
                model.set(&slot, value);
            }
        }
        // A torque constant that was found on its own ends the rule that it equals the back-EMF constant.
        let torque = MotorKey::TorqueConstant;
        if let Some(value) = parameters
            .iter()
            .find(|parameter| parameter.key == torque.key())
            .and_then(|parameter| parameter.value)
        {
            model.motor.set(torque, value);
        }
        Self {
            scheme,
            model,
            parameters,
            notes: Vec::new(),
        }
    }

    #[must_use]
    pub fn with_note(mut self, note: impl Into<String>) -> Self {
        self.notes.push(note.into());
        self
    }
}

/// One method of identification.
pub trait Scheme: Sync {
    /// The name on the command line and in results.
    fn id(&self) -> &'static str;
    /// One line for `--help`.
    fn summary(&self) -> &'static str;
    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError>;
}

/// Every scheme, in the order in which help shows them.
pub static CATALOGUE: &[&dyn Scheme] = &[
    &output_error::OutputError,
    &weak_form::WeakForm,
    &scheme_1::Printed,
    &scheme_1::Exact,
    &scheme_1::WithInstruments,
    &inverse_dynamics::InverseDynamics,
    &online::Scheme2,
    &scheme_2_rectangle::Rectangle,
    &online::Scheme3,
    &step_response::StepResponse,
    &ekf::Ekf,
];

/// The scheme of that name.
pub fn find(id: &str) -> Result<&'static dyn Scheme, IdentifyError> {
    CATALOGUE
        .iter()
        .copied()
        .find(|scheme| scheme.id() == id)
        .ok_or_else(|| IdentifyError::UnknownScheme {
            id: id.to_owned(),
            allowed: CATALOGUE
                .iter()
                .map(|scheme| scheme.id())
                .collect::<Vec<_>>()
                .join(", "),
        })
}

/// The scheme for a run when none is named: the free run where there is a voltage, else the torque balance.
pub fn default_for(scenario: &Scenario) -> &'static dyn Scheme {
    if scenario.input == Input::Voltage {
        &output_error::OutputError
    } else {
        &weak_form::WeakForm
    }
}

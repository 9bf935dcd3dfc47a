//! A fitted model as the diagnosis hands it on, whatever method fitted it.

use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::Fit;
use crate::plant::{Model, State};
use crate::sample::ParameterEstimate;

/// A model with what is known about its parameters.
#[derive(Clone, Debug)]
pub struct Fitted {
    pub model: Model,
    /// Every parameter of the model, in the order of its slots.
    pub parameters: Vec<ParameterEstimate>,
    /// Training error in units of the noise.
    pub nrms: f64,
    pub noise: NoiseFloor,
    /// What the standard deviations above were multiplied by, because more than noise is left over.
    pub interval_factor: f64,
    /// Where the training run begins.
    pub start: State,
}

impl From<&Fit> for Fitted {
    fn from(fit: &Fit) -> Self {
        Self {
            model: fit.model.clone(),
            parameters: fit.parameters.clone(),
            nrms: fit.nrms,
            noise: fit.noise,
            interval_factor: fit.interval_factor,
            start: fit.start,
        }
    }
}

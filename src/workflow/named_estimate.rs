//! An estimate as a result file lists it.

use serde::Serialize;

use crate::sample::ParameterEstimate;

/// An estimate with its key in the JSON.
#[derive(Clone, Debug, Serialize)]
pub struct NamedEstimate {
    pub key: String,
    #[serde(flatten)]
    pub estimate: ParameterEstimate,
}

impl NamedEstimate {
    pub fn list(estimates: &[ParameterEstimate]) -> Vec<Self> {
        estimates
            .iter()
            .map(|estimate| Self {
                key: estimate.key.clone(),
                estimate: estimate.clone(),
            })
            .collect()
    }
}

//! Estimates in a result file, each with its key.

use serde::{Serialize, Serializer};

use drivebench_model::sample::ParameterEstimate;

/// Estimates as a result file lists them: each with its key.
pub(super) fn with_keys<S: Serializer>(
    estimates: &[ParameterEstimate],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct Keyed<'a> {
        key: &'a str,
        #[serde(flatten)]
        estimate: &'a ParameterEstimate,
    }
    serializer.collect_seq(estimates.iter().map(|estimate| Keyed { key: &estimate.key, estimate }))
}

//! What a commissioning leaves behind, as `commission --json` prints it.

use serde::{Serialize, Serializer};

use super::burst::BurstResult;
use super::escalate::EscalationResult;
use crate::diagnosis::{Comparison, Diagnosis, Rung};
use crate::identification::nameplate;
use crate::sample::ParameterEstimate;

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
    serializer.collect_seq(estimates.iter().map(|estimate| Keyed {
        key: &estimate.key,
        estimate,
    }))
}

/// One recorded run of the loop.
#[derive(Clone, Debug, Serialize)]
pub struct RunRecord {
    pub role: &'static str,
    /// Run folder; none where nothing is written.
    pub folder: Option<String>,
    pub rows: u64,
    pub rate_hz: f64,
    pub missed_cycles: u64,
}

/// What an emulator carried, for scoring the answer; a real drive has none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth {
    pub effects: Vec<String>,
    pub named_correctly: bool,
}

/// The whole loop's outcome.
#[derive(Clone, Debug, Serialize)]
pub struct CommissionResult {
    pub sentence: String,
    pub diagnosis: Diagnosis,
    /// The refitted baseline and the model with the named effects, on the confirming run.
    pub before: Comparison,
    pub after: Comparison,
    #[serde(serialize_with = "with_keys")]
    pub parameters_before: Vec<ParameterEstimate>,
    #[serde(serialize_with = "with_keys")]
    pub parameters: Vec<ParameterEstimate>,
    /// What the on-line estimators had found by the end of the fit run.
    #[serde(serialize_with = "with_keys")]
    pub online: Vec<ParameterEstimate>,
    /// What was found against the plate, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nameplate: Option<nameplate::Comparison>,
    /// How an unknown motor was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub escalation: Option<EscalationResult>,
    /// What a burst told, where the loop is slower than the current.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub burst: Option<BurstResult>,
    /// Errors on the selecting run, one rung for each model.
    pub ladder: Vec<Rung>,
    /// Errors on the confirming run: the headline.
    pub confirmed: [Rung; 2],
    pub runs: Vec<RunRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<Truth>,
}

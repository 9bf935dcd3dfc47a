//! What a commissioning leaves behind, as `commission --json` prints it.

use serde::Serialize;

use super::burst::BurstResult;
use super::escalate::EscalationResult;
use super::named_estimate::NamedEstimate;
use crate::diagnosis::{Comparison, Diagnosis, Rung};
use crate::identification::nameplate;

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
    pub parameters_before: Vec<NamedEstimate>,
    pub parameters: Vec<NamedEstimate>,
    /// What the on-line estimators had found by the end of the fit run.
    pub online: Vec<NamedEstimate>,
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

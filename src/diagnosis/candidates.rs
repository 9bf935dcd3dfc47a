//! One candidate effect: screened, refitted with everything else free, scored on data that the fit has not seen.

use serde::{Serialize, Serializer, ser::SerializeMap};

use super::reached::Reached;
use super::score::Score;
use crate::identification::output_error::Fit;
use crate::plant::Effect;
use crate::sample::{ParameterEstimate, Verdict};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Pays on the hold-out beyond chance and is in the answer.
    Supported,
    /// Pays on the hold-out, but less than the answer; or could be told from it only by another run.
    Possible,
    /// Was visible in this run and does not pay.
    RuledOut,
    /// This run would not show it even at its typical size.
    NotExcited,
}

/// What is reported of one effect.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    pub effect: &'static str,
    pub rank: usize,
    pub status: Status,
    /// Share of seeded block bootstraps of the hold-out in which it ranks first.
    pub probability: f64,
    /// Whether the model was refitted with it. Where the screen's linear step was enough to rule it out, nothing that a
    /// refit would give is reported: that step is no fit and may be worse than the baseline.
    pub refitted: bool,
    #[serde(serialize_with = "by_key")]
    pub parameters: Vec<ParameterEstimate>,
    /// What the standard deviations of the parameters were multiplied by: more than one where more than noise is left over,
    /// so that they hold only if nothing else is missing.
    pub interval_factor: f64,
    /// How large it became on the training run.
    pub reached: Option<Reached>,
    /// Training error before and after, in units of the noise.
    pub error_before: f64,
    pub error_after: Option<f64>,
    pub holdout_before: f64,
    pub holdout_after: Option<f64>,
    pub explained_percent: Option<f64>,
    /// Smallest size of its first parameter that this run would have shown.
    pub minimum_detectable: Option<f64>,
    pub evidence: String,
}

/// Parameters as a JSON object by their key.
pub(super) fn by_key<S: Serializer>(
    parameters: &[ParameterEstimate],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(parameters.len()))?;
    for parameter in parameters {
        map.serialize_entry(
            parameter.key.rsplit('.').next().unwrap_or(&parameter.key),
            parameter,
        )?;
    }
    map.end()
}

/// A candidate's refit with its scores.
#[derive(Clone)]
pub(super) struct Refit {
    pub(super) effect: &'static dyn Effect,
    pub(super) fit: Fit,
    pub(super) holdout: Score,
    pub(super) minimum_detectable: f64,
    pub(super) visible: f64,
    pub(super) free_parameters: usize,
    /// False where `fit` is the screen's linear step.
    pub(super) refitted: bool,
    /// Share of the unexplained error that it takes away to first order.
    pub(super) screened_share: f64,
}

impl Refit {
    pub(super) fn id(&self) -> &'static str {
        self.effect.card().id
    }

    /// The effect's own parameters; without a value where it was not refitted.
    pub(super) fn parameters(&self) -> Vec<ParameterEstimate> {
        let prefix = format!("{}.", self.id());
        let own = self.fit.parameters.iter();
        let own = own.filter(|parameter| parameter.key.starts_with(&prefix));
        own.cloned()
            .map(|parameter| {
                if self.refitted {
                    return parameter;
                }
                ParameterEstimate {
                    value: None,
                    std: None,
                    verdict: Verdict::Searching,
                    reason: Some("not refitted: the screen ruled it out".to_owned()),
                    ..parameter
                }
            })
            .collect()
    }
}

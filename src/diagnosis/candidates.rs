//! One candidate effect: screened, refitted with everything else free, scored on data that the fit has not seen.

use serde::{Serialize, Serializer, ser::SerializeMap};

use super::family::takes_power;
use super::reached::Reached;
use super::score::Score;
use super::screen::Detectable;
use crate::identification::output_error::Fit;
use crate::plant::{Effect, ParameterRole};
use crate::sample::{ParameterEstimate, Verdict};

/// Standard deviations from zero at which a size is plain.
const PLAIN: f64 = 3.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Pays on the hold-out beyond chance and is in the answer.
    Supported,
    /// Pays on the hold-out, but less than the answer; or could be told from it only by another run.
    Possible,
    /// Was visible in this run and does not pay.
    RuledOut,
    /// This run would not show it even at its typical size, or in too few moments to tell it from chance.
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
    /// Whether the model was refitted with it, alone or with the whole answer. Where the screen's linear step was enough to rule it out, nothing that a
    /// refit would give is reported: that step is no fit and may be worse than the baseline.
    pub refitted: bool,
    /// Of a named effect from the fit of the whole answer, as its interval and what it reached; of the others from their
    /// own.
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
    /// Smallest size of its first parameter that this run would have shown. Null where it would have shown none, or where
    /// the effect is the larger the smaller the parameter is.
    pub minimum_detectable: Option<f64>,
    /// Of a shaft that yields: it would have shown if its natural frequency were lower than this, Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detectable_below_hz: Option<f64>,
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
    pub(super) detectable: Detectable,
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

    /// Whether it may be named at all: with a size that physics allows, and one that is plain.
    pub(super) fn is_possible(&self) -> bool {
        let first = || self.own(&self.fit).into_iter().next()?.value;
        let is_reversed = takes_power(self.id()) && first().is_some_and(|size| size < 0.0);
        !is_reversed && self.size_is_plain()
    }

    /// Whether the fit itself tells its size from zero. Asked only of a form that is free to choose its time: it finds a
    /// time at which the error of any run is smaller with it, and where even its size is in doubt, it is not there.
    fn size_is_plain(&self) -> bool {
        let specs = self.effect.parameters();
        let has = |role| specs.iter().any(|spec| spec.role == role);
        if !has(ParameterRole::EventTime) {
            return true;
        }
        specs
            .iter()
            .zip(&self.own(&self.fit))
            .filter(|(spec, _)| spec.role == ParameterRole::Coefficient)
            .any(|(_, size)| match (size.value, size.std) {
                (Some(value), Some(std)) => value.abs() >= PLAIN * std,
                _ => true,
            })
    }

    /// The effect's own parameters in a fit that has it.
    pub(super) fn own(&self, fit: &Fit) -> Vec<ParameterEstimate> {
        let prefix = format!("{}.", self.id());
        let own = fit.parameters.iter();
        own.filter(|parameter| parameter.key.starts_with(&prefix))
            .cloned()
            .collect()
    }

    /// The effect's own parameters; without a value where it was not refitted.
    pub(super) fn parameters(&self) -> Vec<ParameterEstimate> {
        self.own(&self.fit)
            .into_iter()
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

//! One candidate effect: screened, refitted with everything else free, scored on data that the fit has not seen.

use serde::{Serialize, Serializer, ser::SerializeMap};

use super::reached::Reached;
use crate::sample::ParameterEstimate;

/// Probabilities from which on an effect is supported, and below which it is ruled out: one table for every output.
const SUPPORTED: f64 = 0.9;
const POSSIBLE: f64 = 0.1;
/// Probability above which runs do show an effect, whatever was expected of them.
const LIKELY: f64 = 0.5;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// There with nine parts in ten or more.
    Supported,
    Possible,
    /// There with less than one part in ten, in runs that would show it.
    RuledOut,
    /// These runs would not show it even at a size that would matter.
    NotExcited,
}

impl Status {
    /// As a person reads it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Supported => "supported",
            Self::Possible => "possible",
            Self::RuledOut => "ruled out",
            Self::NotExcited => "not excited",
        }
    }

    /// The word for a probability.
    pub fn of(probability: f64, excited: bool) -> Self {
        if probability >= SUPPORTED {
            Self::Supported
        } else if !excited && probability <= LIKELY {
            Self::NotExcited
        } else if probability >= POSSIBLE {
            Self::Possible
        } else {
            Self::RuledOut
        }
    }
}

/// A run that speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunOf {
    Fit,
    Holdout,
    /// Both, where one run was split.
    Whole,
}

/// When something that happens once did so in one run, and how large it was there: in the unit of its first parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Onset {
    pub run: RunOf,
    /// Since the run's first command.
    pub time_s: f64,
    pub interval_95_s: [f64; 2],
    pub size: f64,
    pub size_std: f64,
}

/// What is reported of one effect.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    pub effect: &'static str,
    pub rank: usize,
    pub status: Status,
    /// That it is there, weighed jointly with all others.
    pub probability: f64,
    /// Of a named effect from the fit of the whole answer, as its interval and what it reached; of the others from their
    /// own.
    #[serde(serialize_with = "by_key")]
    pub parameters: Vec<ParameterEstimate>,
    /// Of what happens once: when it did, in each run where it did.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub onsets: Vec<Onset>,
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
    /// Its size is below this with 95 %, whatever else is there: its first parameter, or the amplitude of sine and cosine.
    /// Null where these runs do not show it, or where it is there wholly or not at all.
    pub upper_bound: Option<f64>,
    /// A size that would have been named in 95 of 100 such records.
    pub detectable: Option<f64>,
    pub evidence: String,
}

/// Factor from which on it is worth a word that intervals were widened.
const WORTH_SAYING: f64 = 1.05;

impl Candidate {
    /// Said beside its size where its intervals are wider than the noise alone makes them.
    pub fn widened(&self) -> Option<String> {
        (self.interval_factor > WORTH_SAYING).then(|| {
            format!(
                "widened {:.1} times, as more than noise is left over: they hold if nothing else is missing",
                self.interval_factor
            )
        })
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_follow_probabilities_and_what_is_named_is_never_not_excited() {
        for (probability, excited, word) in [
            (0.95, true, Status::Supported),
            (0.95, false, Status::Supported),
            (0.6, true, Status::Possible),
            (0.6, false, Status::Possible),
            (0.3, true, Status::Possible),
            (0.3, false, Status::NotExcited),
            (0.05, true, Status::RuledOut),
            (0.05, false, Status::NotExcited),
        ] {
            assert_eq!(Status::of(probability, excited), word, "{probability}");
        }
    }
}

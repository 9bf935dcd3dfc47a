//! One candidate effect: its probability jointly with all others, its size, and the fall of the error on data that the fit has
//! not used.

use serde::{Serialize, Serializer};

use super::evidence::{Evidence, HoldoutFrom};
use super::floor::Floor;
use super::joint::answer::{Inference, Onset, RunOf};
use super::joint::marginal::Inferred;
use super::ladder::Standing;
use super::limits::WhyOpen;
use super::reached::{self, Reached};
use super::score::{Fitted, by_key, parameters_of};
use super::vetoes::VetoReason;
use drivebench_identify::claims::{has_no_scale, is_tied};
use drivebench_identify::noise::FloorSource;
use drivebench_identify::verdict::judge;
use drivebench_model::findings;
use drivebench_model::plant::{Effect, ParameterRole, ParameterSpec, Scenario, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason, TWO_SIDED_95};

/// Probabilities from which on an effect is supported, and below which it is ruled out: one table for every output.
const SUPPORTED_PROBABILITY: f64 = 0.9;
const POSSIBLE_PROBABILITY: f64 = 0.1;
/// Probability above which runs show an effect, whatever their expected precision.
pub(super) const LIKELY_PROBABILITY: f64 = 0.5;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Probability of at least 0.9.
    Supported,
    Possible,
    /// Probability below 0.1, in runs in which it would be detectable.
    RuledOut,
    /// Not detectable in these runs even at a size that would matter.
    NotExcited,
}

impl Status {
    /// The status of a probability.
    pub fn of(probability: f64, excited: bool) -> Self {
        if probability >= SUPPORTED_PROBABILITY {
            Self::Supported
        } else if probability > LIKELY_PROBABILITY {
            Self::Possible
        } else if probability.is_nan() || !excited {
            Self::NotExcited
        } else if probability >= POSSIBLE_PROBABILITY {
            Self::Possible
        } else {
            Self::RuledOut
        }
    }
}

/// What is reported of one effect.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    pub effect: &'static str,
    pub rank: usize,
    pub status: Status,
    /// Posterior probability that it is present, jointly with all others.
    pub probability: f64,
    /// Of a named effect, from the fit of the whole answer, as its interval and what it reached; empty of the others.
    #[serde(serialize_with = "by_key")]
    pub parameters: Vec<ParameterEstimate>,
    /// Times of an event, in each run in which it occurred.
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
    /// The effect of the answer, or of the model, from which these runs do not distinguish it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub as_good_as: Option<&'static str>,
    /// Upper 95 % bound of its size, whatever else is present: its first parameter, or the amplitude of sine and cosine.
    /// Null where these runs do not show it, or where it has no size.
    pub upper_bound: Option<f64>,
    /// Shapes of its equation that were tried in these runs, from and to, in the unit of each: nothing is known of others.
    #[serde(serialize_with = "searched_by_key", skip_serializing_if = "Vec::is_empty")]
    pub searched: Vec<(&'static ParameterSpec, [f64; 2])>,
    /// A size that would have been named in 95 of 100 such records.
    pub detectable: Option<f64>,
    #[serde(rename = "code")]
    pub finding: CandidateFinding,
    /// Why it is not named whatever its probability is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_named: Option<VetoReason>,
    /// Whether the search was inconclusive: it is neither ruled out nor known not to be excited.
    pub is_open: bool,
    /// Length of the training run: a longer time constant is not observable.
    #[serde(skip)]
    pub run_s: f64,
}

findings! {
    /// What the runs show of an effect.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum CandidateFinding {
        NotJudged { why: &'static str } = "cannot_be_judged",
        LeftOpen(WhyOpen) = "left_open",
        NotShown = "would_not_show",
        /// It is in the answer: what errors are counted in, and where the hold-out comes from.
        Named { floor: FloorSource, holdout_from: HoldoutFrom } = "named",
        RuledOut = "ruled_out",
        MayBeThere { upper_bound: Option<f64> } = "may_be_there",
    }
}

impl Candidate {
    /// These runs do not distinguish it from `other`, which is in the answer or in the model.
    pub(super) const fn is_as_good_as(&mut self, other: &'static str) {
        self.as_good_as = Some(other);
    }

    /// Whether its probability is above one half and its refit does not confirm it.
    pub fn is_not_confirmed_by_refit(&self) -> bool {
        self.status == Status::Possible && self.probability > LIKELY_PROBABILITY
    }
}

/// Every candidate, those of the answer first, in the order in which they join the model: each with the fall of the
/// held-out error on its own rung of the ladder and its size besides the others, which `best`, the
/// reported fit of the last rung, gives.
pub(super) fn candidates(
    evidence: &Evidence,
    floor: Floor<'_>,
    inference: &Inference,
    (rungs, best): (&[Standing], &Fitted),
) -> Vec<Candidate> {
    let place = |effect: &Inferred| {
        let id = effect.effect.card().id;
        inference.named.iter().position(|named| *named == id)
    };
    let missing = inference.effects.iter().filter(|effect| !effect.given);
    let mut order: Vec<&Inferred> = missing.collect();
    order.sort_by(|a, b| {
        let named = |effect: &Inferred| place(effect).unwrap_or(usize::MAX);
        named(a)
            .cmp(&named(b))
            .then(b.probability.total_cmp(&a.probability))
            .then(b.log_odds.total_cmp(&a.log_odds))
    });
    let ends_s = evidence.training.sample_time_s.last();
    let run_s = ends_s.map_or(0.0, |last_s| last_s - evidence.training.begin_s());
    let base = &rungs[0];
    let is_explained = rungs.last().is_some_and(|last| floor.is_reached(last.score.nrms));
    let has_no_scale = has_no_scale(&best.parameters, &evidence.training);
    let explainable = base.score.nrms.powi(2) - floor.expected().powi(2);
    let candidate = |(rank, inferred): (usize, &Inferred)| {
        let id = inferred.effect.card().id;
        let veto = inference.veto_of(id);
        let status = Status::of(inferred.probability, inferred.excited);
        let why_open = inference.why_open();
        // Detectability comes from the same linear solution as the bounds.
        let is_open = match status {
            Status::RuledOut => true,
            Status::NotExcited => inferred.why_not.is_none(),
            Status::Supported | Status::Possible => false,
        };
        let searched = searched(inferred.effect, &evidence.training);
        // The error that is left may be that of a shape which was not tried.
        let is_shape_open = status == Status::RuledOut && !is_explained && !searched.is_empty();
        let open = (why_open.filter(|_| is_open))
            .or_else(|| is_shape_open.then_some(WhyOpen::OtherShapes));
        // A vetoed effect is not supported, whatever its probability.
        let status = match veto {
            _ if open.is_some() => Status::NotExcited,
            Some(_) if !inferred.excited => Status::NotExcited,
            Some(_) if status == Status::Supported => Status::Possible,
            _ => status,
        };
        let rung = place(inferred).map(|place| [&rungs[place], &rungs[place + 1]]);
        let onsets = inference.onsets(id);
        // An event of the hold-out alone has no parameters from the fit run.
        let elsewhere = onsets.first().filter(|onset| onset.run == RunOf::Holdout);
        let parameters = match (rung, elsewhere) {
            (None, _) => Vec::new(),
            (_, Some(onset)) => of_holdout(inferred.effect, onset),
            (_, None) => parameters_of(id, &best.parameters),
        };
        let [before, after] = [0, 1].map(|k: usize| rung.map(|rung| rung[k]));
        let explained_percent = rung.map(|[before, after]| {
            let fall = before.score.nrms.powi(2) - after.score.nrms.powi(2);
            if explainable > 0.0 { 100.0 * fall / explainable } else { 0.0 }
        });
        let size = &inferred.effect.parameters()[inferred.effect.size_index()];
        let is_sized = !(has_no_scale && is_tied(size.unit));
        let [bound, least] =
            [inferred.upper_bound, inferred.detectable].map(|size| size.filter(|_| is_sized));
        let mut candidate = Candidate {
            effect: id,
            rank: rank + 1,
            status,
            probability: inferred.probability,
            parameters,
            onsets: rung.map_or_else(Vec::new, |_| onsets),
            interval_factor: best.interval_factor,
            reached: rung.and_then(|_| reached::of_fit(best, inferred.effect, &evidence.training)),
            error_before: before.unwrap_or(base).fit.nrms,
            error_after: after.map(|after| after.fit.nrms),
            holdout_before: before.unwrap_or(base).score.nrms,
            holdout_after: after.map(|after| after.score.nrms),
            explained_percent,
            as_good_as: None,
            // A named effect has an interval instead.
            upper_bound: bound.filter(|_| rung.is_none() && why_open.is_none()),
            searched,
            detectable: least.filter(|_| why_open.is_none()),
            finding: match (open, inferred.why_not) {
                (Some(why), _) => CandidateFinding::LeftOpen(why),
                (None, Some(why)) => CandidateFinding::NotJudged { why },
                _ if status == Status::NotExcited => CandidateFinding::NotShown,
                _ if rung.is_some() => CandidateFinding::Named {
                    floor: evidence.noise.source,
                    holdout_from: evidence.holdout_from,
                },
                _ if status == Status::RuledOut => CandidateFinding::RuledOut,
                _ => CandidateFinding::MayBeThere { upper_bound: bound },
            },
            not_named: veto,
            is_open: open.is_some(),
            run_s,
        };
        let mut pairs = inference.confusable.iter();
        if let Some([named, _]) = pairs.find(|pair| pair[1] == id) {
            candidate.is_as_good_as(named);
        }
        candidate
    };
    order.into_iter().enumerate().map(candidate).collect()
}

/// The shapes of an effect that a search tries in a run.
fn searched(effect: &dyn Effect, run: &Scenario) -> Vec<(&'static ParameterSpec, [f64; 2])> {
    let shapes = effect.parameters().iter().filter(|spec| spec.role == ParameterRole::Shape);
    let range = |spec: &'static ParameterSpec| {
        let mut grid = spec.in_run(&run.scales).shapes();
        let from = grid.next()?;
        Some((spec, [from, grid.next_back().unwrap_or(from)]))
    };
    shapes.filter_map(range).collect()
}

fn searched_by_key<S: Serializer>(
    searched: &[(&'static ParameterSpec, [f64; 2])],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(searched.iter().map(|(spec, range)| (spec.key, range)))
}

/// Parameters of an event that occurred in the hold-out only.
fn of_holdout(effect: &dyn Effect, onset: &Onset) -> Vec<ParameterEstimate> {
    let id = effect.card().id;
    let [low, high] = onset.interval_95_s;
    let specs = effect.parameters().iter().enumerate();
    specs
        .map(|(parameter, spec)| {
            let (value, std) = if spec.is_coefficient() {
                (onset.size, onset.size_std)
            } else {
                (onset.time_s, (high - low) / (2.0 * TWO_SIDED_95))
            };
            let slot = Slot::Effect { index: 0, parameter, spec, id };
            let mut found = judge(&slot, value, Some(std), f64::NAN);
            let reason = found.reason.map(|reason| format!("; {reason}"));
            let reason = reason.unwrap_or_default();
            found.code = Some(Reason::HoldoutOnly);
            found.reason = Some(format!("it happened in the hold-out only{reason}"));
            found
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn status_follows_probability_and_excitation() {
        for (probability, excited, word) in [
            (0.95, true, Status::Supported),
            (0.95, false, Status::Supported),
            (0.6, true, Status::Possible),
            (0.6, false, Status::Possible),
            (0.3, true, Status::Possible),
            (0.3, false, Status::NotExcited),
            (0.05, true, Status::RuledOut),
            (0.05, false, Status::NotExcited),
            (f64::NAN, true, Status::NotExcited),
        ] {
            assert_eq!(Status::of(probability, excited), word, "{probability}");
        }
    }
}

//! A set that the linear solution wants, held against refits: what they refute is barred, and where a simpler effect serves as
//! well it stands for a richer one or for two.

use rayon::prelude::*;

use super::columns::{Around, Candidate, Linear};
use super::events::Hypothesis;
use super::prediction_error::{Refit, fit};
use super::search::{placed, present, with_effect};
use super::select::{Posterior, Reduced, Set};
use crate::diagnosis::family::LEAST_BOUNDARY_A;
use crate::plant::{ActiveEffect, Model, effect, typical_size};

/// Log of the odds beforehand of an effect that a refit has refuted.
const BARRED: f64 = -30.0;
/// Growth of the log likelihood that a richer effect, or a second one, must bring to stand for one that serves as well.
const WORTH_A_SECOND: f64 = 5.7;

/// An effect that the linear solution asked for and a refit refuted.
pub(super) struct Barred {
    pub(super) id: &'static str,
    /// What the refit leaves of its probability.
    probability: f64,
}

/// Keeps effects that were barred out of the sets, and pairs for which `one` was found to stand as well.
pub(super) fn bar(linear: &mut Linear, barred: &[Barred], one: Option<&'static str>) {
    let stands_for = ONE_FOR_TWO
        .iter()
        .filter(|(simple, _)| Some(*simple) == one);
    for pair in stands_for.map(|(_, pair)| *pair) {
        let places = pair.map(|id| linear.candidates.iter().position(|own| own.id == id));
        if let [Some(a), Some(b)] = places {
            linear.candidates[a].excludes.push(b);
            linear.candidates[b].excludes.push(a);
        }
    }
    for candidate in &mut linear.candidates {
        if barred.iter().any(|barred| barred.id == candidate.id) {
            candidate.log_odds = BARRED;
        }
    }
}

/// Gives effects that were barred what the refit left of their probability.
pub(super) fn keep_doubts(barred: &[Barred], linear: &Linear, posterior: &mut Posterior) {
    for (candidate, p) in linear.candidates.iter().zip(&mut posterior.probability) {
        let found = barred.iter().find(|barred| barred.id == candidate.id);
        *p = found.map_or(*p, |barred| barred.probability.max(*p));
    }
}

/// Effects that are two others together to first order: a command that comes late and both signals that are read late, a
/// current that is read wrongly and what that does to both equations.
const ONE_FOR_TWO: &[(&str, [&str; 2])] = &[
    ("command_delay", ["speed_delay", "current_filter"]),
    ("command_delay", ["speed_filter", "current_filter"]),
    ("current_offset", ["constant_load", "voltage_offset"]),
];

/// A drop of brushes, and that of gaps in the current: each fits what the other does to some degree.
const SIMPLE_FOR_RICH: (&str, &str) = ("voltage_drop", "discontinuous_conduction");

/// Whether a model's gaps of the current were fitted down to the least boundary that a converter's have: what would end below
/// is a drop of brushes, however softly it builds up.
fn has_drop_of_brushes(model: &Model) -> bool {
    let mut gaps = model.effects.iter();
    let gaps = gaps.find(|active| active.id() == SIMPLE_FOR_RICH.1);
    gaps.is_some_and(|gaps| {
        let boundary = gaps.effect.parameters().iter();
        let boundary = boundary.zip(gaps.values_or_guess());
        let mut boundary = boundary.filter(|(spec, _)| spec.key == "boundary_a");
        boundary.any(|(_, value_a)| value_a < AT_THE_LIMIT * LEAST_BOUNDARY_A)
    })
}

/// How many times the least value of a shape one that was fitted down to it may be.
const AT_THE_LIMIT: f64 = 1.02;

/// Sets as the linear solution weighs them.
pub(super) struct Weighed<'a> {
    pub(super) hypothesis: &'a Hypothesis,
    pub(super) linear: &'a Linear,
    pub(super) reduced: &'a Reduced<'a>,
    pub(super) posterior: &'a Posterior,
    pub(super) runs: &'a [Around<'a>],
}

impl Weighed<'_> {
    /// The effect of the best set, none of `given`, that a refit refutes most clearly, and the model without it. A linear
    /// solution is wrong where an effect's own size bends what it does, as that of a large delay.
    pub(super) fn doubtful(&self, given: &[&'static str]) -> Option<(Barred, Hypothesis)> {
        let best = &self.posterior.best;
        let likelihood = |set: &Set| self.reduced.log_likelihood(&self.reduced.columns(set));
        let whole = likelihood(best);
        let asked = |(k, candidate): &(usize, &Candidate)| {
            let named = best[*k].is_some() && !candidate.is_unknown();
            named && !given.contains(&candidate.id)
        };
        let candidates = self.linear.candidates.iter().enumerate();
        let asked: Vec<(usize, &Candidate)> = candidates.filter(asked).collect();
        if asked.is_empty() {
            return None;
        }
        // What is left where it goes, or its deviance where it joins.
        let refitted = |(k, candidate): &(usize, &Candidate)| {
            if candidate.in_model {
                return fit(&self.hypothesis.without(candidate.id), self.runs).map(Some);
            }
            let mut with = present(self.linear);
            with[*k] = best[*k];
            let (linear, reduced) = (self.linear, self.reduced);
            let start = placed(self.hypothesis, linear, reduced, &with, self.runs)?;
            Some(fit(&start, self.runs))
        };
        let (base, refitted) = rayon::join(
            || fit(self.hypothesis, self.runs),
            || {
                let each = asked.par_iter().with_max_len(1).map(refitted);
                each.collect::<Option<Vec<Option<Refit>>>>()
            },
        );
        let base = base?;
        let judged = asked.iter().zip(refitted?).map(|((k, candidate), refit)| {
            let mut without = best.clone();
            without[*k] = None;
            let promised = whole - likelihood(&without);
            let change = refit.as_ref();
            let change = change.map_or(0.0, |refit| 0.5 * (refit.deviance - base.deviance));
            let gained = if candidate.in_model { change } else { -change };
            let left = refit.filter(|_| candidate.in_model);
            let left = left.map_or_else(|| self.hypothesis.clone(), |left| left.hypothesis);
            let odds = self.posterior.log_factor[*k] - (promised - gained).max(0.0);
            (odds, candidate.id, left)
        });
        let refuted = judged.filter(|own| own.0 < 0.0);
        let worst = refuted.min_by(|a, b| a.0.total_cmp(&b.0));
        let (odds, id, left) = worst?;
        let probability = 1.0 / (1.0 + (-odds).exp());
        Some((Barred { id, probability }, left))
    }

    /// A simple effect, and the model with it in the place of a richer one, or of two that it is alike to, where those are not
    /// clearly better.
    pub(super) fn simpler(&self, given: &[&'static str]) -> Option<(&'static str, Hypothesis)> {
        let there = &self.hypothesis.model;
        let pairs = ONE_FOR_TWO.iter().map(|(one, two)| (*one, two.to_vec()));
        let mut pairs = pairs.chain([(SIMPLE_FOR_RICH.0, vec![SIMPLE_FOR_RICH.1])]);
        pairs.find_map(|(simple, others)| {
            let open = |id: &&str| there.has(id) && !given.contains(id);
            if there.has(simple) || !others.iter().all(open) {
                return None;
            }
            let effect = effect::find(simple)?;
            let unit = effect.parameters()[0].unit;
            let size = |active: &ActiveEffect| {
                let is_one = others.contains(&active.id());
                let alike = is_one && active.effect.parameters()[0].unit == unit;
                alike.then(|| active.values_or_guess()[0])
            };
            let sizes: Vec<f64> = there.effects.iter().filter_map(size).collect();
            let begin = if sizes.is_empty() {
                typical_size(effect, 0, there, self.runs[0].scenario)
            } else {
                sizes.iter().sum::<f64>() / sizes.len() as f64
            };
            let mut start = self.hypothesis.clone();
            let kept = |active: &ActiveEffect| !others.contains(&active.id());
            start.model.effects.retain(kept);
            start.model = with_effect(&start.model, effect, &[begin]);
            // What is not known goes with the size that it was followed with: the second time that is its own.
            let left = fit(&fit(&start, self.runs)?.hypothesis, self.runs)?;
            if simple == SIMPLE_FOR_RICH.0 && has_drop_of_brushes(there) {
                return Some((simple, left.hypothesis));
            }
            let rich = fit(self.hypothesis, self.runs)?;
            (0.5 * (left.deviance - rich.deviance) < WORTH_A_SECOND)
                .then_some((simple, left.hypothesis))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::tests::truth;

    #[test]
    fn gaps_that_end_where_no_converters_do_are_a_drop_of_brushes() {
        let gaps = |boundary_a: f64| truth("discontinuous_conduction", &[1.4, boundary_a]);
        assert!(has_drop_of_brushes(&gaps(LEAST_BOUNDARY_A)));
        assert!(!has_drop_of_brushes(&gaps(1.5 * LEAST_BOUNDARY_A)));
        assert!(!has_drop_of_brushes(&truth("voltage_drop", &[0.9])));
    }
}

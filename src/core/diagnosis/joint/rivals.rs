//! Effects that runs do not tell apart: which they are, and how they share what is known of one of them.

use super::marginal::{Inferred, NAMED_PROBABILITY};
use super::search::SearchResult;
use super::select::Set;
use super::shown::without;

/// Loss of log likelihood up to which an effect serves in the place of another: two standard deviations and a half.
const SERVES_AS_WELL_NATS: f64 = 3.0;

/// Two effects of which these runs want one and cannot say which.
pub(super) struct Rival {
    pub(super) pair: [&'static str; 2],
    /// Loss of log likelihood with the second in the place of the first.
    loss_nats: f64,
    /// Whether both happen once.
    are_events: bool,
}

/// Pairs of which these runs want one and cannot say which: an effect of the best set, and one that serves nearly as well in
/// its place when everything else moves along. How wide each was believed to be beforehand has no say in it.
pub(super) fn confusable(found: &SearchResult) -> Vec<Rival> {
    let reduced = &found.reduced;
    let candidates = &reduced.linear.candidates;
    let best = &found.posterior.best;
    let likelihood = |set: &Set| reduced.log_likelihood(&reduced.columns(set));
    let mut rivals: Vec<Rival> = Vec::new();
    for (j, present) in candidates.iter().enumerate() {
        let Some(own) = best[j].filter(|_| !present.is_unknown()) else {
            continue;
        };
        // What another form of its onset explains it would of the rival's: it is left out of both.
        let mut columns = reduced.columns(best);
        if present.is_event() {
            let bends = present.variants[own].columns.iter();
            let bends = bends.filter(|column| column.parameter.is_none());
            let bends: Vec<usize> = bends.map(|column| column.at).collect();
            columns.retain(|column| !bends.contains(&(column + reduced.linear.nuisances.len())));
        }
        let most = reduced.log_likelihood(&columns);
        for (k, rival) in candidates.iter().enumerate() {
            let pair = [present.id, rival.id];
            let is_open = best[k].is_none() && !rival.is_unknown() && !rival.is_whole();
            if !is_open || present.id == rival.id || rivals.iter().any(|own| own.pair == pair) {
                continue;
            }
            let with = |form| {
                let mut set = reduced.cleared(&without(best, j), k);
                set[k] = Some(form);
                set
            };
            let forms = (0..rival.variants.len()).map(with);
            let forms = forms.filter(|set| reduced.signs_are_right(set));
            let loss_nats = most
                - forms
                    .map(|set| likelihood(&set))
                    .fold(f64::NEG_INFINITY, f64::max);
            if loss_nats < SERVES_AS_WELL_NATS {
                rivals.push(Rival {
                    pair,
                    loss_nats,
                    are_events: present.is_event() && rival.is_event(),
                });
            }
        }
    }
    rivals
}

/// Shares the probability of what happened once with what explains the same at the same moment, by their likelihoods: the one
/// in the best set was fitted to its moment, and the posterior weighs the other at the moments of a grid.
pub(super) fn share_among_events(effects: &mut [Inferred], rivals: &[Rival]) {
    for rival in rivals.iter().filter(|rival| rival.are_events) {
        let place = |id| effects.iter().position(|own| own.id() == id);
        let [Some(first), Some(second)] = rival.pair.map(place) else {
            continue;
        };
        let together = (effects[first].probability + effects[second].probability).min(1.0);
        let share = 1.0 / (1.0 + rival.loss_nats.max(0.0).exp());
        let of_second = (share * together).max(effects[second].probability);
        effects[second].probability = of_second;
        effects[first].probability = together - of_second;
    }
}

/// Halves the probability of an effect that was fitted down to its limit between it and the `simpler` one that it is there,
/// unless it was given, as with gaps of the current and a drop of brushes that is too soft for its own form: nothing in these
/// runs tells the two apart. What the simpler one's own form says of its size, beside the other or in its place, is no bound
/// then.
pub(super) fn share_at_limit(
    [simpler, limited]: [&'static str; 2],
    effects: &mut [Inferred],
    confusable: &mut Vec<[&'static str; 2]>,
) {
    let place = |id| effects.iter().position(|own| own.id() == id);
    let (Some(simpler_at), Some(limited_at)) = (place(simpler), place(limited)) else {
        return;
    };
    if effects[limited_at].given {
        return;
    }
    let half = 0.5 * effects[limited_at].probability;
    effects[limited_at].probability = half;
    let soft = &mut effects[simpler_at];
    soft.probability = half.max(soft.probability.min(NAMED_PROBABILITY));
    (soft.upper_bound, soft.detectable) = (None, None);
    if !confusable.contains(&[limited, simpler]) {
        confusable.push([limited, simpler]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::marginal::TOGETHER_PROBABILITY;
    use super::*;
    use crate::plant::effect;

    fn inferred_as(id: &str, probability: f64) -> Inferred {
        Inferred {
            effect: effect::find(id).unwrap(),
            given: false,
            probability,
            excited: true,
            why_not: None,
            upper_bound: Some(0.18),
            detectable: Some(0.05),
            log_odds: 0.0,
        }
    }

    #[test]
    fn gaps_that_end_early_and_a_soft_drop_are_one_of_two_unless_the_gaps_were_given() {
        for given in [false, true] {
            let mut effects = [
                inferred_as("discontinuous_conduction", 1.0),
                inferred_as("voltage_drop", 0.0),
            ];
            effects[0].given = given;
            let mut pairs = vec![];
            let pair = [effects[1].id(), effects[0].id()];
            share_at_limit(pair, &mut effects, &mut pairs);
            let [gaps, drop] = &effects;
            if given {
                assert!(
                    pairs.is_empty()
                        && gaps.probability > NAMED_PROBABILITY
                        && drop.upper_bound.is_some()
                );
                continue;
            }
            assert_eq!(pairs, [["discontinuous_conduction", "voltage_drop"]]);
            // A model holds one of them: neither is named for itself, together they are certain.
            assert!(gaps.probability <= NAMED_PROBABILITY && drop.probability <= NAMED_PROBABILITY);
            assert!(gaps.probability + drop.probability > TOGETHER_PROBABILITY);
            assert!(drop.upper_bound.is_none() && drop.detectable.is_none());
        }
    }

    #[test]
    fn what_happened_once_shares_with_what_explains_the_same() {
        let shared = |loss_nats, are_events| {
            let mut effects = [
                inferred_as("load_step", 1.0),
                inferred_as("one_sided_load", 0.0),
            ];
            let pair = ["load_step", "one_sided_load"];
            let rival = Rival {
                pair,
                loss_nats,
                are_events,
            };
            share_among_events(&mut effects, &[rival]);
            effects.map(|own| own.probability)
        };
        let are = |found: [f64; 2], expected: [f64; 2]| {
            let mut pairs = found.into_iter().zip(expected);
            pairs.all(|(found, expected)| (found - expected).abs() < 1e-12)
        };
        assert!(are(shared(0.0, true), [0.5, 0.5]));
        // What explains more than the one that was fitted has no more than half.
        assert!(are(shared(-1.0, true), [0.5, 0.5]));
        let [first, second] = shared(2.0, true);
        assert!((second - 0.119).abs() < 1e-3 && (first + second - 1.0).abs() < 1e-12);
        assert!(are(shared(0.0, false), [1.0, 0.0]));
    }
}

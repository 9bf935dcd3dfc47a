//! Effects that runs do not tell apart: which they are, and how they share what is known of one of them.

use super::detectability::without;
use super::marginal::{Inferred, NAMED_PROBABILITY};
use super::search::SearchResult;
use super::select::Set;

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

/// Shares the probability of what happened once among all that explains the same at the same moment, once and by their
/// likelihoods: the one in the best set was fitted to its moment, and the posterior weighs the others at the moments of a grid.
pub(super) fn share_among_events(effects: &mut [Inferred], rivals: &[Rival]) {
    let mut left: Vec<&Rival> = rivals.iter().filter(|rival| rival.are_events).collect();
    while let Some([fitted, _]) = left.first().map(|rival| rival.pair) {
        let (own, others) = left.into_iter().partition(|rival| rival.pair[0] == fitted);
        left = others;
        share_of_one(effects, fitted, own);
    }
}

/// Shares the probability of the event `fitted` and of `rivals` by the weights `exp(-loss)`, one and no more for the fitted.
/// Whose share is less than it has keeps what it has, and the others share the rest.
fn share_of_one(effects: &mut [Inferred], fitted: &str, rivals: Vec<&Rival>) {
    let place = |id: &str| effects.iter().position(|own| own.id() == id);
    let Some(first) = place(fitted) else {
        return;
    };
    let of_rival = |rival: &Rival| Some((place(rival.pair[1])?, rival.loss_nats.max(0.0)));
    let mut open: Vec<(usize, f64)> = rivals.into_iter().filter_map(of_rival).collect();
    let others = open.iter().map(|(k, _)| effects[*k].probability);
    let mut together = (effects[first].probability + others.sum::<f64>()).min(1.0);
    let shares = loop {
        let losses = || open.iter().map(|(_, loss)| *loss).chain([0.0]);
        let weights = |own: f64| losses().map(move |loss| (own - loss).exp());
        let share = |own: f64| weights(own).sum::<f64>().recip() * together;
        let shares: Vec<f64> = open.iter().map(|(_, loss)| share(*loss)).collect();
        let keeps = |((k, _), share): (&(usize, f64), &f64)| effects[*k].probability > *share;
        let Some(kept) = open.iter().zip(&shares).position(keeps) else {
            break shares;
        };
        let (k, _) = open.swap_remove(kept);
        together -= effects[k].probability;
    };
    effects[first].probability = (together - shares.iter().sum::<f64>()).max(0.0);
    for ((k, _), share) in open.into_iter().zip(shares) {
        effects[k].probability = share;
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
    use drivebench_model::plant::effect;

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

    #[test]
    fn rivals_of_one_event_share_once_in_any_order() {
        let ids = [
            "load_step",
            "one_sided_load",
            "friction_onset",
            "inertia_change",
        ];
        let shared = |before: [f64; 4], losses: [f64; 3], order: [usize; 3]| {
            let mut effects = [0, 1, 2, 3].map(|k| inferred_as(ids[k], before[k]));
            let rivals = order.map(|k| Rival {
                pair: [ids[0], ids[k]],
                loss_nats: losses[k - 1],
                are_events: true,
            });
            share_among_events(&mut effects, &rivals);
            effects.map(|own| own.probability)
        };
        let orders = [
            [1, 2, 3],
            [1, 3, 2],
            [2, 1, 3],
            [2, 3, 1],
            [3, 1, 2],
            [3, 2, 1],
        ];
        let half = 0.5_f64.ln();
        for (before, losses, after) in [
            ([1.0, 0.0, 0.0, 0.0], [0.0; 3], [0.25; 4]),
            (
                [0.8, 0.0, 0.0, 0.0],
                [0.0, 0.0, -half],
                [8.0 / 35.0, 8.0 / 35.0, 8.0 / 35.0, 4.0 / 35.0],
            ),
            // What has more than its share keeps it, and no more than all that there is is shared.
            ([0.3, 0.6, 0.0, 0.0], [0.0; 3], [0.1, 0.6, 0.1, 0.1]),
            (
                [0.9, 0.1, 0.0, 0.0],
                [0.0, 50.0, 50.0],
                [0.5, 0.5, 0.0, 0.0],
            ),
        ] {
            for order in orders {
                let found = shared(before, losses, order);
                let mut pairs = found.into_iter().zip(after);
                assert!(
                    pairs.all(|(found, after)| (found - after).abs() < 1e-12),
                    "{before:?} {losses:?} {order:?}: {found:?}"
                );
            }
        }
    }
}

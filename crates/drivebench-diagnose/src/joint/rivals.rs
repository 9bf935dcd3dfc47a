//! Confounded effects: pairs whose log likelihoods differ too little to distinguish them, and how they share the probability.

use super::marginal::{Inferred, NAMED_PROBABILITY};
use super::search::SearchResult;
use super::select::{Set, without};
use drivebench_model::plant::effect::TermKind;

/// Two effects of which the runs support one without distinguishing which.
pub(super) struct Rival {
    pub(super) pair: [&'static str; 2],
    /// Loss of log likelihood if the second replaces the first.
    loss_nats: f64,
    /// Whether both are events.
    are_events: bool,
}

/// Pairs of an effect of the best set and one that fits nearly as well in its place, all other parameters estimated anew, without
/// the priors of their sizes.
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
        // Perturbations of the form of its onset would serve the rival too: leave them out of both.
        let mut columns = reduced.columns(best);
        if present.is_event() {
            let bends: Vec<usize> = present.variants[own]
                .columns
                .iter()
                .filter(|column| column.parameter.is_none())
                .map(|column| column.at)
                .collect();
            columns.retain(|column| !bends.contains(&(column + reduced.linear.nuisances.len())));
        }
        let most = reduced.log_likelihood(&columns);
        for (k, rival) in candidates.iter().enumerate() {
            let pair = [present.id, rival.id];
            let is_open = best[k].is_none() && !rival.is_unknown() && !rival.has_fixed_size();
            if !is_open || present.id == rival.id || rivals.iter().any(|own| own.pair == pair) {
                continue;
            }
            let forms = (0..rival.variants.len())
                .map(|form| reduced.with(&without(best, j), k, form))
                .filter(|set| reduced.signs_are_right(set));
            let logs = forms.map(|set| likelihood(&set));
            let loss_nats = most - logs.fold(f64::NEG_INFINITY, f64::max);
            // 3 nats: 2.45 standard deviations.
            if loss_nats < 3.0 {
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

/// Shares the probability of an event among the events that explain the same at the same time, by their likelihoods: the one in the
/// best set has its fitted time, but the posterior of the others is at times of a grid and too small.
pub(super) fn share_among_events(effects: &mut [Inferred], rivals: &[Rival]) {
    let mut left: Vec<&Rival> = rivals.iter().filter(|rival| rival.are_events).collect();
    while let Some([fitted, _]) = left.first().map(|rival| rival.pair) {
        let (own, others) = left.into_iter().partition(|rival| rival.pair[0] == fitted);
        left = others;
        share_of_one(effects, fitted, own);
    }
}

/// Shares the total probability of the event `fitted` and of its `rivals` by the weights `exp(-loss)`, at most 1 for the rivals and
/// 1 for the fitted. A rival whose probability exceeds its share keeps it, and the others share the rest.
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

/// Halves the probability of an effect at its limit between it and the `simpler` one that it equals there, unless it was given:
/// the runs do not distinguish them, for example discontinuous conduction and a soft voltage drop. The bound of the simpler effect
/// was computed for its own form and does not hold.
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

/// Without a current a voltage offset and a constant load are the same drive, and a late command and a late speed the same delay: the
/// probable one of each pair stands for both.
pub(super) fn share_without_current(
    effects: &mut [Inferred],
    confusable: &mut Vec<[&'static str; 2]>,
) {
    for pair in [
        [TermKind::VoltageOffset, TermKind::TorqueOffset],
        [TermKind::LateCommand, TermKind::LateSpeed],
    ] {
        let alike = pair.map(TermKind::id);
        let of = |id: &str| effects.iter().find(|own| own.id() == id);
        let probable = |id: &&str| of(id).is_some_and(|own| own.probability > NAMED_PROBABILITY);
        if let Some(named) = alike.into_iter().find(probable) {
            let other = alike[usize::from(named == alike[0])];
            share_at_limit([other, named], effects, confusable);
        }
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
    fn without_a_current_an_offset_and_a_load_are_one_of_two_as_two_delays_are() {
        for pair in [["voltage_offset", "constant_load"], ["speed_delay", "command_delay"]] {
            for (probabilities, expected) in [([1.0, 0.03], true), ([0.2, 0.1], false)] {
                let mut effects = [0, 1].map(|k| inferred_as(pair[k], probabilities[k]));
                let mut pairs = vec![];
                share_without_current(&mut effects, &mut pairs);
                assert_eq!(pairs == [pair], expected);
                assert_eq!(effects[0].probability < probabilities[0], expected);
                assert_eq!(effects[1].upper_bound.is_none(), expected);
            }
        }
    }

    #[test]
    fn gaps_at_their_limit_and_a_soft_drop_are_one_of_two() {
        let ids = ["discontinuous_conduction", "voltage_drop"];
        for given in [false, true] {
            let mut effects = [inferred_as(ids[0], 1.0), inferred_as(ids[1], 0.0)];
            effects[0].given = given;
            let mut pairs = vec![];
            share_at_limit([ids[1], ids[0]], &mut effects, &mut pairs);
            let [gaps, drop] = &effects;
            if given {
                assert!(pairs.is_empty() && gaps.probability > NAMED_PROBABILITY);
                assert!(drop.upper_bound.is_some());
                continue;
            }
            assert_eq!(pairs, [ids]);
            // A model holds one of them: neither is named for itself, together they are certain.
            assert!(gaps.probability <= NAMED_PROBABILITY && drop.probability <= NAMED_PROBABILITY);
            assert!(gaps.probability + drop.probability > TOGETHER_PROBABILITY);
            assert!(drop.upper_bound.is_none() && drop.detectable.is_none());
        }
    }

    #[test]
    fn rivals_of_one_event_share_once_in_any_order() {
        let [a, b] = ["load_step", "one_sided_load"];
        let ids = [a, b, "friction_onset", "inertia_change"];
        let shared = |before: [f64; 4], losses: &[f64], order: [usize; 3], are_events| {
            let mut effects = [0, 1, 2, 3].map(|k| inferred_as(ids[k], before[k]));
            let order = order.into_iter().filter(|k| *k <= losses.len());
            let rivals = order.map(|k| Rival {
                pair: [ids[0], ids[k]],
                loss_nats: losses[k - 1],
                are_events,
            });
            share_among_events(&mut effects, &rivals.collect::<Vec<_>>());
            effects.map(|own| own.probability)
        };
        let (first, halves) = ([1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0]);
        let half = 0.5_f64.ln();
        let eighth = [8.0 / 35.0, 8.0 / 35.0, 8.0 / 35.0, 4.0 / 35.0];
        let of_two = 1.0 / (1.0 + f64::exp(-2.0));
        let cases: [([f64; 4], &[f64], [f64; 4]); 7] = [
            (first, &[0.0], halves),
            // What explains more than the one that was fitted has no more than half.
            (first, &[-1.0], halves),
            (first, &[2.0], [of_two, 1.0 - of_two, 0.0, 0.0]),
            (first, &[0.0; 3], [0.25; 4]),
            ([0.8, 0.0, 0.0, 0.0], &[0.0, 0.0, -half], eighth),
            // What has more than its share keeps it, and no more than all that there is is shared.
            ([0.3, 0.6, 0.0, 0.0], &[0.0; 3], [0.1, 0.6, 0.1, 0.1]),
            ([0.9, 0.1, 0.0, 0.0], &[0.0, 50.0, 50.0], halves),
        ];
        for (before, losses, after) in cases {
            for order in [123, 132, 213, 231, 312, 321_usize] {
                let places = [order / 100, order / 10 % 10, order % 10];
                for (are_events, after) in [(true, after), (false, before)] {
                    let found = shared(before, losses, places, are_events);
                    let is_close = |k: usize| (found[k] - after[k]).abs() < 1e-12;
                    let case = format!("{before:?} {losses:?} {order}");
                    assert!((0..4).all(is_close), "{case}: {found:?}");
                }
            }
        }
    }
}

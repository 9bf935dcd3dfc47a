//! Marginal posterior of one effect: its inclusion probability, and what bounds its size where it is not named.

use super::detectability::{
    BOUND_SIGMAS, UNDETECTABLE_SLABS, detectable, moments, shortest_detectable, size_in,
    spread_slabs, whenever,
};
use super::search::SearchResult;
use drivebench_model::plant::Effect;

/// Probability from which on an effect is named.
pub(super) const NAMED_PROBABILITY: f64 = 0.5;
/// The same for two together that cannot be told apart.
pub(super) const TOGETHER_PROBABILITY: f64 = 0.9;

/// One effect.
#[derive(Clone)]
pub(crate) struct Inferred {
    pub(crate) effect: &'static dyn Effect,
    /// Whether the model had it before.
    pub(crate) given: bool,
    /// That it is there, beside all others that may be.
    pub(crate) probability: f64,
    /// Whether these runs would show it at its slab, and why it is not eligible.
    pub(crate) excited: bool,
    pub(crate) why_not: Option<&'static str>,
    /// Its size is below this with 95 %, in the unit of its first parameter; an amplitude where it has sine and cosine.
    pub(crate) upper_bound: Option<f64>,
    /// A size that would have been named in 95 of 100 such records.
    pub(crate) detectable: Option<f64>,
    /// Log of the odds given the rest of the best set.
    pub(crate) log_odds: f64,
}

impl Inferred {
    pub(super) fn id(&self) -> &'static str {
        self.effect.card().id
    }

    /// Of an eligible effect by what a search found.
    pub(super) fn of(effect: &'static dyn Effect, found: &SearchResult) -> Self {
        let (reduced, posterior) = (&found.reduced, &found.posterior);
        let mut out = Self {
            effect,
            given: false,
            probability: 0.0,
            excited: false,
            why_not: None,
            upper_bound: None,
            detectable: None,
            log_odds: f64::NEG_INFINITY,
        };
        let mut absent = 1.0;
        let id = effect.card().id;
        let candidates = reduced.linear.candidates.iter().enumerate();
        for (k, candidate) in candidates.filter(|(_, own)| own.id == id) {
            absent *= 1.0 - posterior.probability[k];
            out.log_odds = out.log_odds.max(posterior.log_factor[k]);
            let form = posterior.forms[k];
            let variant = &candidate.variants[form];
            let best = &posterior.best;
            let spread = spread_slabs(reduced, best, found.excess, [k, form]);
            let excited = spread.is_some_and(|spread| spread < UNDETECTABLE_SLABS);
            out.excited |= excited;
            if variant.mean > 0.0 || !excited {
                if excited {
                    out.detectable = shortest_detectable(reduced, best, k);
                }
                continue;
            }
            let mut bound: f64 = 0.0;
            // The likeliest dozen of sets.
            for (set, _) in posterior.sets.iter().take(12) {
                if let Some((size, sd)) = size_in(reduced, &reduced.with(set, k, form), k) {
                    bound = bound.max(size + BOUND_SIGMAS * sd);
                }
            }
            if candidate.is_event() && !candidate.in_model {
                bound = bound.max(whenever(&moments(reduced, best, found.excess, k)));
            }
            out.upper_bound = larger(out.upper_bound, Some(bound));
            // The size at one moment does not bound an event at all the others.
            if candidate.is_event() {
                continue;
            }
            let with = reduced.with(best, k, form);
            let sd = size_in(reduced, &with, k).map(|(_, sd)| sd);
            let detectable = sd.and_then(|sd| detectable(reduced, &with, k, sd));
            out.detectable = larger(out.detectable, detectable);
        }
        let weighed = (1.0 - absent).clamp(0.0, 1.0);
        out.probability = if found.is_cut {
            half_believed(weighed, effect.card().share_beforehand)
        } else {
            weighed
        };
        out
    }
}

fn larger(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.into_iter().chain(b).reduce(f64::max)
}

/// Probability of an effect by its weight among the sets where no set stood: half of the weight and half of the prior. Of 61
/// effects to which such searches gave a weight of 0.5 or more, on 15 of 730 emulated machines, 30 were there.
const fn half_believed(weighed: f64, beforehand: f64) -> f64 {
    0.5 * (weighed + beforehand)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_that_was_cut_makes_nothing_certain() {
        let [there, absent] = [1.0, 0.0].map(|weighed| half_believed(weighed, 0.1));
        // It still names; neither presence nor absence is certain.
        assert!(there > NAMED_PROBABILITY && there < TOGETHER_PROBABILITY);
        assert!(absent > 0.0 && absent < 0.1);
        assert!((half_believed(0.2, 0.2) - 0.2).abs() < 1e-12);
    }
}

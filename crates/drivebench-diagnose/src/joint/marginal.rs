//! Marginal posterior of one effect: its inclusion probability, and the upper bound of its size.

use super::detectability::{
    BOUND_SIGMAS, UNDETECTABLE_SLABS, detectable, event_bound, event_information,
    posterior_sd_slabs, shortest_detectable, size_in,
};
use super::search::SearchResult;
use drivebench_model::plant::Effect;

/// Inclusion probability above which an effect is named: the median probability model (Barbieri & Berger, Annals of Statistics 32,
/// 2004).
pub(super) const NAMED_PROBABILITY: f64 = 0.5;
/// The same for the sum of two confounded effects.
pub(super) const TOGETHER_PROBABILITY: f64 = 0.9;

/// One effect.
#[derive(Clone)]
pub(crate) struct Inferred {
    pub(crate) effect: &'static dyn Effect,
    /// Whether the baseline model has it.
    pub(crate) given: bool,
    /// Posterior inclusion probability.
    pub(crate) probability: f64,
    /// Whether an effect of the size of its slab would be detected in these runs, and why it is not eligible.
    pub(crate) excited: bool,
    pub(crate) why_not: Option<&'static str>,
    /// Upper 95 % bound of its size in the unit of its first parameter; of the amplitude if it has sine and cosine.
    pub(crate) upper_bound: Option<f64>,
    /// Smallest size that would be named in 95 of 100 such records.
    pub(crate) detectable: Option<f64>,
    /// Log posterior odds, given the other effects of the best set.
    pub(crate) log_odds: f64,
}

impl Inferred {
    pub(super) fn id(&self) -> &'static str {
        self.effect.card().id
    }

    /// The runs do not show it: neither bound nor detectable size.
    pub(super) fn leave_open(&mut self) {
        self.excited = false;
        (self.upper_bound, self.detectable) = (None, None);
    }

    /// Marginal of an eligible effect.
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
            let spread = posterior_sd_slabs(reduced, best, found.excess, [k, form]);
            let excited = spread.is_some_and(|spread| spread < UNDETECTABLE_SLABS);
            out.excited |= excited;
            if variant.mean > 0.0 || !excited {
                if excited {
                    out.detectable = shortest_detectable(reduced, best, k);
                }
                continue;
            }
            let mut bound: f64 = 0.0;
            // The twelve most probable sets.
            for (set, _) in posterior.sets.iter().take(12) {
                if let Some((size, sd)) = size_in(reduced, &reduced.with(set, k, form), k) {
                    bound = bound.max(size + BOUND_SIGMAS * sd);
                }
            }
            if candidate.is_event() && !candidate.in_model {
                bound = bound.max(event_bound(&event_information(reduced, best, found.excess, k)));
            }
            out.upper_bound = larger(out.upper_bound, Some(bound));
            // A size at one event time is no bound for the other times.
            if candidate.is_event() {
                continue;
            }
            let with = reduced.with(best, k, form);
            let sd = size_in(reduced, &with, k).map(|(_, sd)| sd);
            let detectable = sd.and_then(|sd| detectable(reduced, &with, k, sd));
            out.detectable = larger(out.detectable, detectable);
        }
        let posterior = (1.0 - absent).clamp(0.0, 1.0);
        out.probability = if found.is_cut {
            shrunk_to_prior(posterior, effect.card().share_beforehand)
        } else {
            posterior
        };
        out
    }
}

fn larger(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.into_iter().chain(b).reduce(f64::max)
}

/// Probability of an effect if the search ended without a stable set or it is vetoed: the mean of posterior and prior. Of 61 effects
/// with a posterior of 0.5 or more in such searches, on 15 of 730 emulated machines, 30 were true; of 13 vetoed ones of 0.9 or more 6.
pub(super) const fn shrunk_to_prior(posterior: f64, prior: f64) -> f64 {
    0.5 * (posterior + prior)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_that_was_cut_makes_nothing_certain() {
        let [present, absent] = [1.0, 0.0].map(|posterior| shrunk_to_prior(posterior, 0.1));
        // An effect can still be named; neither presence nor absence is certain.
        assert!(present > NAMED_PROBABILITY && present < TOGETHER_PROBABILITY);
        assert!(absent > 0.0 && absent < 0.1);
        assert!((shrunk_to_prior(0.2, 0.2) - 0.2).abs() < 1e-12);
    }
}

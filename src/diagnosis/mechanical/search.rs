//! Greedy search for the set of effects, and the check for what it made superfluous.

use super::regression::BalanceFit;
use super::score::{Score, z};
use super::sides::Sides;
use super::trial::{self, Trial, WORTHWHILE};
use crate::diagnosis::decide::{AS_GOOD, UNTIL_FLOOR};
use crate::plant::{Model, Scenario};

/// Effects that one search adds at most.
const MOST_EFFECTS: usize = 4;
/// Share of the explainable error from which a set is sufficient, and from which it says something.
pub(super) const SUFFICIENT: f64 = 0.9;
pub(super) const EXPLAINS_SOMETHING: f64 = 0.3;
/// Share of the explainable error below which a further effect is not worth its name: on a real machine every free
/// coefficient bends towards what no term describes.
const WORTH_A_NAME: f64 = 0.05;

/// Standard deviations below which a size may as well be zero.
const TOLD_FROM_ZERO: f64 = 2.0;

/// Where the search stands.
pub(super) struct Found {
    pub(super) first_round: Vec<Trial<'static>>,
    /// Candidates of the first round that pay and are not told from the best, the preferred one first.
    pub(super) first_set: Vec<usize>,
    pub(super) accepted: Vec<&'static str>,
    /// Held-out error of each rung with its effects, the baseline first.
    pub(super) rungs: Vec<(Vec<&'static str>, f64)>,
    pub(super) fit: BalanceFit,
    pub(super) score: Score,
    /// Effects of the given model that are not needed any more.
    pub(super) superfluous: Vec<&'static str>,
}

/// Share of the explainable error that is explained, the floor in N.m.
pub(super) fn explained(before: &Score, after: &Score, floor_n_m: f64) -> f64 {
    let explainable = before.rmse.powi(2) - floor_n_m.powi(2);
    if explainable <= 0.0 {
        0.0
    } else {
        (1.0 - (after.rmse.powi(2) - floor_n_m.powi(2)) / explainable).min(1.0)
    }
}

pub(super) fn search(
    baseline: &BalanceFit,
    sides: &Sides,
    scenario: &Scenario,
    floor_n_m: f64,
    until_floor: bool,
) -> Found {
    let base = sides.held_out(baseline, None);
    let mut trials = trial::all(baseline, sides, scenario);
    let mut set = not_told_apart(&base, &trials, sides);
    let first_set = set.clone();
    let mut found = Found {
        first_round: Vec::new(),
        first_set,
        accepted: Vec::new(),
        rungs: vec![(baseline.model.effect_ids(), base.rmse)],
        fit: baseline.clone(),
        score: base.clone(),
        superfluous: Vec::new(),
    };
    while let Some(&chosen) = set.first() {
        if let Ok(judged) = &trials[chosen].found {
            let share = explained(&base, &judged.holdout, floor_n_m)
                - explained(&base, &found.score, floor_n_m);
            if share < WORTH_A_NAME && !found.accepted.is_empty() && !until_floor {
                break;
            }
            found.fit = judged.fit.clone();
            found.score = judged.holdout.clone();
        }
        found.accepted.push(trials[chosen].of.id());
        found
            .rungs
            .push((found.fit.model.effect_ids(), found.score.rmse));
        if found.first_round.is_empty() {
            found.first_round = std::mem::take(&mut trials);
        }
        let enough = if until_floor {
            found.score.rmse < UNTIL_FLOOR * floor_n_m
        } else {
            explained(&base, &found.score, floor_n_m) >= SUFFICIENT
        };
        if enough || found.accepted.len() == MOST_EFFECTS {
            break;
        }
        trials = trial::all(&found.fit, sides, scenario);
        set = not_told_apart(&found.score, &trials, sides);
    }
    if found.first_round.is_empty() {
        found.first_round = trials;
    }
    drop_superfluous(&mut found, sides);
    found.superfluous = superfluous(&found.fit, &found.score, sides, &found.accepted);
    found
}

/// The best candidate that pays and those that cannot be told from it; the one with the fewest parameters first.
fn not_told_apart(base: &Score, trials: &[Trial<'_>], sides: &Sides) -> Vec<usize> {
    let error = |index: usize| {
        let judged = trials[index].found.as_ref();
        judged.map_or(f64::INFINITY, |judged| judged.holdout.rmse)
    };
    let paying: Vec<usize> = (0..trials.len())
        .filter(|&index| trials[index].pays(base, sides))
        .collect();
    let Some(best) = paying
        .iter()
        .copied()
        .min_by(|a, b| error(*a).total_cmp(&error(*b)))
    else {
        return Vec::new();
    };
    let least = error(best).powi(2);
    let gained = base.rmse.powi(2) - least;
    let mut set: Vec<usize> = paying
        .into_iter()
        .filter(|&index| {
            let (Ok(rival), Ok(first)) = (&trials[index].found, &trials[best].found) else {
                return false;
            };
            let close = error(index).powi(2) - least < AS_GOOD * least.max(gained);
            let apart = z(&rival.holdout, &first.holdout, sides.settings.block);
            index == best || close || apart < sides.settings.significant
        })
        .collect();
    let parameters = |index: usize| {
        let judged = trials[index].found.as_ref();
        judged.map_or(usize::MAX, |judged| judged.fit.free)
    };
    set.sort_by(|&a, &b| {
        parameters(a)
            .cmp(&parameters(b))
            .then(error(a).total_cmp(&error(b)))
    });
    set
}

/// The model without the effect, fitted again; `None` where it cannot be.
fn without(model: &Model, id: &str, sides: &Sides) -> Option<(BalanceFit, Score)> {
    let fit = sides.fit(&model.without_effect(id).ok()?)?;
    let score = sides.held_out(&fit, None);
    Some((fit, score))
}

/// Whether the held-out error rises by less than a hundredth.
fn costs_nothing(without: &Score, with: &Score) -> bool {
    without.rmse < (1.0 + WORTHWHILE) * with.rmse
}

/// Backward check of what the search added.
fn drop_superfluous(found: &mut Found, sides: &Sides) {
    for id in found.accepted.clone() {
        if found.accepted.len() < 2 {
            return;
        }
        let Some((fit, score)) = without(&found.fit.model, id, sides) else {
            continue;
        };
        if costs_nothing(&score, &found.score) {
            found.accepted.retain(|other| *other != id);
            (found.fit, found.score) = (fit, score);
            // The rungs on the way led through an effect that is not in the answer.
            found.rungs.truncate(1);
            found
                .rungs
                .push((found.fit.model.effect_ids(), found.score.rmse));
        }
    }
}

/// Effects that were in the model before and are not needed any more: their removal, with everything refitted, costs
/// nothing on the hold-out; or their size is not told from zero, and the hold-out does not miss them beyond chance.
pub(super) fn superfluous(
    fit: &BalanceFit,
    score: &Score,
    sides: &Sides,
    added: &[&'static str],
) -> Vec<&'static str> {
    let mut ids = fit.model.effect_ids();
    ids.retain(|id| !added.contains(id));
    ids.retain(|id| {
        let Some((_, without)) = without(&fit.model, id, sides) else {
            return false;
        };
        let chance = z(&without, score, sides.settings.block) < sides.settings.significant;
        costs_nothing(&without, score) || (chance && fit.certainty_of(id) < TOLD_FROM_ZERO)
    });
    ids
}

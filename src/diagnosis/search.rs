//! Greedy search: the best effect that pays joins the model, until nothing more pays; then each is put to the test again.
//!
//! ```text
//! round: refit all -> best that pays, with those that cannot be told from it -> joins -> next round; a further one must
//!        explain a good part of what is left, and be alone in that unless it explains the run to the noise
//! then:  exchange  where the floor is not reached, each effect is taken out and the screen asked again
//!        twins     each effect is replaced by what it could not be told from: the better one stays (an early choice was
//!                  made while the others were still missing)
//!        removal   an effect that the others have made superfluous goes
//!        end       those that were added last and leave most of the error where it was go: they lean on the wrong form of
//!                  what was named before them
//! ```

use rayon::prelude::*;

use super::candidates::Refit;
use super::decide::{self, Settings, not_told_apart, pays};
use super::evidence::Evidence;
use super::family::related;
use super::ladder::Rung;
use super::progress::{Event, Progress, Stage};
use super::refit::{Thoroughness, polished, refit_all, refit_one, refit_screened};
use super::score::Score;
use super::screen::{Screen, Screened};
use crate::identification::output_error::{self, Fit, FitError};
use crate::plant::{Effect, Model, effect};

/// Effects that one search adds at most.
const MOST_EFFECTS: usize = 4;
/// Rivals of one effect that are tried in its place.
const MOST_RIVALS: usize = 3;
/// Share of the error that the first effects leave which the further ones must explain to be named.
const FURTHER_EXPLAIN: f64 = 0.5;
/// Share that each of them must explain of what is left, as the first one must. On a real machine the rest is made of
/// many small effects and of coloured noise, and every effect that is free to choose its form or its time bends towards it.
const EACH_EXPLAINS: f64 = 0.3;
/// Share of what an effect explains that the screen must promise of another before it is tried in its place.
const WORTH_AN_EXCHANGE: f64 = 0.4;
/// Rise of the held-out error below which an effect is superfluous.
const SUPERFLUOUS: f64 = 1.01;

/// How far a search goes and who watches it.
#[derive(Clone, Copy)]
pub(super) struct Limits<'a> {
    pub(super) settings: Settings,
    pub(super) until_floor: bool,
    pub(super) thoroughness: Thoroughness,
    pub(super) progress: Progress<'a>,
}

/// An effect of the answer and those that it could not be told from.
#[derive(Clone, Debug)]
pub(super) struct Accepted {
    pub(super) id: &'static str,
    pub(super) rivals: Vec<&'static str>,
}

/// A model on the way.
#[derive(Clone)]
pub(super) struct Standing {
    pub(super) fit: Fit,
    pub(super) score: Score,
}

/// What a search has found.
pub(super) struct Found {
    pub(super) settings: Settings,
    pub(super) baseline: Standing,
    pub(super) best: Standing,
    pub(super) accepted: Vec<Accepted>,
    pub(super) ladder: Vec<Rung>,
    /// How the candidates stood when nothing had been added yet, and which of them were in the answer.
    pub(super) first_round: Vec<Refit>,
    pub(super) first_set: Vec<usize>,
    /// Held-out score with that effect of the answer alone which explains most alone.
    pub(super) best_alone: Option<Score>,
}

/// Searches from `baseline`; `original` is the model before any fit.
pub(super) fn search(
    evidence: &Evidence,
    baseline: Fit,
    original: &Model,
    limits: Limits<'_>,
) -> Result<Found, FitError> {
    let score = Score::of(&baseline.model, &evidence.holdout, &evidence.noise)?;
    let baseline = Standing {
        fit: baseline,
        score,
    };
    let mut now = baseline.clone();
    let mut found = Found {
        settings: limits.settings,
        ladder: vec![rung(&baseline)],
        baseline: baseline.clone(),
        best: baseline,
        accepted: Vec::new(),
        first_round: Vec::new(),
        first_set: Vec::new(),
        best_alone: None,
    };
    while found.accepted.len() < MOST_EFFECTS {
        let first = found.accepted.is_empty();
        let mut refits = refit_all(
            evidence,
            &now.fit,
            original,
            if first { 0.0 } else { EACH_EXPLAINS },
            limits,
        )?;
        let mut set = in_the_answer(&now.score, &refits, limits.settings);
        let leans = |&index: &usize| {
            let with = &refits[index].holdout;
            decide::explained_beyond_doubt(evidence, &now.score, with) < EACH_EXPLAINS
        };
        // One of several that explain alike is no name, unless with it everything is explained.
        let open = |&index: &usize| {
            set.len() > 1 && !decide::at_the_floor(evidence, &refits[index].holdout)
        };
        if !first && set.first().is_some_and(|index| leans(index) || open(index)) {
            break;
        }
        (limits.progress)(Event::Begun {
            stage: Stage::Check,
            of: 0,
        });
        polish(evidence, &mut refits, &mut set, limits.settings)?;
        let chosen = set.first().map(|&index| refits[index].clone());
        let rivals = set
            .iter()
            .skip(1)
            .map(|&index| refits[index].id())
            .collect();
        if first {
            (found.first_round, found.first_set) = (refits, set);
        }
        let Some(chosen) = chosen else { break };
        (limits.progress)(Event::Accepted {
            effect: chosen.id(),
            holdout: chosen.holdout.nrms,
        });
        found.accepted.push(Accepted {
            id: chosen.id(),
            rivals,
        });
        now = Standing {
            fit: chosen.fit,
            score: chosen.holdout,
        };
        found.ladder.push(rung(&now));
        if decide::enough(
            evidence,
            &found.baseline.score,
            &now.score,
            limits.until_floor,
        ) {
            break;
        }
    }
    found.best = now;
    if found.accepted.len() > 1 {
        let before: Vec<&str> = found.accepted.iter().map(|accepted| accepted.id).collect();
        if !decide::at_the_floor(evidence, &found.best.score) {
            exchange(evidence, original, &mut found, limits.progress)?;
        }
        settle_twins(evidence, original, &mut found)?;
        drop_superfluous(evidence, &mut found)?;
        end_where_it_explains(evidence, &mut found)?;
        let after: Vec<&str> = found.accepted.iter().map(|accepted| accepted.id).collect();
        if before != after {
            if before.starts_with(&after) {
                found.ladder.truncate(1 + after.len());
            } else {
                // The rungs on the way led through an effect that is not in the answer.
                found.ladder.truncate(1);
                found.ladder.push(rung(&found.best));
            }
        }
    }
    found.best_alone = best_alone(evidence, original, &found);
    Ok(found)
}

/// Fits the first of the answer in full. A name that the full fit, which knows the sizes better, does not let stand gives
/// way to the next; where none of these is left, nothing is named.
fn polish(
    evidence: &Evidence,
    refits: &mut [Refit],
    set: &mut Vec<usize>,
    settings: Settings,
) -> Result<(), FitError> {
    let front: Vec<usize> = set.iter().take(1 + MOST_RIVALS).copied().collect();
    for &member in &front {
        refits[member] = polished(evidence, &refits[member], settings)?;
    }
    let stands = |member: &usize| front.contains(member) && refits[*member].is_possible();
    match set.iter().position(stands) {
        Some(place) => {
            let name = set.remove(place);
            set.insert(0, name);
        }
        None => set.clear(),
    }
    Ok(())
}

/// The score of the first choice, as long as it is in the answer. Where it was exchanged, what it explained says nothing of
/// what is named: each effect of the answer is fitted alone, and the best of them counts.
fn best_alone(evidence: &Evidence, original: &Model, found: &Found) -> Option<Score> {
    let chosen = &found.first_round[*found.first_set.first()?];
    let mut named = found.accepted.iter().map(|accepted| accepted.id);
    if named.any(|id| id == chosen.id()) {
        return Some(chosen.holdout.clone());
    }
    let alone = found.accepted.iter().filter_map(|accepted| {
        let effect = effect::find(accepted.id)?;
        let fit = &found.baseline.fit;
        // One that cannot be simulated alone explains nothing alone.
        let refit = refit_one(evidence, fit, original, effect, found.settings).ok()?;
        Some(refit.holdout)
    });
    alone.min_by(|a, b| a.nrms.total_cmp(&b.nrms))
}

/// The best candidate that pays and those that cannot be told from it, the preferred one first; none where none pays.
fn in_the_answer(base: &Score, refits: &[Refit], settings: Settings) -> Vec<usize> {
    (0..refits.len())
        .filter(|&index| refits[index].is_possible())
        .filter(|&index| pays(base, &refits[index].holdout, settings))
        .min_by(|&a, &b| refits[a].holdout.nrms.total_cmp(&refits[b].holdout.nrms))
        .map_or_else(Vec::new, |best| {
            not_told_apart(base, refits, best, settings)
        })
}

/// Takes each effect out and asks the screen what it would put there now: the first choice was made while the others were
/// still missing and may have had to serve for them.
fn exchange(
    evidence: &Evidence,
    original: &Model,
    found: &mut Found,
    progress: Progress<'_>,
) -> Result<(), FitError> {
    for place in 0..found.accepted.len() {
        let id = found.accepted[place].id;
        let Ok(without) = found.best.fit.model.without_effect(id) else {
            continue;
        };
        let base = standing(evidence, &without)?;
        let screen = Screen::new(&base.fit, &evidence.training);
        let others: Vec<&'static dyn Effect> = effect::CATALOGUE
            .iter()
            .copied()
            .filter(|effect| {
                let other = effect.card().id;
                let strange = |there: &str| other != there && !related(other, there);
                strange(id) && without.effects.iter().all(|active| strange(active.id()))
            })
            .collect();
        let mut screened = screen.all(&others, progress);
        screened.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        // What the effect in place explains; the screen may be wrong by a factor, not by any.
        let in_place = 1.0 - (found.best.fit.nrms / base.fit.nrms).powi(2);
        let least = WORTH_AN_EXCHANGE * in_place * screen.error();
        let others: Vec<Screened> = screened
            .into_iter()
            .filter(|candidate| candidate.gain > least)
            .take(MOST_RIVALS)
            .collect();
        // One that cannot be simulated must not hide the others.
        let refits: Vec<Refit> = others
            .par_iter()
            .filter_map(|candidate| {
                refit_screened(evidence, &base.fit, original, candidate, found.settings).ok()
            })
            .collect();
        let set = in_the_answer(&base.score, &refits, found.settings);
        let Some((&first, rivals)) = set.split_first() else {
            continue;
        };
        if decide::beats(&refits[first].holdout, &found.best.score, found.settings) {
            let refit = polished(evidence, &refits[first], found.settings)?;
            found.accepted[place] = Accepted {
                id: refit.id(),
                rivals: rivals.iter().map(|&index| refits[index].id()).collect(),
            };
            found.best = Standing {
                fit: refit.fit,
                score: refit.holdout,
            };
        }
    }
    Ok(())
}

/// Puts each effect's rivals in its place, now that the others are there. A better one takes the place; one that does as
/// well stays a rival.
fn settle_twins(evidence: &Evidence, original: &Model, found: &mut Found) -> Result<(), FitError> {
    for place in 0..found.accepted.len() {
        let accepted = found.accepted[place].clone();
        let Ok(without) = found.best.fit.model.without_effect(accepted.id) else {
            continue;
        };
        if accepted.rivals.is_empty() {
            continue;
        }
        let base = standing(evidence, &without)?;
        let (tried, untried) = accepted
            .rivals
            .split_at(accepted.rivals.len().min(MOST_RIVALS));
        let mut equals: Vec<(&'static str, Score)> = Vec::new();
        for &id in tried {
            let Some(rival) = effect::find(id).filter(|_| !found.best.fit.model.has(id)) else {
                continue;
            };
            let Ok(refit) = refit_one(evidence, &base.fit, original, rival, found.settings) else {
                continue;
            };
            if decide::beats(&refit.holdout, &found.best.score, found.settings) {
                found.best = Standing {
                    fit: refit.fit,
                    score: refit.holdout,
                };
                found.accepted[place].id = id;
                let best = &found.best.score;
                equals.retain(|(_, score)| !decide::beats(best, score, found.settings));
            } else if !decide::beats(&found.best.score, &refit.holdout, found.settings) {
                equals.push((id, refit.holdout));
            }
        }
        found.accepted[place].rivals = equals
            .iter()
            .map(|(id, _)| *id)
            .chain(untried.iter().copied())
            .collect();
    }
    Ok(())
}

/// Backward check: an effect whose removal, with everything refitted, costs less than a hundredth is superfluous.
fn drop_superfluous(evidence: &Evidence, found: &mut Found) -> Result<(), FitError> {
    for accepted in found.accepted.clone() {
        let Ok(without) = found.best.fit.model.without_effect(accepted.id) else {
            continue;
        };
        let there = standing(evidence, &without)?;
        if there.score.nrms < SUPERFLUOUS * found.best.score.nrms && found.accepted.len() > 1 {
            found.accepted.retain(|other| other.id != accepted.id);
            found.best = there;
        }
    }
    Ok(())
}

/// Cuts the list where all that follows explains less than half of the error that was left. A second effect of an error
/// that has two causes takes it to the floor, or most of the way; one that merely gains something there leans on what
/// the form of the first does not fit.
fn end_where_it_explains(evidence: &Evidence, found: &mut Found) -> Result<(), FitError> {
    for kept in 1..found.accepted.len() {
        let mut shorter = found.best.fit.model.clone();
        for accepted in &found.accepted[kept..] {
            if let Ok(without) = shorter.without_effect(accepted.id) {
                shorter = without;
            }
        }
        let there = standing(evidence, &shorter)?;
        let share = decide::explained_beyond_doubt(evidence, &there.score, &found.best.score);
        if share < FURTHER_EXPLAIN {
            found.accepted.truncate(kept);
            found.best = there;
            break;
        }
    }
    Ok(())
}

fn standing(evidence: &Evidence, model: &Model) -> Result<Standing, FitError> {
    let fit = output_error::fit(
        std::slice::from_ref(model),
        &evidence.training,
        &evidence.noise,
    )?;
    Ok(Standing {
        score: Score::of(&fit.model, &evidence.holdout, &evidence.noise)?,
        fit,
    })
}

fn rung(standing: &Standing) -> Rung {
    Rung {
        effects: standing.fit.model.effect_ids(),
        holdout_rmse: standing.score.nrms,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::progress::silent;
    use crate::diagnosis::tests::{evidence, nameplate, truth};

    #[test]
    fn what_an_exchanged_effect_explained_is_not_held_for_the_answer() {
        let data = evidence(&truth("quadratic_load", &[2e-6]), 9);
        let (data, baseline) = data.with_baseline(&nameplate()).unwrap();
        let limits = Limits {
            settings: Settings::default(),
            until_floor: false,
            thoroughness: Thoroughness::Promising,
            progress: &silent,
        };
        let mut found = search(&data, baseline, &nameplate(), limits).unwrap();
        let (base, chosen) = (found.baseline.score.nrms, found.accepted[0].id);
        assert_eq!(chosen, "quadratic_load");
        // The first choice is in the answer: its own score counts, as it is.
        let first = found.best_alone.clone().unwrap();
        assert!(first.nrms < 0.6 * base);
        // As after an exchange for something that explains nothing of this.
        found.accepted[0].id = "current_offset";
        let exchanged = best_alone(&data, &nameplate(), &found).unwrap();
        assert!(exchanged.nrms > 0.9 * base, "{} of {base}", exchanged.nrms);
        assert!(!decide::explains(
            &data,
            &found.baseline.score,
            &exchanged,
            &exchanged
        ));
        // Of several the best counts, wherever it stands in the answer.
        found.accepted.push(Accepted {
            id: "asymmetric_viscous",
            rivals: Vec::new(),
        });
        found.first_set = vec![
            found
                .first_round
                .iter()
                .position(|refit| refit.id() == "voltage_drop")
                .unwrap(),
        ];
        found.accepted[0].id = "quadratic_load";
        let best = best_alone(&data, &nameplate(), &found).unwrap();
        assert!((best.nrms / first.nrms - 1.0).abs() < 0.02);
    }
}

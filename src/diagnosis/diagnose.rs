//! Which effect is missing: refit every candidate, decide on the hold-out, go on until nothing more pays.

use serde::Serialize;

use super::candidates::{Candidate, Refit, Status, refit_all};
use super::decide::{
    AT_THE_FLOOR, EXPLAINS_SOMETHING, SIGNIFICANT, SUFFICIENT, explained, first_rank_shares,
    not_told_apart, pays, z,
};
use super::evidence::{Evidence, HoldoutFrom};
use super::fitted::Fitted;
use super::ladder::Rung;
use super::mechanical;
use super::score::Score;
use crate::identification::noise::FloorSource;
use crate::identification::output_error::{self, Fit, FitError};
use crate::plant::{Input, Model};

/// Effects that one search adds at most.
const MOST_EFFECTS: usize = 4;
/// Error, in units of the floor, above which the search goes on although the named effects are sufficient.
const NEAR_THE_FLOOR: f64 = 2.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DiagnosisVerdict {
    Effect,
    Ambiguous,
    None,
    Unexplained,
}

/// The answer, as `diagnose --json` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    pub verdict: DiagnosisVerdict,
    pub effect: Option<&'static str>,
    pub effects: Vec<&'static str>,
    pub sufficient: bool,
    pub noise_floor_from: FloorSource,
    pub holdout_from: HoldoutFrom,
    /// Of the whole accepted set, on the hold-out.
    pub explained_percent: f64,
    pub holdout_before: f64,
    pub holdout_after: f64,
    pub candidates: Vec<Candidate>,
    pub confusable: Vec<[&'static str; 2]>,
    pub ladder: Vec<Rung>,
    /// One sentence for a person.
    pub sentence: String,
    /// The refitted baseline and the model with every accepted effect.
    #[serde(skip)]
    pub baseline: Fitted,
    #[serde(skip)]
    pub model: Fitted,
}

/// Refits `model` as the baseline and searches for what it misses. With `until_floor` the search goes on until the
/// error is at the floor or nothing more pays; without, until the named effects are sufficient and the floor is near.
pub fn diagnose(
    model: &Model,
    evidence: Evidence,
    until_floor: bool,
) -> Result<Diagnosis, FitError> {
    if evidence.training.input != Input::Voltage {
        return mechanical::diagnose(model, &evidence, until_floor);
    }
    let (evidence, baseline) = evidence.with_baseline(model)?;
    let floor = evidence.floor();
    let base = Score::of(&baseline.model, &evidence.holdout, &evidence.noise)?;
    let mut current = baseline.clone();
    let mut score = base.clone();
    let mut refits = refit_all(&evidence, &current, model)?;
    let mut set = in_the_answer(&score, &refits);
    let first_round = FirstRound::of(&score, current.nrms, floor, &refits, &set);
    let mut accepted: Vec<&'static str> = Vec::new();
    let mut ladder = vec![Rung {
        effects: current.model.effect_ids(),
        holdout_rmse: base.nrms,
    }];
    while let Some(&chosen) = set.first() {
        let chosen = refits.swap_remove(chosen);
        accepted.push(chosen.id());
        score = chosen.holdout;
        current = chosen.fit;
        ladder.push(Rung {
            effects: current.model.effect_ids(),
            holdout_rmse: score.nrms,
        });
        let eta = explained(base.nrms, score.nrms, floor);
        let enough = if until_floor {
            score.nrms < 1.08 * floor
        } else {
            // A strong effect explains nine tenths of the error and may still hide a weak partner well above the floor.
            eta >= SUFFICIENT && (floor <= 0.0 || score.nrms < NEAR_THE_FLOOR * floor)
        };
        if enough || accepted.len() == MOST_EFFECTS {
            break;
        }
        refits = refit_all(&evidence, &current, model)?;
        set = in_the_answer(&score, &refits);
    }
    let first_choice = accepted.first().copied();
    if accepted.len() > 1 {
        let found = accepted.len();
        (current, score) = drop_superfluous(&evidence, current, score, &mut accepted)?;
        if accepted.len() < found {
            // The rungs on the way led through an effect that is not in the answer.
            ladder.truncate(1);
            ladder.push(Rung {
                effects: current.model.effect_ids(),
                holdout_rmse: score.nrms,
            });
        }
    }
    let eta = explained(base.nrms, score.nrms, floor);
    let verdict = verdict(
        &base,
        &evidence,
        !accepted.is_empty(),
        eta,
        first_round.tied && accepted.len() == 1 && accepted.first().copied() == first_choice,
    );
    if matches!(
        verdict,
        DiagnosisVerdict::None | DiagnosisVerdict::Unexplained
    ) {
        accepted.clear();
        ladder.truncate(1);
        current = baseline.clone();
        score = base.clone();
    }
    let excited = first_round
        .candidates
        .iter()
        .any(|candidate| candidate.status != Status::NotExcited);
    let effect = accepted.first().copied();
    let mut diagnosis = Diagnosis {
        verdict,
        effect,
        effects: accepted,
        sufficient: match verdict {
            // Without a floor, or in a run that would show nothing, nobody knows whether something is missing.
            DiagnosisVerdict::None => evidence.noise.source != FloorSource::None && excited,
            _ => effect.is_some() && eta >= SUFFICIENT,
        },
        noise_floor_from: evidence.noise.source,
        holdout_from: evidence.holdout_from,
        explained_percent: if effect.is_some() { 100.0 * eta } else { 0.0 },
        holdout_before: base.nrms,
        holdout_after: score.nrms,
        candidates: first_round.candidates,
        confusable: first_round.confusable,
        ladder,
        sentence: String::new(),
        baseline: Fitted::from(&baseline),
        model: Fitted::from(&current),
    };
    diagnosis.sentence = sentence(&diagnosis);
    Ok(diagnosis)
}

/// What is reported of the candidates: how each stands when nothing has been added yet.
struct FirstRound {
    candidates: Vec<Candidate>,
    confusable: Vec<[&'static str; 2]>,
    tied: bool,
}

impl FirstRound {
    fn of(base: &Score, error_before: f64, floor: f64, refits: &[Refit], set: &[usize]) -> Self {
        let rivals = set.iter().skip(1);
        Self {
            candidates: describe(base, error_before, floor, refits, set),
            confusable: rivals
                .map(|&rival| [refits[set[0]].id(), refits[rival].id()])
                .collect(),
            tied: set.len() > 1,
        }
    }
}

/// The best candidate that pays and those that cannot be told from it, the preferred one first; none where none pays.
fn in_the_answer(base: &Score, refits: &[Refit]) -> Vec<usize> {
    (0..refits.len())
        .filter(|&index| pays(base, &refits[index].holdout))
        .min_by(|&a, &b| refits[a].holdout.nrms.total_cmp(&refits[b].holdout.nrms))
        .map_or_else(Vec::new, |best| not_told_apart(base, refits, best))
}

fn verdict(
    base: &Score,
    evidence: &Evidence,
    named: bool,
    eta: f64,
    tied: bool,
) -> DiagnosisVerdict {
    let at_the_floor = base.nrms < evidence.noise.tolerance(AT_THE_FLOOR)
        || evidence.noise.source == FloorSource::None;
    if named && eta >= EXPLAINS_SOMETHING {
        if tied {
            DiagnosisVerdict::Ambiguous
        } else {
            DiagnosisVerdict::Effect
        }
    } else if named || !at_the_floor {
        if at_the_floor {
            DiagnosisVerdict::None
        } else {
            DiagnosisVerdict::Unexplained
        }
    } else {
        DiagnosisVerdict::None
    }
}

/// Backward check: an effect whose removal, with everything refitted, costs less than a hundredth is superfluous.
fn drop_superfluous(
    evidence: &Evidence,
    mut fit: Fit,
    mut score: Score,
    accepted: &mut Vec<&'static str>,
) -> Result<(Fit, Score), FitError> {
    for id in accepted.clone() {
        let Ok(without) = fit.model.without_effect(id) else {
            continue;
        };
        let refit = output_error::fit(&[without], &evidence.training, &evidence.noise)?;
        let there = Score::of(&refit.model, &evidence.holdout, &evidence.noise)?;
        if there.nrms < 1.01 * score.nrms && accepted.len() > 1 {
            accepted.retain(|other| *other != id);
            (fit, score) = (refit, there);
        }
    }
    Ok((fit, score))
}

fn describe(
    base: &Score,
    error_before: f64,
    floor: f64,
    refits: &[Refit],
    set: &[usize],
) -> Vec<Candidate> {
    let shares = first_rank_shares(refits);
    let mut order: Vec<usize> = (0..refits.len()).collect();
    order.sort_by(|&a, &b| {
        let place = |index: usize| {
            set.iter()
                .position(|member| *member == index)
                .unwrap_or(usize::MAX)
        };
        let error = |index: usize| refits[index].holdout.nrms;
        place(a).cmp(&place(b)).then(error(a).total_cmp(&error(b)))
    });
    order
        .into_iter()
        .enumerate()
        .map(|(rank, index)| {
            let refit = &refits[index];
            let (pays, against_base) = (pays(base, &refit.holdout), z(base, &refit.holdout));
            let status = if set.first() == Some(&index) {
                Status::Supported
            } else if pays {
                Status::Possible
            } else if refit.minimum_detectable > refit.typical_size {
                Status::NotExcited
            } else {
                Status::RuledOut
            };
            let share = explained(base.nrms, refit.holdout.nrms, floor);
            Candidate {
                effect: refit.id(),
                rank: rank + 1,
                status,
                probability: shares[index],
                parameters: refit.parameters(),
                error_before,
                error_after: refit.fit.nrms,
                holdout_before: base.nrms,
                holdout_after: refit.holdout.nrms,
                explained_percent: 100.0 * share,
                minimum_detectable: refit.minimum_detectable,
                evidence: evidence_sentence(refit, base, against_base, share, status),
            }
        })
        .collect()
}

fn evidence_sentence(refit: &Refit, base: &Score, z: f64, share: f64, status: Status) -> String {
    let card = refit.effect.card();
    let (before, after) = (base.nrms, refit.holdout.nrms);
    let first = &refit.effect.parameters()[0];
    match status {
        Status::NotExcited if !refit.minimum_detectable.is_finite() => format!(
            "{} touches nothing that this run measures: {}",
            card.name, card.excite
        ),
        Status::NotExcited => format!(
            "{} of less than {:.2e} {} would not show in this run: {}",
            card.name, refit.minimum_detectable, first.unit, card.excite
        ),
        Status::RuledOut => format!(
            "{} leaves the held-out error at {after:.2} of {before:.2} times the noise (z {z:.1}, {SIGNIFICANT} is \
             asked); more than {:.2e} {} would have shown",
            card.name, refit.minimum_detectable, first.unit
        ),
        Status::Supported | Status::Possible => format!(
            "{} takes the held-out error from {before:.2} to {after:.2} times the noise (z {z:.1}) and explains \
             {:.0} % of what can be explained",
            card.name,
            100.0 * share
        ),
    }
}

fn sentence(diagnosis: &Diagnosis) -> String {
    let names = diagnosis.effects.join(" and ");
    let (before, after) = (diagnosis.holdout_before, diagnosis.holdout_after);
    match diagnosis.verdict {
        DiagnosisVerdict::None if diagnosis.noise_floor_from == FloorSource::None => {
            "nothing in the catalogue pays on the hold-out; without a noise floor it cannot be said whether anything \
             is missing"
                .to_owned()
        }
        DiagnosisVerdict::None if !diagnosis.sufficient => {
            "this run would not show any effect of the catalogue: nothing can be said".to_owned()
        }
        DiagnosisVerdict::None => format!("nothing is missing: held-out error {before:.2} times the noise floor"),
        DiagnosisVerdict::Unexplained => {
            format!("held-out error {before:.2} times the noise floor, and no effect of the catalogue explains it")
        }
        DiagnosisVerdict::Ambiguous => format!(
            "behaves like {names}, which this run cannot tell from {}",
            diagnosis.confusable.iter().map(|pair| pair[1]).collect::<Vec<_>>().join(", ")
        ),
        DiagnosisVerdict::Effect => format!(
            "missing: {names}; held-out error {before:.2} -> {after:.2} times the noise floor, {:.0} % explained",
            diagnosis.explained_percent
        ),
    }
}

//! The ladder of models: one rung up with an effect more, one down with an effect less, each judged on the hold-out.

use serde::Serialize;

use super::candidates::by_key;
use super::compare::{Comparison, compare};
use super::decide::{Settings, WORTHWHILE, fall_in_words, pays, z};
use super::evidence::Evidence;
use super::fitted::Fitted;
use super::location::ErrorOf;
use super::mechanical;
use super::score::Score;
use crate::identification::output_error::{self, Fit, FitError};
use crate::plant::{Effect, Input, Model};
use crate::sample::ParameterEstimate;

use super::refit::refit_one;

/// One model on the ladder and its held-out error in units of the noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rung {
    pub effects: Vec<&'static str>,
    pub holdout_rmse: f64,
}

/// What adding or removing an effect did, as `add --json` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct AddResult {
    pub effect: &'static str,
    pub accepted: bool,
    pub reason: String,
    pub before: Comparison,
    pub after: Comparison,
    #[serde(serialize_with = "by_key")]
    pub parameters: Vec<ParameterEstimate>,
    pub ladder: Vec<Rung>,
    /// Errors on the confirming run where there is one: the headline.
    pub confirm: Option<[Rung; 2]>,
    #[serde(skip)]
    pub fit: Fitted,
}

/// Refits `model` with `effect` added; refused, with the reason, where that does not pay on the hold-out.
pub fn add(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: Evidence,
) -> Result<AddResult, FitError> {
    if evidence.training.input != Input::Voltage {
        return mechanical::add(effect, model, &evidence);
    }
    let (evidence, before) = evidence.with_baseline(model)?;
    let after = refit_one(&evidence, &before, model, effect)?;
    change(effect, &evidence, &before, &after, true)
}

/// Refits `model` without `effect`; refused where the effect pays on the hold-out.
pub fn remove(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: Evidence,
) -> Result<AddResult, FitError> {
    if evidence.training.input != Input::Voltage {
        return mechanical::remove(effect, model, &evidence);
    }
    let (evidence, before) = evidence.with_baseline(model)?;
    let without = before.model.without_effect(effect.card().id)?;
    let after = output_error::fit(&[without], &evidence.training, &evidence.noise)?;
    change(effect, &evidence, &before, &after, false)
}

fn change(
    effect: &'static dyn Effect,
    evidence: &Evidence,
    before: &Fit,
    after: &Fit,
    adding: bool,
) -> Result<AddResult, FitError> {
    let score = |fit: &Fit| Score::of(&fit.model, &evidence.holdout, &evidence.noise);
    let (score_before, score_after) = (score(before)?, score(after)?);
    let accepted = if adding {
        pays(&score_before, &score_after, Settings::default())
    } else {
        !pays(&score_after, &score_before, Settings::default())
    };
    let rung = |fit: &Fit, score: &Score| Rung {
        effects: fit.model.effect_ids(),
        holdout_rmse: score.nrms,
    };
    let confirm = match &evidence.confirm {
        Some(run) => {
            let on = |fit: &Fit| Score::of(&fit.model, run, &evidence.noise);
            Some([rung(before, &on(before)?), rung(after, &on(after)?)])
        }
        None => None,
    };
    let prefix = format!("{}.", effect.card().id);
    let owner = if adding { after } else { before };
    Ok(AddResult {
        effect: effect.card().id,
        accepted,
        reason: reason(
            effect,
            [before, after],
            [&score_before, &score_after],
            adding,
            accepted,
            evidence.noise.source.times(),
        ),
        before: compare(&before.model, evidence, ErrorOf::Structure)?,
        after: compare(&after.model, evidence, ErrorOf::Structure)?,
        parameters: owner
            .parameters
            .iter()
            .filter(|p| p.key.starts_with(&prefix))
            .cloned()
            .collect(),
        ladder: vec![rung(before, &score_before), rung(after, &score_after)],
        confirm,
        fit: Fitted::from(after),
    })
}

fn reason(
    effect: &dyn Effect,
    [before, after]: [&Fit; 2],
    [score_before, score_after]: [&Score; 2],
    adding: bool,
    accepted: bool,
    times: &str,
) -> String {
    let name = effect.card().name;
    let (from, to) = (score_before.nrms, score_after.nrms);
    if !adding {
        return if accepted {
            format!(
                "without {name} the held-out error goes from {from:.2} to {to:.2} {times}: it is superfluous"
            )
        } else {
            format!(
                "without {name} the held-out error rises from {from:.2} to {to:.2} {times}: it is needed"
            )
        };
    }
    let settings = Settings::default();
    let fall = fall_in_words(score_before, score_after, times, settings);
    if accepted {
        let by_chance = z(score_before, score_after, settings) < settings.significant;
        // Accepted all the same: where the model fails, it fails in few stretches.
        let mended = if by_chance {
            "; it mends the few stretches in which the model without it fails"
        } else {
            ""
        };
        format!("with {name} {fall}{mended}")
    } else if to >= (1.0 - WORTHWHILE) * from && after.nrms < (1.0 - WORTHWHILE) * before.nrms {
        format!(
            "{name} helps only in training ({:.2} -> {:.2}); on data that it was not fitted to {fall}",
            before.nrms, after.nrms
        )
    } else {
        format!("{name} does not pay: {fall}")
    }
}

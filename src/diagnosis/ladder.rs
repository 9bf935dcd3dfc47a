//! The ladder of models: one rung up with an effect more, one down with an effect less, each judged on the hold-out.

use serde::Serialize;

use super::bench::Bench;
use super::candidates::by_key;
use super::compare::{Comparison, compare};
use super::describe::percent;
use super::diagnose::Standing;
use super::evidence::Evidence;
use super::fitted::Fitted;
use super::joint::answer::{Inference, asked, infer};
use super::location::ErrorOf;
use super::mechanical;
use super::progress::silent;
use super::score::Score;
use crate::identification::output_error::FitError;
use crate::plant::{Effect, Input, Model};
use crate::sample::ParameterEstimate;

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

/// Refits `model` with `effect` added; refused, with the reason, where the runs do not ask for it beside all others.
pub fn add(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: Evidence,
) -> Result<AddResult, FitError> {
    if evidence.training.input != Input::Voltage {
        return mechanical::add(effect, model, &evidence);
    }
    let (bench, before) = Bench::new(model, evidence)?;
    let asked = asked(&before.model, Some(effect));
    let inference = infer(&before, &asked, &bench.evidence, &silent)?;
    let with = [before.model.effect_ids(), vec![effect.card().id]].concat();
    let start = inference.with_effects(&with);
    let start = start.ok_or_else(|| FitError::CannotSimulate {
        run: bench.evidence.training.name.clone(),
    })?;
    let after = bench.fit(&start)?;
    change(effect, &bench, &inference, [before, after], true)
}

/// Refits `model` without `effect`; refused where the runs ask for it.
pub fn remove(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: Evidence,
) -> Result<AddResult, FitError> {
    if evidence.training.input != Input::Voltage {
        return mechanical::remove(effect, model, &evidence);
    }
    let (bench, before) = Bench::new(model, evidence)?;
    let inference = infer(
        &before,
        &asked(&before.model, None),
        &bench.evidence,
        &silent,
    )?;
    let without = before.model.without_effect(effect.card().id)?;
    let after = bench.fit(&without)?;
    change(effect, &bench, &inference, [before, after], false)
}

fn change(
    effect: &'static dyn Effect,
    bench: &Bench,
    inference: &Inference,
    [before, after]: [Fitted; 2],
    adding: bool,
) -> Result<AddResult, FitError> {
    let evidence = &bench.evidence;
    let after = Standing::handed_on(after, bench, inference)?;
    let score = bench.held_out(&before.model)?;
    let (after, scores) = (after.fit, [score, after.score]);
    let is_there = inference.names(effect.card().id);
    let rung = |fit: &Fitted, score: &Score| Rung {
        effects: fit.model.effect_ids(),
        holdout_rmse: score.nrms,
    };
    let confirm = match &evidence.confirm {
        Some(run) => {
            let on = |fit: &Fitted| bench.confirming(&fit.model, run);
            Some([rung(&before, &on(&before)?), rung(&after, &on(&after)?)])
        }
        None => None,
    };
    let prefix = format!("{}.", effect.card().id);
    let owner = if adding { &after } else { &before };
    let times = evidence.noise.source.times();
    Ok(AddResult {
        effect: effect.card().id,
        accepted: is_there == adding,
        reason: reason(effect, inference, &fall(&scores, times), adding),
        before: compare(&before.model, evidence, ErrorOf::Structure)?,
        after: compare(&after.model, evidence, ErrorOf::Structure)?,
        parameters: owner
            .parameters
            .iter()
            .filter(|p| p.key.starts_with(&prefix))
            .cloned()
            .collect(),
        ladder: vec![rung(&before, &scores[0]), rung(&after, &scores[1])],
        confirm,
        fit: after,
    })
}

/// How the held-out error changes, in words.
fn fall([before, after]: &[Score; 2], times: &str) -> String {
    let share = 100.0 * (1.0 - after.nrms / before.nrms);
    let word = if share >= 0.0 { "falls" } else { "rises" };
    format!(
        "the held-out error {word} by {:.1} %, from {:.2} to {:.2} {times}",
        share.abs(),
        before.nrms,
        after.nrms
    )
}

/// Why an effect is accepted or refused: how likely it is there beside all others, and what the error does.
fn reason(effect: &dyn Effect, inference: &Inference, fall: &str, adding: bool) -> String {
    let card = effect.card();
    let found = inference.of(card.id);
    let likely = percent(found.map_or(0.0, |found| found.probability));
    let name = card.name;
    if !adding {
        let word = if inference.names(card.id) {
            "needed"
        } else {
            "superfluous"
        };
        return format!("{name} is {word}: it is there with {likely}, and without it {fall}");
    }
    let rivals: Vec<&str> = inference
        .named
        .iter()
        .copied()
        .filter(|id| *id != card.id)
        .collect();
    if inference.names(card.id) {
        let pairs = inference.confusable.iter();
        let twins: Vec<&str> = pairs
            .filter(|pair| pair.contains(&card.id))
            .map(|pair| if pair[0] == card.id { pair[1] } else { pair[0] })
            .collect();
        let twins = if twins.is_empty() {
            String::new()
        } else {
            format!(
                ", which these runs cannot tell from {}",
                twins.join(" and ")
            )
        };
        return format!("{name} is there with {likely}{twins}; with it {fall}");
    }
    let beside = if rivals.is_empty() {
        String::new()
    } else {
        format!(" beside what these runs ask for ({})", rivals.join(", "))
    };
    let unseen = if found.is_some_and(|found| found.excited) {
        ""
    } else {
        "; these runs would not show it"
    };
    format!("{name} is there with {likely} only{beside}{unseen}; with it alone {fall}")
}

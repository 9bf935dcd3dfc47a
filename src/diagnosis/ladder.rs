//! The ladder of models: one rung up with an effect more, one down with an effect less, each judged on the hold-out.

use serde::Serialize;

use super::bench::{Bench, beside};
use super::candidates::by_key;
use super::compare::Comparison;
use super::describe::superfluous;
use super::diagnose::Standing;
use super::evidence::Evidence;
use super::fitted::Fitted;
use super::joint::answer::{Inference, asked};
use super::progress::silent;
use super::score::Score;
use crate::identification::output_error::FitError;
use crate::identification::torque_rows::Method;
use crate::plant::{Effect, Model};
use crate::sample::ParameterEstimate;
use crate::text::number::probability;

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
    let (bench, before) = Bench::new(model, evidence)?;
    let asked = asked(&before.model, Some(effect));
    let inference = bench.ask(&before, &asked, &silent)?;
    let id = effect.card().id;
    let can_be_asked = inference
        .of(id)
        .is_some_and(|found| found.why_not.is_none());
    // Where the runs cannot be asked for it the answer is the model as it was.
    let after = if can_be_asked {
        bench.fit(&beside(&before.model, &inference, &[id])?)?
    } else {
        before.clone()
    };
    change(effect, &bench, &inference, [before, after], true)
}

/// Refits `model` without `effect`; refused where the runs ask for it.
pub fn remove(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: Evidence,
) -> Result<AddResult, FitError> {
    let (bench, before) = Bench::new(model, evidence)?;
    let inference = bench.ask(&before, &asked(&before.model, None), &silent)?;
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
            let scores = [on(&before)?.score, on(&after)?.score];
            Some([rung(&before, &scores[0]), rung(&after, &scores[1])])
        }
        None => None,
    };
    let prefix = format!("{}.", effect.card().id);
    let owner = if adding { &after } else { &before };
    let sides = [bench.compared(&before)?, bench.compared(&after)?];
    let fall = fall(&scores, evidence.noise.source.times()) + &both_processings(&sides);
    let reason = reason(effect, inference, &fall, adding);
    let [compared_before, compared_after] = sides;
    Ok(AddResult {
        effect: effect.card().id,
        accepted: is_there == adding,
        reason,
        before: compared_before,
        after: compared_after,
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

/// What each processing of a balance of torques says of the change, in words; nothing of a free run.
fn both_processings(sides: &[Comparison; 2]) -> String {
    let torque = |side: &Comparison| side.signals.torque_n_m.clone();
    let (Some(before), Some(after)) = (torque(&sides[0]), torque(&sides[1])) else {
        return String::new();
    };
    let pairs = before.processing.iter().zip(&after.processing);
    let words: Vec<String> = pairs
        .map(|(before, after)| {
            let (from, to) = (
                before.holdout_relative_error_percent,
                after.holdout_relative_error_percent,
            );
            let whole = before
                .whole_run_relative_error_percent
                .zip(after.whole_run_relative_error_percent)
                .map_or_else(String::new, |(from, to)| {
                    format!(", {from:.2} -> {to:.2} % over the whole run")
                });
            let method = match before.method {
                Method::WeakForm => "weak form",
                Method::InverseDynamics => {
                    "reference processing: inverse dynamics, zero-phase low pass"
                }
            };
            format!("; torque error {from:.2} -> {to:.2} % held out{whole} ({method})")
        })
        .collect();
    words.concat()
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
    let likely = probability(found.map_or(0.0, |found| found.probability));
    let name = card.name;
    if !adding {
        let word = if inference.names(card.id) {
            "needed"
        } else {
            "superfluous"
        };
        return format!("{name} is {word}: it is there with {likely}, and without it {fall}");
    }
    if let Some(why_not) = found.and_then(|found| found.why_not) {
        return format!("{name} cannot be judged from this run: {why_not}");
    }
    let superfluous = superfluous(inference);
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
        return format!("{name} is there with {likely}{twins}; with it {fall}{superfluous}");
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

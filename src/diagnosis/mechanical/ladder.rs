//! One effect more or less in the torque balance, before and after, under both processings.

use super::Settings;
use super::compare::{ProcessingError, comparison, processing_error};
use super::diagnose::{Start, superfluous_sentence};
use super::regression::BalanceFit;
use super::score::{first_rank_shares, z};
use super::search::superfluous;
use super::sides::Sides;
use super::trial::{self, Trial, WORTHWHILE};
use crate::diagnosis::decide::{Certainty, fall};
use crate::diagnosis::evidence::Evidence;
use crate::diagnosis::ladder::{AddResult, Rung};
use crate::diagnosis::location::ErrorOf;
use crate::identification::output_error::FitError;
use crate::identification::torque_rows::Method;
use crate::plant::{Effect, Model};

/// Refits the torque balance with `effect` added; refused, with the reason, where that does not pay on the hold-out.
pub fn add(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: &Evidence,
) -> Result<AddResult, FitError> {
    let start = Start::new(model, evidence, Settings::default())?;
    let trial = trial::of_effect(effect, &start.baseline, &start.sides, &evidence.training);
    let before = start.baseline.clone();
    // Fixed to nothing where it cannot be judged: the answer is then the model as it was.
    let after = match &trial.found {
        Ok(judged) => judged.fit.clone(),
        Err(_) => before.clone(),
    };
    let base = start.sides.held_out(&before, None);
    let accepted = trial.pays(&base, &start.sides);
    let mut result = change(effect, &start, evidence, [&before, &after], accepted);
    result.reason = adding(&trial, &result, &start, &before);
    result.parameters = trial.parameters();
    if accepted {
        let score = start.sides.held_out(&after, None);
        for id in superfluous(&after, &score, &start.sides, &[effect.card().id]) {
            result.reason.push_str(&superfluous_sentence(id));
        }
    }
    Ok(result)
}

/// Refits the torque balance without `effect`; refused where the effect pays on the hold-out.
pub fn remove(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: &Evidence,
) -> Result<AddResult, FitError> {
    let start = Start::new(model, evidence, Settings::default())?;
    let before = start.baseline.clone();
    let without = before.model.without_effect(effect.card().id)?;
    let after = start
        .sides
        .fit(&without)
        .ok_or_else(|| FitError::CannotSimulate {
            run: evidence.training.name.clone(),
        })?;
    let (with, without) = (
        start.sides.held_out(&before, None),
        start.sides.held_out(&after, None),
    );
    let accepted = !trial::pays(&without, &with, &start.sides);
    let mut result = change(effect, &start, evidence, [&before, &after], accepted);
    let verdict = if accepted {
        "it is superfluous"
    } else {
        "it is needed"
    };
    result.reason = format!(
        "without {} {}: {verdict}",
        effect.card().name,
        both_processings(&result)
    );
    let prefix = format!("{}.", effect.card().id);
    let own = before.parameters.iter();
    result.parameters = own
        .filter(|p| p.key.starts_with(&prefix))
        .cloned()
        .collect();
    Ok(result)
}

fn change(
    effect: &'static dyn Effect,
    start: &Start,
    evidence: &Evidence,
    [before, after]: [&BalanceFit; 2],
    accepted: bool,
) -> AddResult {
    let sides = &start.sides;
    let unit = start.scale.unit_n_m;
    let rung = |fit: &BalanceFit| Rung {
        effects: fit.model.effect_ids(),
        holdout_rmse: sides.held_out(fit, None).rmse / unit,
    };
    let confirm = sides.confirm.as_ref().map(|rows| {
        let on = |fit: &BalanceFit| Rung {
            effects: fit.model.effect_ids(),
            holdout_rmse: Sides::score(fit, None, rows).rmse / unit,
        };
        [on(before), on(after)]
    });
    let reference = Sides::new(
        Method::InverseDynamics,
        &before.model,
        evidence,
        Settings::default(),
    )
    .ok();
    // Each processing with its own fit: what it makes of the data is part of what it finds.
    let figures = |fit: &BalanceFit| -> Vec<ProcessingError> {
        let mut figures = vec![processing_error(sides, &fit.model, true)];
        figures.extend(reference.as_ref().and_then(|sides| {
            let own = sides.fit(&fit.model)?;
            Some(processing_error(sides, &own.model, true))
        }));
        figures
    };
    let compared = |fit: &BalanceFit| {
        comparison(
            &fit.model,
            sides,
            Some(start.scale),
            figures(fit),
            evidence,
            ErrorOf::Structure,
        )
    };
    AddResult {
        effect: effect.card().id,
        accepted,
        reason: String::new(),
        before: compared(before),
        after: compared(after),
        parameters: Vec::new(),
        ladder: vec![rung(before), rung(after)],
        confirm,
        fit: start.fitted(after, evidence),
    }
}

/// Held-out and fitted relative torque error of each processing, before and after.
fn both_processings(result: &AddResult) -> String {
    let (Some(before), Some(after)) = (
        &result.before.signals.torque_n_m,
        &result.after.signals.torque_n_m,
    ) else {
        return "the torque error is not known".to_owned();
    };
    let parts: Vec<String> = before
        .processing
        .iter()
        .zip(&after.processing)
        .map(|(before, after)| {
            let whole = before
                .whole_run_relative_error_percent
                .zip(after.whole_run_relative_error_percent)
                .map_or_else(String::new, |(before, after)| {
                    format!(", {before:.2} -> {after:.2} % over the whole run")
                });
            format!(
                "torque error {:.2} -> {:.2} % held out{whole} ({})",
                before.holdout_relative_error_percent,
                after.holdout_relative_error_percent,
                match before.method {
                    Method::WeakForm => "weak form",
                    Method::InverseDynamics => {
                        "reference processing: inverse dynamics, zero-phase low pass"
                    }
                }
            )
        })
        .collect();
    parts.join("; ")
}

fn adding(trial: &Trial<'_>, result: &AddResult, start: &Start, before: &BalanceFit) -> String {
    let name = trial.of.name();
    let judged = match &trial.found {
        Ok(judged) => judged,
        Err(reason) => return format!("{name} cannot be judged from this run: {reason}"),
    };
    let figures = both_processings(result);
    let sides = &start.sides;
    let base = sides.held_out(before, None);
    let (before_percent, after_percent) = (base.relative_percent, judged.holdout.relative_percent);
    let fall = fall(
        [before_percent, after_percent].map(|percent| format!("{percent:.2}")),
        1.0 - judged.holdout.rmse / base.rmse,
        " % of the torque",
        Certainty {
            better: first_rank_shares(&[&base, &judged.holdout])[1],
            z: z(&base, &judged.holdout, sides.settings.block),
            asked: sides.settings.significant,
        },
    );
    if result.accepted {
        return format!("with {name} {fall}; {figures}");
    }
    if let Some(reason) = &judged.refused {
        return format!("{name}: {reason}; {figures}");
    }
    let helps_in_training = judged.fit.rms() < (1.0 - WORTHWHILE) * before.rms();
    if helps_in_training && judged.holdout.rmse >= (1.0 - WORTHWHILE) * base.rmse {
        format!("{name} helps only in training: {figures}")
    } else {
        format!("{name} does not pay: {fall}; {figures}")
    }
}

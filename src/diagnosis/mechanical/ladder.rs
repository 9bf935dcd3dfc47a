//! One rung up or down the ladder: an effect more or less, before and after, under both processings.

use super::compare::{ProcessingError, comparison, processing_error};
use super::regression::BalanceFit;
use super::sides::{Balance, Sides};
use super::trial::{refused, with_effect};
use crate::diagnosis::decide::{Settings, WORTHWHILE, fall_in_words, pays, z};
use crate::diagnosis::evidence::Evidence;
use crate::diagnosis::ladder::{AddResult, Rung};
use crate::diagnosis::location::ErrorOf;
use crate::diagnosis::score::Score;
use crate::identification::output_error::FitError;
use crate::identification::torque_rows::Method;
use crate::plant::{Effect, Model};

/// Standard deviations from zero that a coefficient must have in training, and below which it may as well be zero.
const CERTAIN: f64 = 3.0;
const TOLD_FROM_ZERO: f64 = 2.0;

/// Refits the torque balance with `effect` added; refused, with the reason, where that does not pay on the hold-out.
pub fn add(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: &Evidence,
) -> Result<AddResult, FitError> {
    let (balance, before) = Balance::with_baseline(model, evidence)?;
    let rows = &balance.sides.training;
    let trial = with_effect(effect, &before.model, rows, &evidence.training);
    // Where it cannot be judged the answer is the model as it was.
    let after = trial.as_ref().unwrap_or(&before).clone();
    let [base, better] = [&before, &after].map(|fit| balance.held_out(fit, evidence));
    let physics = trial
        .as_ref()
        .ok()
        .and_then(|fit| refused(effect, fit, rows));
    let certain = after.certainty_of(effect.card().id) >= CERTAIN;
    let accepted = physics.is_none() && certain && pays(&base, &better, Settings::default());
    let mut result = change(effect, &balance, evidence, [&before, &after], accepted);
    let name = effect.card().name;
    let figures = both_processings(&result);
    let fall = fall_in_words(
        &base,
        &better,
        balance.scale.source.times(),
        Settings::default(),
    );
    let trained = after.rms() < (1.0 - WORTHWHILE) * before.rms();
    result.reason = match (&trial, physics) {
        (Err(reason), _) => format!("{name} cannot be judged from this run: {reason}"),
        (_, Some(reason)) => format!("{name}: {reason}; {figures}"),
        _ if accepted => format!("with {name} {fall}; {figures}"),
        _ if trained && better.nrms >= (1.0 - WORTHWHILE) * base.nrms => {
            format!("{name} helps only in training: {figures}")
        }
        _ => format!("{name} does not pay: {fall}; {figures}"),
    };
    if accepted {
        for id in superfluous(&after, &better, &balance, evidence, effect.card().id) {
            let is_superfluous = format!(
                "; {id} is superfluous now: without it the held-out error does not rise by more than 1 % or chance"
            );
            result.reason.push_str(&is_superfluous);
        }
    }
    result.parameters = own(&after, effect);
    Ok(result)
}

/// Refits the torque balance without `effect`; refused where the effect pays on the hold-out.
pub fn remove(
    effect: &'static dyn Effect,
    model: &Model,
    evidence: &Evidence,
) -> Result<AddResult, FitError> {
    let (balance, before) = Balance::with_baseline(model, evidence)?;
    let without = before.model.without_effect(effect.card().id)?;
    let after = balance.sides.fit(&without);
    let after = after.ok_or_else(|| FitError::CannotSimulate {
        run: evidence.training.name.clone(),
    })?;
    let [with, without] = [&before, &after].map(|fit| balance.held_out(fit, evidence));
    let accepted = !pays(&without, &with, Settings::default());
    let mut result = change(effect, &balance, evidence, [&before, &after], accepted);
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
    result.parameters = own(&before, effect);
    Ok(result)
}

impl Balance {
    fn held_out(&self, fit: &BalanceFit, evidence: &Evidence) -> Score {
        self.score(&fit.model, &self.sides.holdout, &evidence.noise)
    }
}

/// The effect's own parameters.
fn own(fit: &BalanceFit, effect: &dyn Effect) -> Vec<crate::sample::ParameterEstimate> {
    let prefix = format!("{}.", effect.card().id);
    let own = fit.parameters.iter().filter(|p| p.key.starts_with(&prefix));
    own.cloned().collect()
}

fn change(
    effect: &'static dyn Effect,
    balance: &Balance,
    evidence: &Evidence,
    [before, after]: [&BalanceFit; 2],
    accepted: bool,
) -> AddResult {
    let sides = &balance.sides;
    let rung = |fit: &BalanceFit, score: &Score| Rung {
        effects: fit.model.effect_ids(),
        holdout_rmse: score.nrms,
    };
    let confirm = sides.confirm.as_ref().map(|rows| {
        [before, after].map(|fit| rung(fit, &balance.score(&fit.model, rows, &evidence.noise)))
    });
    let reference = Sides::new(Method::InverseDynamics, &before.model, evidence).ok();
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
        let figures = figures(fit);
        comparison(&fit.model, balance, figures, evidence, ErrorOf::Structure)
    };
    AddResult {
        effect: effect.card().id,
        accepted,
        reason: String::new(),
        before: compared(before),
        after: compared(after),
        parameters: Vec::new(),
        ladder: [before, after]
            .map(|fit| rung(fit, &balance.held_out(fit, evidence)))
            .to_vec(),
        confirm,
        fit: balance.fitted(after, evidence),
    }
}

/// Effects that were in the model before and are not needed any more: their removal, with everything refitted, costs
/// nothing on the hold-out; or their size is not told from zero, and the hold-out does not miss them beyond chance.
fn superfluous(
    fit: &BalanceFit,
    score: &Score,
    balance: &Balance,
    evidence: &Evidence,
    added: &str,
) -> Vec<&'static str> {
    let settings = Settings::default();
    let mut ids = fit.model.effect_ids();
    ids.retain(|id| *id != added);
    ids.retain(|id| {
        let without = fit.model.without_effect(id).ok();
        let Some(without) = without.and_then(|model| balance.sides.fit(&model)) else {
            return false;
        };
        let without = balance.held_out(&without, evidence);
        let chance = z(&without, score, settings) < settings.significant;
        let costs_nothing = without.nrms < (1.0 + WORTHWHILE) * score.nrms;
        costs_nothing || (chance && fit.certainty_of(id) < TOLD_FROM_ZERO)
    });
    ids
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

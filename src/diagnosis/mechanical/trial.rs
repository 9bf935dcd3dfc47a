//! One effect beside the model: its forms tried on their grid, then refined, everything else free.

use super::regression::{self, BalanceFit};
use super::terms;
use crate::diagnosis::joint::asked::why_not;
use crate::identification::torque_rows::TorqueRows;
use crate::plant::{ActiveEffect, Effect, Model, MotorKey, ParameterRole, Scenario, Slot};
use crate::sample::Verdict;

/// The model with the effect, fitted to the rows; or why they cannot judge it.
pub(super) fn with_effect(
    effect: &'static dyn Effect,
    model: &Model,
    rows: &TorqueRows,
    scenario: &Scenario,
) -> Result<BalanceFit, String> {
    if let Some(reason) = why_not(effect, scenario) {
        return Err(reason.to_owned());
    }
    let id = Some(effect.card().id);
    let mut best: Option<(f64, Model)> = None;
    for values in terms::shape_grid(effect, rows) {
        let mut with = model.clone();
        let mut active = ActiveEffect::new(effect);
        for (index, spec) in effect.parameters().iter().enumerate() {
            if !spec.is_coefficient() {
                active.values[index] = Some(values[index]);
            }
        }
        with.effects.push(active);
        let cost = regression::cost(&with, id, rows);
        if cost.is_finite() && best.as_ref().is_none_or(|best| cost < best.0) {
            best = Some((cost, with));
        }
    }
    best.and_then(|(_, start)| regression::fit(&start, id, rows))
        .ok_or_else(|| "its terms are not known at the samples of this run".to_owned())
}

/// What physics does not allow: a brake that drives, or a motor that turns into one for the effect's sake.
pub(super) fn refused(effect: &dyn Effect, fit: &BalanceFit, rows: &TorqueRows) -> Option<String> {
    for key in [MotorKey::Inertia, MotorKey::LoadTorque] {
        let parameter = fit.parameters.iter().find(|p| p.key == key.key())?;
        if parameter.verdict == Verdict::Invalid {
            return Some(format!("it would make {} negative", key.key()));
        }
    }
    let active = fit
        .model
        .effects
        .iter()
        .find(|active| active.id() == effect.card().id)?;
    let values = active.values_or_guess();
    for (index, spec) in effect.parameters().iter().enumerate() {
        let wrong = spec.is_coefficient()
            && values[index] < 0.0
            && terms::only_takes_power(effect, &values, index, &rows.at);
        if wrong {
            return Some(format!(
                "with {} = {:.3e} {} it would drive the shaft: the sign is wrong",
                spec.key, values[index], spec.unit
            ));
        }
    }
    None
}

/// The model with every time of an event found anew in these rows.
pub(super) fn with_events_of(model: &Model, rows: &TorqueRows) -> Model {
    let mut model = model.clone();
    let slots: Vec<Slot> = model
        .slots()
        .into_iter()
        .filter(|slot| slot.has_role(ParameterRole::EventTime))
        .collect();
    for slot in slots {
        let Slot::Effect { spec, .. } = slot else {
            continue;
        };
        let cost = |model: &Model| -> f64 {
            let predicted = regression::predicted(model, rows);
            let pairs = rows.left.iter().zip(&predicted);
            pairs
                .map(|(left, predicted)| (left - predicted).powi(2))
                .sum()
        };
        let span_s = rows.time_s.last().unwrap_or(&0.0) - rows.time_s.first().unwrap_or(&0.0);
        let given = model.get(&slot);
        let tried: Vec<f64> = terms::event_times(spec.shapes, rows)
            .into_iter()
            .chain(given)
            .collect();
        let best = tried
            .into_iter()
            .map(|time_s| {
                model.set(&slot, time_s);
                (cost(&model), time_s)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((mut least, mut best_s)) = best else {
            continue;
        };
        let mut step_s = span_s / 24.0;
        for _ in 0..8 {
            for there_s in [best_s - step_s, best_s + step_s] {
                model.set(&slot, there_s.max(0.0));
                let found = cost(&model);
                if found < least {
                    (least, best_s) = (found, there_s.max(0.0));
                }
            }
            step_s *= 0.5;
        }
        model.set(&slot, best_s);
    }
    model
}

//! One candidate: its forms tried on their grid, then refined, everything else free; judged on held-out rows.

use rayon::prelude::*;

use super::regression::{self, BalanceFit, OnTrial};
use super::score::{Score, z};
use super::sides::Sides;
use super::terms::{self, Extra};
use crate::identification::torque_rows::TorqueRows;
use crate::plant::{
    ActiveEffect, Effect, Input, Model, MotorKey, ParameterRole, Scenario, Slot, effect,
    typical_size,
};
use crate::sample::{ParameterEstimate, Verdict};

/// Smallest reduction of the held-out error that is worth an effect.
pub(super) const WORTHWHILE: f64 = 0.01;
/// Standard deviations from zero that a coefficient must have in training.
const CERTAIN: f64 = 3.0;
/// Standard deviations at which an effect would have been seen.
const DETECTABLE: f64 = 5.0;

/// What a candidate is.
#[derive(Clone, Copy)]
pub(super) enum Of<'a> {
    Effect(&'static dyn Effect),
    Extra(&'a Extra),
}

impl Of<'_> {
    pub(super) fn id(&self) -> &'static str {
        match self {
            Self::Effect(effect) => effect.card().id,
            Self::Extra(extra) => extra.id,
        }
    }

    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Effect(effect) => effect.card().name,
            Self::Extra(extra) => extra.id,
        }
    }

    fn on_trial(&self) -> OnTrial<'_> {
        OnTrial {
            extra: self.extra(),
            effect: Some(self.id()),
        }
    }

    pub(super) const fn extra(&self) -> Option<&Extra> {
        match self {
            Self::Effect(_) => None,
            Self::Extra(extra) => Some(extra),
        }
    }
}

/// A candidate with its fit and its held-out error, or why it cannot be judged.
pub(super) struct Trial<'a> {
    pub(super) of: Of<'a>,
    pub(super) found: Result<Judged, String>,
}

pub(super) struct Judged {
    pub(super) fit: BalanceFit,
    pub(super) holdout: Score,
    /// Smallest size of its first coefficient that would have shown, and the size that would matter.
    pub(super) minimum_detectable: f64,
    pub(super) typical_size: f64,
    /// Why physics refuses what the fit found.
    pub(super) refused: Option<String>,
    pub(super) certainty: f64,
}

impl Trial<'_> {
    /// The effect's own parameters.
    pub(super) fn parameters(&self) -> Vec<ParameterEstimate> {
        let Ok(judged) = &self.found else {
            return Vec::new();
        };
        if let (Of::Extra(extra), Some((value, std))) = (self.of, judged.fit.extra) {
            return vec![ParameterEstimate {
                key: extra.id.to_owned(),
                value: Some(value),
                std: Some(std),
                unit: "",
                verdict: Verdict::Searching,
                reason: None,
            }];
        }
        let prefix = format!("{}.", self.of.id());
        let parameters = judged.fit.parameters.iter();
        parameters
            .filter(|parameter| parameter.key.starts_with(&prefix))
            .cloned()
            .collect()
    }

    /// Whether it pays on the hold-out beyond chance, with a size that is told from zero and that physics allows.
    pub(super) fn pays(&self, base: &Score, sides: &Sides) -> bool {
        self.found.as_ref().is_ok_and(|judged| {
            judged.refused.is_none()
                && judged.certainty >= CERTAIN
                && pays(base, &judged.holdout, sides)
        })
    }
}

/// Whether the second balance is better by more than chance, and by more than a hundredth.
pub(super) fn pays(base: &Score, better: &Score, sides: &Sides) -> bool {
    better.rmse <= (1.0 - WORTHWHILE) * base.rmse
        && z(base, better, sides.settings.block) >= sides.settings.significant
}

/// Every effect of the catalogue that `baseline` does not have, in parallel.
pub(super) fn all(
    baseline: &BalanceFit,
    sides: &Sides,
    scenario: &Scenario,
) -> Vec<Trial<'static>> {
    effect::CATALOGUE
        .par_iter()
        .filter(|effect| !baseline.model.has(effect.card().id))
        .map(|effect| of_effect(*effect, baseline, sides, scenario))
        .collect()
}

pub(super) fn of_effect(
    effect: &'static dyn Effect,
    baseline: &BalanceFit,
    sides: &Sides,
    scenario: &Scenario,
) -> Trial<'static> {
    let trial = |found| Trial {
        of: Of::Effect(effect),
        found,
    };
    if let Some(reason) = terms::why_not_judged(effect, scenario.input) {
        return trial(Err(reason));
    }
    let start = match best_form(effect, &baseline.model, scenario.input, &sides.training) {
        Ok(start) => start,
        Err(reason) => return trial(Err(reason)),
    };
    trial(judged(
        &start,
        Of::Effect(effect),
        baseline,
        sides,
        scenario,
    ))
}

pub(super) fn of_extra<'a>(
    extra: &'a Extra,
    baseline: &BalanceFit,
    sides: &Sides,
    scenario: &Scenario,
) -> Trial<'a> {
    let of = Of::Extra(extra);
    Trial {
        of,
        found: judged(&baseline.model, of, baseline, sides, scenario),
    }
}

/// The model with the effect in the form of its grid that leaves the least.
fn best_form(
    effect: &'static dyn Effect,
    model: &Model,
    input: Input,
    rows: &TorqueRows,
) -> Result<Model, String> {
    let order = effect
        .parameters()
        .iter()
        .position(|spec| spec.key == "order");
    let mut best: Option<(f64, Model)> = None;
    let mut moved_enough = false;
    for values in terms::shape_grid(effect, rows) {
        let periods = order.map_or(1.0, |order| values[order]);
        if effect.card().needs_angle && !terms::travels(rows, periods) {
            continue;
        }
        moved_enough = true;
        let mut with = model.clone();
        let mut active = ActiveEffect::new(effect);
        for (index, spec) in effect.parameters().iter().enumerate() {
            if !spec.is_coefficient() {
                active.values[index] = Some(values[index]);
            }
        }
        with.effects.push(active);
        let cost = regression::cost(&with, Of::Effect(effect).on_trial(), rows);
        if cost.is_finite() && best.as_ref().is_none_or(|best| cost < best.0) {
            best = Some((cost, with));
        }
    }
    best.map(|best| best.1).ok_or_else(|| {
        if effect.card().needs_angle && !moved_enough {
            "the shaft moves through less than half a period of it".to_owned()
        } else if input == Input::Torque {
            "it needs a signal that the run does not have".to_owned()
        } else {
            "its terms are not known at the samples of this run".to_owned()
        }
    })
}

fn judged(
    start: &Model,
    of: Of<'_>,
    baseline: &BalanceFit,
    sides: &Sides,
    scenario: &Scenario,
) -> Result<Judged, String> {
    let fit = regression::fit(start, of.on_trial(), &sides.training)
        .ok_or_else(|| "its terms are not known at the samples of this run".to_owned())?;
    let holdout = sides.held_out(&fit, of.extra());
    if !holdout.rmse.is_finite() {
        return Err("its terms are not known at the samples of the hold-out".to_owned());
    }
    let (std, certainty, typical) = match of {
        Of::Effect(effect) => {
            let first = &effect.parameters()[0];
            let key = format!("{}.{}", effect.card().id, first.key);
            let parameter = fit.parameters.iter().find(|p| p.key == key);
            (
                parameter.and_then(|p| p.std),
                fit.certainty_of(effect.card().id),
                typical_size(effect, 0, &baseline.model, scenario),
            )
        }
        Of::Extra(_) => {
            let (size, std) = fit.extra.unwrap_or((0.0, f64::NAN));
            (Some(std), (size / std).abs(), f64::NAN)
        }
    };
    Ok(Judged {
        minimum_detectable: std.map_or(f64::INFINITY, |std| DETECTABLE * std),
        typical_size: typical,
        refused: refused(of, &fit, &sides.training),
        certainty,
        fit,
        holdout,
    })
}

/// What physics does not allow: a brake that drives, or a motor that turns into one for the effect's sake.
fn refused(of: Of<'_>, fit: &BalanceFit, rows: &TorqueRows) -> Option<String> {
    for key in [MotorKey::Inertia, MotorKey::LoadTorque] {
        let parameter = fit.parameters.iter().find(|p| p.key == key.key())?;
        if parameter.verdict == Verdict::Invalid {
            return Some(format!("it would make {} negative", key.key()));
        }
    }
    let Of::Effect(effect) = of else { return None };
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
        let cost = |model: &Model| Score::of(&regression::predicted(model, None, rows), rows).rmse;
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

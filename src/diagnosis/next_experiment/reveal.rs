//! The run that shows what the runs in hand would not have shown.

use rayon::prelude::*;

use super::limits::ExperimentLimits;
use super::menu::COUNT;
use super::planned::{Planned, planned};
use super::rival::Rival;
use super::separation::Response;
use super::{MenuEntry, NextExperiment, SEPARATED, words};
use crate::diagnosis::Evidence;
use crate::identification::output_error::FitError;
use crate::plant::{ActiveEffect, Model, effect, typical_size};

/// The run in which most of `unseen` would show at their typical size, against a baseline that is fitted again.
pub(super) fn reveal(
    baseline: &Model,
    unseen: &[&'static str],
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Result<Option<NextExperiment>, FitError> {
    let truths: Vec<(&'static str, Model)> = unseen
        .iter()
        .filter_map(|id| Some((*id, with_typical(baseline, id, evidence)?)))
        .collect();
    if truths.is_empty() {
        return Ok(None);
    }
    let rival = Rival::new(baseline, evidence)?;
    let mut models = vec![baseline];
    models.extend(truths.iter().map(|(_, model)| model));
    let mut tried: Vec<(Planned, Vec<f64>)> = (0..COUNT)
        .into_par_iter()
        .filter_map(|index| {
            let plan = planned(index, &models, limits)?;
            let shown = shown(&plan, &rival, &truths, evidence)?;
            Some((plan, shown))
        })
        .collect();
    let count = |shown: &[f64]| shown.iter().filter(|value| **value >= SEPARATED).count();
    let total = |shown: &[f64]| shown.iter().map(|value| (1.0 + value).ln()).sum::<f64>();
    tried.sort_by(|a, b| {
        let fewer = count(&b.1).cmp(&count(&a.1));
        fewer.then(total(&b.1).total_cmp(&total(&a.1)))
    });
    let weakest = |shown: &[f64]| {
        shown
            .iter()
            .copied()
            .filter(|value| *value >= SEPARATED)
            .fold(f64::INFINITY, f64::min)
    };
    let menu = tried
        .iter()
        .map(|(plan, shown)| MenuEntry {
            program: plan.recipe.id,
            expected_separation: shown.iter().copied().fold(0.0, f64::max),
            needed: SEPARATED,
        })
        .collect();
    let Some((plan, shown)) = tried.first() else {
        return Ok(None);
    };
    let reveals: Vec<&'static str> = truths
        .iter()
        .zip(shown)
        .filter(|(_, value)| **value >= SEPARATED)
        .map(|((id, _), _)| *id)
        .collect();
    let hidden: Vec<&'static str> = truths
        .iter()
        .map(|(id, _)| *id)
        .filter(|id| !reveals.contains(id))
        .collect();
    let found = !reveals.is_empty();
    Ok(Some(NextExperiment {
        sentence: words::reveals(plan, &reveals, &hidden),
        bench: None,
        pair: None,
        pairs: Vec::new(),
        expected_separation: if found {
            weakest(shown)
        } else {
            shown.iter().copied().fold(0.0, f64::max)
        },
        menu,
        peaks: found.then_some(plan.peaks),
        recipe: found.then(|| plan.recipe.clone()),
        reveals,
    }))
}

/// How far the refitted baseline stays from each truth.
fn shown(
    plan: &Planned,
    rival: &Rival<'_>,
    truths: &[(&'static str, Model)],
    evidence: &Evidence,
) -> Option<Vec<f64>> {
    let (own, noise) = (plan.measured(rival.model)?, plan.noise(evidence.noise));
    let (response, _) = Response::of(rival, &own, noise)?;
    truths
        .iter()
        .map(|(_, truth)| {
            let run = plan.measured(truth)?;
            let separation = response.separation_from(&run, rival, noise)? / rival.inflation;
            Some(if separation.is_finite() {
                separation
            } else {
                0.0
            })
        })
        .collect()
}

/// The model with the effect at its typical size, its shapes at their guesses.
fn with_typical(baseline: &Model, id: &str, evidence: &Evidence) -> Option<Model> {
    let effect = effect::find(id)?;
    let values = (0..effect.parameters().len())
        .map(|index| Some(typical_size(effect, index, baseline, &evidence.training)))
        .collect();
    let mut model = baseline.clone();
    model.effects.push(ActiveEffect { effect, values });
    model.require_complete().ok()?;
    Some(model)
}

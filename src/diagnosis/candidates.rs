//! One candidate effect: screened, refitted with everything else free, scored on data that the fit has not seen.

use rayon::prelude::*;
use serde::{Serialize, Serializer, ser::SerializeMap};

use super::evidence::Evidence;
use super::score::Score;
use super::screen::Screen;
use crate::identification::output_error::{self, Fit, FitError};
use crate::plant::{ActiveEffect, Effect, Model, effect};
use crate::sample::ParameterEstimate;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Pays on the hold-out beyond chance and is in the answer.
    Supported,
    /// Pays on the hold-out, but less than the answer; or could be told from it only by another run.
    Possible,
    /// Was visible in this run and does not pay.
    RuledOut,
    /// This run would not show it even at its typical size.
    NotExcited,
}

/// What is reported of one effect.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    pub effect: &'static str,
    pub rank: usize,
    pub status: Status,
    /// Share of seeded block bootstraps of the hold-out in which it ranks first.
    pub probability: f64,
    #[serde(serialize_with = "by_key")]
    pub parameters: Vec<ParameterEstimate>,
    /// Training error before and after, in units of the noise.
    pub error_before: f64,
    pub error_after: f64,
    pub holdout_before: f64,
    pub holdout_after: f64,
    pub explained_percent: f64,
    /// Smallest size of its first parameter that this run would have shown.
    pub minimum_detectable: f64,
    pub evidence: String,
}

/// Parameters as a JSON object by their key.
pub(super) fn by_key<S: Serializer>(
    parameters: &[ParameterEstimate],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(parameters.len()))?;
    for parameter in parameters {
        map.serialize_entry(
            parameter.key.rsplit('.').next().unwrap_or(&parameter.key),
            parameter,
        )?;
    }
    map.end()
}

/// A candidate's refit with its scores.
pub(super) struct Refit {
    pub(super) effect: &'static dyn Effect,
    pub(super) fit: Fit,
    pub(super) holdout: Score,
    pub(super) minimum_detectable: f64,
    pub(super) typical_size: f64,
    pub(super) free_parameters: usize,
}

impl Refit {
    pub(super) fn id(&self) -> &'static str {
        self.effect.card().id
    }

    /// The effect's own parameters.
    pub(super) fn parameters(&self) -> Vec<ParameterEstimate> {
        let prefix = format!("{}.", self.id());
        self.fit
            .parameters
            .iter()
            .filter(|parameter| parameter.key.starts_with(&prefix))
            .cloned()
            .collect()
    }
}

/// Screens and refits every effect that `baseline` does not have, two starts each, in parallel.
pub(super) fn refit_all(
    evidence: &Evidence,
    baseline: &Fit,
    original: &Model,
) -> Result<Vec<Refit>, FitError> {
    let screen = Screen::new(baseline, &evidence.training);
    let refits: Vec<Result<Refit, FitError>> = effect::CATALOGUE
        .par_iter()
        .filter(|effect| !baseline.model.has(effect.card().id))
        .map(|effect| refit(evidence, &screen, *effect, baseline, original))
        .collect();
    // One effect that cannot be simulated on this motor must not hide the others; if none can, that is the answer.
    let mut failure = None;
    let mut done = Vec::new();
    for refit in refits {
        match refit {
            Ok(refit) => done.push(refit),
            Err(error) => failure = Some(error),
        }
    }
    match failure {
        Some(error) if done.is_empty() => Err(error),
        _ => Ok(done),
    }
}

fn refit(
    evidence: &Evidence,
    screen: &Screen<'_>,
    effect: &'static dyn Effect,
    baseline: &Fit,
    original: &Model,
) -> Result<Refit, FitError> {
    let screened = screen.effect(effect)?;
    let with = |model: &Model, active: ActiveEffect| {
        let mut model = model.clone();
        model.effects.push(active);
        model
    };
    // Start (a): the baseline's fit and what the screen found. Start (b): the model as it was given, with the effect
    // at its typical size, because the missing effect has distorted the baseline's fit (DISCOVERY.md, pitfall 7).
    let mut starts = vec![with(&baseline.model, screened.start)];
    if original.require_complete().is_ok() {
        starts.push(with(original, ActiveEffect::new(effect)));
    }
    let fit = output_error::fit(&starts, &evidence.training, &evidence.noise)?;
    let holdout = Score::of(&fit.model, &evidence.holdout, &evidence.noise)?;
    let free_parameters = fit.free.len();
    Ok(Refit {
        effect,
        fit,
        holdout,
        minimum_detectable: screened.minimum_detectable,
        typical_size: screened.typical_size,
        free_parameters,
    })
}

//! One effect added to a model and everything refitted, from two starts: a missing effect distorts the baseline's fit.

use super::evidence::Evidence;
use super::screen::{Screen, Screened};
use crate::identification::output_error::{self, Fit, FitError};
use crate::plant::{ActiveEffect, Effect, Model};

/// One effect from both starts, to the full. `original` is the model before any fit.
pub(super) fn refit_one(
    evidence: &Evidence,
    baseline: &Fit,
    original: &Model,
    effect: &'static dyn Effect,
) -> Result<Fit, FitError> {
    let candidate = Screen::new(baseline, &evidence.training).effect(effect)?;
    let from = |start: &Model| {
        output_error::fit(
            std::slice::from_ref(start),
            &evidence.training,
            &evidence.noise,
        )
    };
    match second_start(&candidate, baseline, original) {
        Some(second) => {
            let (a, b) = rayon::join(|| from(&candidate.start), || from(&second));
            better(a, b)
        }
        None => from(&candidate.start),
    }
}

/// The model as it was given, with what has been accepted since and the effect as the screen found its shape.
fn second_start(candidate: &Screened, baseline: &Fit, original: &Model) -> Option<Model> {
    original.require_complete().ok()?;
    let mut start = original.clone();
    for active in &baseline.model.effects {
        if !start.has(active.id()) {
            start.effects.push(active.clone());
        }
    }
    let screened = candidate.start.effects.last()?;
    let specs = candidate.effect.parameters();
    let values = screened
        .values
        .iter()
        .zip(specs)
        .map(|(value, spec)| if spec.is_coefficient() { None } else { *value })
        .collect();
    start.effects.push(ActiveEffect {
        effect: candidate.effect,
        values,
    });
    Some(start)
}

fn better(a: Result<Fit, FitError>, b: Result<Fit, FitError>) -> Result<Fit, FitError> {
    match (a, b) {
        (Ok(a), Ok(b)) if b.minimum.cost < a.minimum.cost => Ok(b),
        (Ok(a), _) => Ok(a),
        (Err(_), b) => b,
    }
}

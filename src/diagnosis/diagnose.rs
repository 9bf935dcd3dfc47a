//! Which effects are missing: what the runs say together, and how the held-out error falls with each.

use serde::Serialize;

use rayon::prelude::*;

use super::axis_map::{AxisMap, axis_map};
use super::bench::{Bench, beside};
use super::candidates::{Candidate, Status};
use super::confirmation::{self, Confirmation};
use super::describe::{describe, sentence, superfluous};
use super::evidence::{Evidence, HoldoutFrom};
use super::explained;
use super::fitted::Fitted;
use super::joint::answer::{Inference, Part, asked, refined};
use super::ladder::Rung;
use super::location::FailureLocation;
use super::next_experiment::{NextExperiment, equivalences};
use super::progress::{Event, Progress, Stage, silent};
use super::repeatability::Repeatability;
use super::score::Score;
use crate::identification::noise::FloorSource;
use crate::identification::output_error::FitError;
use crate::plant::Model;
use crate::plant::effect::CATALOGUE;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DiagnosisVerdict {
    Effect,
    Ambiguous,
    None,
    Unexplained,
}

/// The answer, as `diagnose --json` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    pub verdict: DiagnosisVerdict,
    pub effect: Option<&'static str>,
    pub effects: Vec<&'static str>,
    pub sufficient: bool,
    pub noise_floor_from: FloorSource,
    /// The sensors' noise, which is one where it is known: the unit of the errors.
    pub sensor_floor: Option<f64>,
    /// What differs between two runs of the same excitation under the model with all named effects, in the same unit.
    pub repeat_floor: Option<f64>,
    /// Whether that is little more than the sensors' noise; null without a repeated run.
    pub repeats: Option<bool>,
    /// What it follows where it is more; the most first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub repeat_follows: Vec<FailureLocation>,
    pub holdout_from: HoldoutFrom,
    /// Of the whole accepted set, on the hold-out.
    pub explained_percent: f64,
    pub holdout_before: f64,
    pub holdout_after: f64,
    pub candidates: Vec<Candidate>,
    /// What no effect explains, by what it follows.
    pub unknown: Vec<Unknown>,
    /// Pairs that these runs do not tell apart, the one in the answer first.
    pub confusable: Vec<[&'static str; 2]>,
    pub ladder: Vec<Rung>,
    /// Along which axis the error runs, and as what curve, where no effect explains it; the clearest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub axis_map: Vec<AxisMap>,
    /// The answer on a run that had no part in it, where there is one: the headline.
    pub confirm: Option<Confirmation>,
    /// One sentence for a person.
    pub sentence: String,
    /// What could not be asked of these runs, and why.
    pub limits: Vec<String>,
    /// What the named effects cannot be told from by any run.
    pub equivalences: Vec<&'static str>,
    /// The run that would tell more; left to those who know the bench ([`recommend`](super::recommend)).
    pub next_experiment: Option<NextExperiment>,
    /// The refitted baseline and the model with every accepted effect.
    #[serde(skip)]
    pub baseline: Fitted,
    #[serde(skip)]
    pub model: Fitted,
    /// For each confusable pair the model with its second effect in the place of the first, where a fit begins.
    #[serde(skip)]
    pub rivals: Vec<Model>,
}

impl Diagnosis {
    /// Whether the run that had no part in the answer speaks against it.
    pub fn is_refuted(&self) -> bool {
        let confirm = self.confirm.as_ref();
        confirm.is_some_and(|confirm| confirm.confirmed == Some(false))
    }
}

/// A part of the error that follows something and that no effect of the catalogue explains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unknown {
    pub equation: &'static str,
    pub follows: &'static str,
    pub probability: f64,
    pub share_of_error: f64,
    pub sentence: String,
}

impl From<&Part> for Unknown {
    fn from(part: &Part) -> Self {
        let axis = match part.follows {
            "angle_rad" => "the angle of the shaft",
            "current_a" => "the current",
            _ => "the speed",
        };
        let percent = 100.0 * part.share;
        Self {
            equation: part.equation,
            follows: part.follows,
            probability: part.probability,
            share_of_error: part.share,
            sentence: format!(
                "{percent:.0} % of the error: an unknown {} that follows {axis}",
                part.equation
            ),
        }
    }
}

/// Refits `model` as the baseline and searches for what it misses, with nobody watching.
pub fn diagnose(model: &Model, evidence: Evidence) -> Result<Diagnosis, FitError> {
    diagnose_with(model, evidence, &silent)
}

/// Refits `model` as the baseline and searches for what it misses.
pub fn diagnose_with(
    model: &Model,
    evidence: Evidence,
    progress: Progress<'_>,
) -> Result<Diagnosis, FitError> {
    progress(Event::Begun {
        stage: Stage::Baseline,
        of: 0,
    });
    let (bench, baseline) = Bench::new(model, evidence)?;
    progress(Event::Begun {
        stage: Stage::Screen,
        of: CATALOGUE.len(),
    });
    let asked = asked(&baseline.model, None);
    let mut inference = bench.ask(&baseline, &asked, progress)?;
    progress(Event::Begun {
        stage: Stage::Refit,
        of: inference.named.len(),
    });
    let mut rungs = climb(&bench, baseline.clone(), &inference, progress)?;
    while let Some(id) =
        without_size(&inference, &rungs).or_else(|| by_chance(&bench, &inference, &rungs))
    {
        inference.doubt(id);
        rungs = climb(&bench, baseline.clone(), &inference, progress)?;
    }
    Ok(answer(&bench, &inference, &rungs))
}

/// A model on the ladder, fitted to the fit run alone, and its score on the hold-out.
pub(super) struct Standing {
    pub(super) fit: Fitted,
    pub(super) score: Score,
}

impl Standing {
    fn of(fit: Fitted, bench: &Bench) -> Result<Self, FitError> {
        let score = bench.held_out(&fit.model)?;
        Ok(Self { fit, score })
    }

    /// With the parameters that prediction errors give, unless they do not foretell the hold-out. A balance of torques has
    /// no free run that a load could lead astray.
    pub(super) fn handed_on(
        fit: Fitted,
        bench: &Bench,
        inference: &Inference,
    ) -> Result<Self, FitError> {
        let free = Self::of(fit, bench)?;
        if bench.fits_at_once() {
            return Ok(free);
        }
        let led = refined(free.fit.clone(), &bench.evidence.training, inference.noise);
        let led = Self::of(led, bench)?;
        Ok(if led.score.nrms > AS_GOOD * free.score.nrms {
            free
        } else {
            led
        })
    }
}

/// Growth of the held-out error from which on parameters that were found along the run do not foretell another one.
const AS_GOOD: f64 = 1.02;

/// The baseline and one named effect more on each rung, what explains most first; the parameters of the last are those that
/// are handed on.
fn climb(
    bench: &Bench,
    baseline: Fitted,
    inference: &Inference,
    progress: Progress<'_>,
) -> Result<Vec<Standing>, FitError> {
    let last = inference.named.len();
    let on_rung = |place: usize, fit: Fitted| {
        if place < last {
            Standing::of(fit, bench)
        } else {
            Standing::handed_on(fit, bench, inference)
        }
    };
    let bare = baseline.model.clone();
    let climbed: Vec<Standing> = (0..last)
        .into_par_iter()
        .with_max_len(1)
        .map(|place| {
            let start = beside(&bare, inference, &inference.named[..=place])?;
            let fitted = if place + 1 < last {
                bench.fit_in_passing(&start)
            } else {
                bench.fit(&start)
            };
            // Where much else is missing a free run is fitted by what is no machine: what was found along the run is.
            let stands = fitted.and_then(|fit| on_rung(place + 1, fit));
            stands.or_else(|_| on_rung(place + 1, bench.as_it_is(&start)?))
        })
        .collect::<Result<_, FitError>>()?;
    let mut rungs = vec![on_rung(0, baseline)?];
    for (effect, rung) in inference.named.iter().zip(climbed) {
        progress(Event::Refitted {
            effect,
            error: rung.fit.nrms,
        });
        progress(Event::Accepted {
            effect,
            holdout: rung.score.nrms,
        });
        rungs.push(rung);
    }
    Ok(rungs)
}

/// The last named effect of which the fit with all of them does not tell whether it is there at all.
fn without_size(inference: &Inference, rungs: &[Standing]) -> Option<&'static str> {
    let fit = &rungs.last()?.fit;
    let mut named = inference.named.iter().rev().copied();
    named.find(|id| fit.is_told_from_zero(id, A_SIZE_SIGMAS) == Some(false))
}

/// Standard deviations below which a size in a free run may as well be zero: the names have been weighed already.
const A_SIZE_SIGMAS: f64 = 1.0;

/// The last named effect that takes no more from the errors on both runs than chance does, where the baseline itself is at
/// the floor.
fn by_chance(bench: &Bench, inference: &Inference, rungs: &[Standing]) -> Option<&'static str> {
    let evidence = &bench.evidence;
    let base = rungs.first()?.score.nrms;
    if bench.fits_at_once() || !inference.floor(evidence).is_reached(base) {
        return None;
    }
    let on_both = |rung: &Standing| {
        let fitted = Score::of(&rung.fit.model, &evidence.training, &evidence.noise).ok()?;
        Some(fitted.deviance() + rung.score.deviance())
    };
    let deviances: Option<Vec<f64>> = rungs.iter().map(on_both).collect();
    let place = takes_nothing(&deviances?)?;
    inference.named.get(place).copied()
}

/// The last step down a ladder that is no longer than chance makes it.
fn takes_nothing(deviances: &[f64]) -> Option<usize> {
    let mut steps = deviances.windows(2);
    steps.rposition(|pair| pair[0] - pair[1] < BY_CHANCE)
}

/// What a size that may be anything, at a time that may be any, takes from a deviance by chance at most.
const BY_CHANCE: f64 = 10.0;

fn answer(bench: &Bench, inference: &Inference, rungs: &[Standing]) -> Diagnosis {
    let evidence = &bench.evidence;
    let (base, best) = (&rungs[0], &rungs[rungs.len() - 1]);
    let floor = inference.floor(evidence);
    let repeatability = Repeatability::of(&best.fit.model, evidence, inference.noise);
    let in_motion = repeatability.in_motion();
    let verdict = verdict(bench, inference, [&base.score, &best.score], in_motion);
    let axis_map = if verdict == DiagnosisVerdict::Unexplained {
        // The maps are a help; without them the verdict stands.
        axis_map(&best.fit.model, &evidence.training, &evidence.noise).unwrap_or_default()
    } else {
        Vec::new()
    };
    let eta = floor.explained(base.score.nrms, best.score.nrms);
    let settled = floor.is_reached(best.score.nrms);
    let candidates = describe(evidence, floor, inference, rungs);
    let excited = candidates
        .iter()
        .any(|candidate| candidate.status != Status::NotExcited);
    let named = &inference.named;
    let unknown = inference.unknown.iter().map(Unknown::from).collect();
    let mut diagnosis = Diagnosis {
        verdict,
        effect: named.first().copied(),
        effects: named.clone(),
        sufficient: match verdict {
            // Without a floor, or in a run that would show nothing, nobody knows whether something is missing.
            DiagnosisVerdict::None => evidence.noise.source != FloorSource::None && excited,
            DiagnosisVerdict::Unexplained => false,
            _ => eta >= explained::SUFFICIENT || settled,
        },
        noise_floor_from: evidence.noise.source,
        sensor_floor: (evidence.noise.source == FloorSource::Standstill).then_some(1.0),
        repeat_floor: repeatability.floor,
        repeats: repeatability.repeats(),
        repeat_follows: repeatability.follows,
        holdout_from: evidence.holdout_from,
        explained_percent: if named.is_empty() { 0.0 } else { 100.0 * eta },
        holdout_before: base.score.nrms,
        holdout_after: best.score.nrms,
        candidates,
        unknown,
        confusable: inference.confusable.clone(),
        axis_map,
        ladder: rungs
            .iter()
            .map(|rung| Rung {
                effects: rung.fit.model.effect_ids(),
                holdout_rmse: rung.score.nrms,
            })
            .collect(),
        confirm: None,
        sentence: String::new(),
        limits: bench
            .limits()
            .into_iter()
            .chain(inference.lost_rows(floor))
            .chain(repeatability.why_not)
            .collect(),
        equivalences: Vec::new(),
        next_experiment: None,
        baseline: base.fit.clone(),
        model: best.fit.clone(),
        rivals: rivals(inference, &base.fit.model.effect_ids()),
    };
    diagnosis.confirm = confirmation::of_models(
        bench,
        [&diagnosis.baseline.model, &diagnosis.model.model],
        inference.noise,
        verdict,
        &diagnosis.effects,
        in_motion,
    );
    diagnosis.sufficient &= !(verdict == DiagnosisVerdict::None && diagnosis.is_refuted());
    diagnosis.sentence = sentence(&diagnosis);
    diagnosis.sentence += &superfluous(inference);
    let named = diagnosis.effects.iter();
    diagnosis.equivalences = named.flat_map(|id| equivalences(id)).copied().collect();
    diagnosis
}

/// Models with the second effect of each confusable pair in the place of the first.
fn rivals(inference: &Inference, given: &[&'static str]) -> Vec<Model> {
    let pairs = inference.confusable.iter();
    let models = pairs.filter_map(|[first, second]| {
        let others = inference
            .named
            .iter()
            .filter(|id| *id != first && *id != second);
        let with: Vec<&'static str> = given
            .iter()
            .chain(others)
            .copied()
            .chain([*second])
            .collect();
        inference.with_effects(&with)
    });
    models.collect()
}

/// Share of the explainable error that unknown parts and what wanders may make beside what is named.
const HALF: f64 = 0.5;
/// How many times as large as white noise what a set leaves of the innovations may be where a free run is left aside.
const NEARLY_WHITE: f64 = 1.3;

fn verdict(
    bench: &Bench,
    inference: &Inference,
    [base, best]: [&Score; 2],
    in_motion: f64,
) -> DiagnosisVerdict {
    let evidence = &bench.evidence;
    let is_known = evidence.noise.source != FloorSource::None;
    let floor = inference.floor(evidence);
    let at_floor = floor.is_reached(base.nrms / in_motion);
    let Some(first) = inference.named.first() else {
        return if inference.unknown.is_empty() && (at_floor || !is_known) {
            DiagnosisVerdict::None
        } else {
            DiagnosisVerdict::Unexplained
        };
    };
    let above = |nrms: f64| nrms * nrms - floor.highest().powi(2);
    let unknown: f64 = inference.unknown.iter().map(|part| part.share).sum();
    let explainable = above(base.nrms).max(0.0);
    let unexplained = inference.wandering.powi(2) + unknown * explainable;
    // A free run that falls into step a moment late is far off though nothing is missing: one of the two will do, but
    // names that take nothing from its error, or leave innovations that are not white, are no answer.
    let is_led_astray = !bench.fits_at_once()
        && inference.excess() < NEARLY_WHITE
        && unexplained <= HALF * explainable
        && floor.is_explained_in_part(base.nrms, best.nrms);
    if !is_led_astray && !at_floor && above(best.nrms) > HALF * explainable {
        DiagnosisVerdict::Unexplained
    } else if inference.confusable.iter().any(|pair| pair[0] == *first) {
        DiagnosisVerdict::Ambiguous
    } else {
        DiagnosisVerdict::Effect
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_that_chance_makes_is_none() {
        // 2,400 readings: an error of 1.0007 floors that becomes 1.0005, and one of 1.02 that becomes 1.
        let of = |nrms: f64| 2400.0 * nrms * nrms;
        assert_eq!(takes_nothing(&[of(1.0007), of(1.0005)]), Some(0));
        assert_eq!(takes_nothing(&[of(1.02), of(1.0)]), None);
        assert_eq!(
            takes_nothing(&[of(1.05), of(1.0499), of(1.02), of(1.0199)]),
            Some(2)
        );
        assert_eq!(takes_nothing(&[of(1.05), of(1.06), of(1.02)]), Some(0));
        assert_eq!(takes_nothing(&[of(1.0)]), None);
    }
}

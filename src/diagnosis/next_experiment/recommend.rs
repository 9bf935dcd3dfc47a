//! The menu tried on the rivals, and the best of it.

use rayon::prelude::*;

use super::limits::ExperimentLimits;
use super::menu::{COUNT, Recipe};
use super::planned::{Planned, planned};
use super::reveal::reveal;
use super::rival::Rival;
use super::separation::{linear, refitted};
use super::{MenuEntry, NextExperiment, SEPARATED, words};
use crate::diagnosis::Settings;
use crate::diagnosis::refit::refit_one;
use crate::diagnosis::{Diagnosis, DiagnosisVerdict, Evidence, Status};
use crate::identification::output_error::{self, FitError};
use crate::plant::{Input, Model, effect};

/// Pairs that one run is asked to tell apart.
const MOST_PAIRS: usize = 3;
/// Runs of the menu whose separation is found with a full refit of the rival.
const FINALISTS: usize = 3;

/// Two models that the runs in hand do not tell apart.
struct Pair<'a> {
    names: [&'static str; 2],
    rivals: [Rival<'a>; 2],
}

impl Pair<'_> {
    /// Factor by which the squared errors of the better rival count less than white noise.
    fn inflation(&self) -> f64 {
        self.rivals[0].inflation.min(self.rivals[1].inflation)
    }
}

/// How a separation is found.
type Measure = fn(
    &crate::plant::Scenario,
    &Rival<'_>,
    crate::identification::noise::NoiseFloor,
) -> Option<f64>;

/// The run after this diagnosis: for the pairs that it could not tell apart, else, where nothing was found, for what the
/// runs did not excite. `None` where there is nothing to ask, or no voltage to ask it with. `original` is the model
/// before any fit.
pub fn recommend(
    diagnosis: &Diagnosis,
    original: &Model,
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Result<Option<NextExperiment>, FitError> {
    if evidence.training.input != Input::Voltage {
        return Ok(None);
    }
    let evidence = &Evidence {
        noise: diagnosis.model.noise,
        ..evidence.clone()
    };
    if diagnosis.confusable.is_empty() {
        if diagnosis.verdict != DiagnosisVerdict::None {
            return Ok(None);
        }
        let unseen: Vec<&'static str> = diagnosis
            .candidates
            .iter()
            .filter(|candidate| candidate.status == Status::NotExcited)
            .map(|candidate| candidate.effect)
            .collect();
        return reveal(&diagnosis.baseline.model, &unseen, evidence, limits);
    }
    let mut others = Vec::new();
    for names in diagnosis.confusable.iter().take(MOST_PAIRS) {
        let Some(rival) = effect::find(names[1]) else {
            continue;
        };
        let without = diagnosis.model.model.without_effect(names[0])?;
        let base = output_error::fit(&[without], &evidence.training, &evidence.noise)?;
        let refit = refit_one(evidence, &base, original, rival, Settings::default())?;
        others.push((*names, refit.fit.model));
    }
    let pairs = others
        .iter()
        .map(|(names, other)| pair(*names, [&diagnosis.model.model, other], evidence))
        .collect::<Result<Vec<Pair<'_>>, FitError>>()?;
    Ok(tell_apart(&pairs, evidence, limits))
}

/// The run that separates two fitted models best, within the limits. `evidence` is what both were fitted to, with the
/// noise that its baseline left ([`Evidence::with_baseline`]).
pub fn next_experiment(
    rivals: [&Model; 2],
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Result<Option<NextExperiment>, FitError> {
    let own = |model: &Model, other: &Model| {
        let mut ids = model.effect_ids().into_iter().rev();
        ids.find(|id| !other.has(id)).unwrap_or("baseline")
    };
    let names = [own(rivals[0], rivals[1]), own(rivals[1], rivals[0])];
    let pair = pair(names, rivals, evidence)?;
    Ok(tell_apart(&[pair], evidence, limits))
}

/// Every recipe of the menu that this model can run within the limits.
pub fn menu_within(model: &Model, evidence: &Evidence, limits: &ExperimentLimits) -> Vec<Recipe> {
    (0..COUNT)
        .filter_map(|index| planned(index, &[model], &evidence.training, limits))
        .map(|plan| plan.recipe)
        .collect()
}

fn pair<'a>(
    names: [&'static str; 2],
    models: [&'a Model; 2],
    evidence: &Evidence,
) -> Result<Pair<'a>, FitError> {
    let [a, b] = models;
    Ok(Pair {
        names,
        rivals: [Rival::new(a, evidence)?, Rival::new(b, evidence)?],
    })
}

fn tell_apart(
    pairs: &[Pair<'_>],
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Option<NextExperiment> {
    let models: Vec<&Model> = pairs
        .iter()
        .flat_map(|pair| pair.rivals.iter().map(|rival| rival.model))
        .collect();
    let plans: Vec<Planned> = (0..COUNT)
        .into_par_iter()
        .filter_map(|index| planned(index, &models, &evidence.training, limits))
        .collect();
    let measured = |plan: &Planned, measure: Measure| -> Vec<f64> {
        pairs
            .par_iter()
            .map(|pair| separation(plan, pair, evidence, measure))
            .collect()
    };
    let mut tried: Vec<(&Planned, Vec<f64>)> = plans
        .par_iter()
        .map(|plan| (plan, measured(plan, linear)))
        .collect();
    tried.sort_by(|a, b| merit(&b.1).total_cmp(&merit(&a.1)));
    let menu = tried
        .iter()
        .map(|(plan, separations)| MenuEntry {
            program: plan.recipe.id,
            expected_separation: smallest(separations),
        })
        .collect();
    let (plan, separations) = tried
        .par_iter()
        .take(FINALISTS)
        .map(|(plan, _)| (*plan, measured(plan, refitted)))
        .collect::<Vec<_>>()
        .into_iter()
        .max_by(|a, b| merit(&a.1).total_cmp(&merit(&b.1)))?;
    let separable = separations.iter().any(|value| *value >= SEPARATED);
    let named: Vec<([&'static str; 2], f64)> = pairs
        .iter()
        .map(|pair| pair.names)
        .zip(separations.iter().copied())
        .collect();
    let first = named
        .iter()
        .find(|(_, value)| *value >= SEPARATED)
        .or(named.first())?;
    Some(NextExperiment {
        sentence: words::pairs(plan, &named),
        bench: None,
        pair: Some(first.0),
        reveals: Vec::new(),
        expected_separation: first.1,
        menu,
        peaks: separable.then_some(plan.peaks),
        recipe: separable.then(|| plan.recipe.clone()),
    })
}

/// The smaller of the two directions over the pair's inflation.
fn separation(plan: &Planned, pair: &Pair<'_>, evidence: &Evidence, measure: Measure) -> f64 {
    let [a, b] = &pair.rivals;
    let worst = [(a, b), (b, a)]
        .par_iter()
        .map(|(truth, rival)| {
            let run = plan.measured(truth.model)?;
            measure(&run, rival, evidence.noise)
        })
        // A rival that cannot be simulated there promises nothing.
        .map(|found| found.filter(|value| value.is_finite()).unwrap_or(0.0))
        .reduce(|| f64::INFINITY, f64::min);
    worst / pair.inflation()
}

/// Most pairs told apart first, then how far.
fn merit(separations: &[f64]) -> f64 {
    separations
        .iter()
        .map(|value| {
            let told = if *value >= SEPARATED { 1e3 } else { 0.0 };
            told + (1.0 + value).ln()
        })
        .sum()
}

fn smallest(separations: &[f64]) -> f64 {
    separations.iter().copied().fold(f64::INFINITY, f64::min)
}

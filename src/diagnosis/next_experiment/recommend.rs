//! The menu tried on the rivals, and the best of it; where nothing was found, the run that shows what the runs in hand would
//! not have shown.

use rayon::prelude::*;

use super::plan::{COUNT, Planned, Recipe, planned};
use super::separation::{Response, Rival, refitted};
use super::{ExperimentLimits, MenuEntry, NextExperiment, PairEntry, SEPARATED, words};
use crate::diagnosis::{Diagnosis, DiagnosisVerdict, Evidence, Status};
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::{self, FitError};
use crate::plant::{ActiveEffect, Input, Model, Scenario, effect, typical_size};

/// Pairs that one run is asked to tell apart.
const MOST_PAIRS: usize = 3;
/// Runs of the menu whose separation is found with a full refit of the rival, at most.
const FINALISTS: usize = 3;
/// Gain of merit for which one more run of the menu is refitted: a third more of the separation.
const WORTH_A_REFIT: f64 = 0.3;
/// A diagnosis tells two effects apart where the worse one leaves 2 % more of the squared error that the better one
/// explains, or of the noise; here with a half more, because the prediction is no better than that.
const TOLD_APART: f64 = 0.03;

/// Models that the runs in hand do not tell apart: the answer first, then its rivals.
struct Question<'a> {
    rivals: Vec<Rival<'a>>,
    /// The answer without its effect.
    base: Rival<'a>,
    /// Names of the answer's effect and of the rival's, for each rival after the first.
    names: Vec<[&'static str; 2]>,
}

/// A run of the menu and how far it separates each pair.
struct Tried {
    plan: Planned,
    separations: Vec<f64>,
    /// Separation from which a diagnosis of the run would tell a pair apart.
    needed: f64,
}

impl Tried {
    fn tells_any(&self) -> bool {
        self.separations.iter().any(|value| *value >= self.needed)
    }
}

impl Question<'_> {
    /// Factor by which the squared errors of the better rival of a pair count less than white noise.
    fn inflation(&self, pair: usize) -> f64 {
        self.rivals[0]
            .inflation
            .min(self.rivals[pair + 1].inflation)
    }

    /// For each pair the smaller of the two directions from linear fits, over the pair's inflation; and the separation
    /// that is needed in this run. Where that is more than the runs of any pair differ by before a rival is fitted to
    /// them, what they differ by stands for the rest.
    fn ask(&self, plan: Planned, evidence: &Evidence) -> Tried {
        let noise = plan.noise(evidence.noise);
        let residuals = 2.0 * plan.rows();
        let runs: Vec<Option<Scenario>> = self
            .rivals
            .par_iter()
            .map(|rival| plan.measured(rival.model))
            .collect();
        let apart = |pair: usize| {
            let squares = runs[0].as_ref().zip(runs[pair + 1].as_ref());
            squares.map_or(0.0, |(a, b)| squared_difference(a, b, noise)) / self.inflation(pair)
        };
        let at_most = Tried {
            separations: (0..self.names.len()).map(apart).collect(),
            needed: SEPARATED.max(TOLD_APART * residuals),
            plan,
        };
        if !at_most.tells_any() {
            return at_most;
        }
        let seen: Vec<_> = self
            .rivals
            .par_iter()
            .zip(runs)
            .map(|(rival, run)| {
                let run = run?;
                let (response, _) = Response::of(rival, &run, noise)?;
                Some((run, response))
            })
            .collect();
        let direction = |truth: usize, rival: usize| {
            let (run, _) = seen[truth].as_ref()?;
            let (_, response) = seen[rival].as_ref()?;
            response.separation_from(run, &self.rivals[rival], noise)
        };
        let separations = (0..self.names.len())
            .map(|pair| {
                let both = [direction(0, pair + 1), direction(pair + 1, 0)];
                smaller(both) / self.inflation(pair)
            })
            .collect();
        let explainable = seen[0].as_ref().and_then(|(run, _)| {
            let (response, difference) = Response::of(&self.base, run, noise)?;
            Some(response.without_memory().separation(&difference) / self.rivals[0].inflation)
        });
        let gained = explainable.filter(|d| d.is_finite()).unwrap_or(0.0);
        Tried {
            separations,
            needed: SEPARATED.max(TOLD_APART * gained.max(residuals)),
            ..at_most
        }
    }

    /// The same with the rivals refitted in full.
    fn refitted(&self, plan: &Planned, evidence: &Evidence) -> Vec<f64> {
        (0..self.names.len())
            .into_par_iter()
            .map(|pair| {
                let one_way = |truth: usize, rival: usize| {
                    let run = plan.measured(self.rivals[truth].model)?;
                    refitted(&run, &self.rivals[rival], plan.noise(evidence.noise))
                };
                let (there, back) = rayon::join(|| one_way(0, pair + 1), || one_way(pair + 1, 0));
                smaller([there, back]) / self.inflation(pair)
            })
            .collect()
    }
}

/// What two simulated runs differ by, in units of the noise.
fn squared_difference(a: &Scenario, b: &Scenario, noise: NoiseFloor) -> f64 {
    let sum = |a: &[f64], b: &[f64], noise: f64| {
        let pairs = a.iter().zip(b);
        // A signal that was not measured counts for nothing.
        pairs
            .map(|(a, b)| ((a - b) / noise).powi(2))
            .filter(|d| d.is_finite())
            .sum::<f64>()
    };
    sum(&a.current_a, &b.current_a, noise.current_a)
        + sum(&a.speed_rad_s, &b.speed_rad_s, noise.speed_rad_s)
}

/// A rival that cannot be simulated there promises nothing.
fn smaller(directions: [Option<f64>; 2]) -> f64 {
    let promised = |found: Option<f64>| found.filter(|value| value.is_finite()).unwrap_or(0.0);
    promised(directions[0]).min(promised(directions[1]))
}

/// The run after this diagnosis: for the pairs that it could not tell apart, else, where nothing was found, for what the
/// runs did not excite. `None` where there is nothing to ask, or no voltage to ask it with.
pub fn recommend(
    diagnosis: &Diagnosis,
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
    let rivals = diagnosis.confusable.iter().zip(&diagnosis.rivals);
    for (names, rival) in rivals.take(MOST_PAIRS) {
        let rival = output_error::fit(
            std::slice::from_ref(rival),
            &evidence.training,
            &evidence.noise,
        )?;
        others.push((*names, rival.model));
    }
    let Some(base) = without_effect(&diagnosis.model.model, &others) else {
        return Ok(None);
    };
    let mut models = vec![&diagnosis.model.model];
    models.extend(others.iter().map(|(_, model)| model));
    let names = others.iter().map(|(names, _)| *names).collect();
    tell_apart(&models, &base, names, evidence, limits)
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
    let base = rivals[0].without_effect(names[0])?;
    tell_apart(&rivals, &base, vec![names], evidence, limits)
}

/// Every recipe of the menu that this model can run within the limits.
pub fn menu_within(model: &Model, limits: &ExperimentLimits) -> Vec<Recipe> {
    (0..COUNT)
        .filter_map(|index| planned(index, &[model], limits))
        .map(|plan| plan.recipe)
        .collect()
}

/// The model without the first pair's effect.
fn without_effect(model: &Model, others: &[([&'static str; 2], Model)]) -> Option<Model> {
    model.without_effect(others.first()?.0[0]).ok()
}

fn tell_apart(
    models: &[&Model],
    base: &Model,
    names: Vec<[&'static str; 2]>,
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Result<Option<NextExperiment>, FitError> {
    let rivals = models
        .par_iter()
        .map(|model| Rival::new(model, evidence))
        .collect::<Result<Vec<_>, FitError>>()?;
    let question = Question {
        rivals,
        base: Rival::new(base, evidence)?,
        names,
    };
    let tried = tried(&question, models, evidence, limits, &[]);
    let Some((chosen, separations)) = best(&question, &tried, evidence) else {
        return Ok(None);
    };
    let pairs = pair_entries(&question, &tried, chosen, &separations);
    let separable = pairs.iter().any(PairEntry::is_told);
    let Some(first) = pairs
        .iter()
        .find(|pair| pair.is_told())
        .or(pairs.first())
        .cloned()
    else {
        return Ok(None);
    };
    let plan = &tried[chosen].plan;
    let mut sentence = words::pairs(plan, &pairs, |program| name_of(&tried, program));
    if !separable && limits.slew_v_per_s.is_finite() {
        let free = ExperimentLimits {
            slew_v_per_s: f64::INFINITY,
            ..*limits
        };
        // What does not change any faster then has been tried.
        let known: Vec<&Recipe> = tried.iter().map(|tried| &tried.plan.recipe).collect();
        let freely = self::tried(&question, models, evidence, &free, &known);
        if let Some((quicker, separations)) = best(&question, &freely, evidence) {
            let quicker = &freely[quicker];
            let largest = separations.iter().copied().fold(0.0, f64::max);
            if largest >= quicker.needed {
                sentence.push_str(&words::with_more_slew(&quicker.plan, largest));
            }
        }
    }
    Ok(Some(NextExperiment {
        sentence,
        bench: None,
        pair: Some(first.pair),
        reveals: Vec::new(),
        expected_separation: first.expected_separation,
        menu: tried
            .iter()
            .map(|tried| MenuEntry {
                program: tried.plan.recipe.id,
                expected_separation: smallest(&tried.separations),
                needed: tried.needed,
            })
            .collect(),
        peaks: separable.then_some(plan.peaks),
        recipe: separable.then(|| plan.recipe.clone()),
        pairs,
    }))
}

/// The menu but for the recipes that are `known`, best first.
fn tried(
    question: &Question<'_>,
    models: &[&Model],
    evidence: &Evidence,
    limits: &ExperimentLimits,
    known: &[&Recipe],
) -> Vec<Tried> {
    let mut tried: Vec<Tried> = (0..COUNT)
        .into_par_iter()
        .filter_map(|index| planned(index, models, limits))
        .filter(|plan| !known.contains(&&plan.recipe))
        .map(|plan| question.ask(plan, evidence))
        .collect();
    let merit = |tried: &Tried| merit(&tried.separations, tried.needed);
    tried.sort_by(|a, b| merit(b).total_cmp(&merit(a)));
    tried
}

/// Index of the run that is best when the rivals are refitted in full, and its separations: the linear order is asked
/// from its top until the next one could not be much better. Where the first tells nothing apart no refit is asked.
fn best(
    question: &Question<'_>,
    tried: &[Tried],
    evidence: &Evidence,
) -> Option<(usize, Vec<f64>)> {
    let first = tried.first()?;
    if !first.tells_any() {
        return Some((0, first.separations.clone()));
    }
    let mut best: Option<(f64, usize, Vec<f64>)> = None;
    for (index, next) in tried.iter().take(FINALISTS).enumerate() {
        let so_far = best
            .as_ref()
            .map_or(f64::NEG_INFINITY, |(merit, ..)| *merit);
        if so_far + WORTH_A_REFIT >= merit(&next.separations, next.needed) {
            break;
        }
        let found = question.refitted(&next.plan, evidence);
        let merit = merit(&found, next.needed);
        if merit > so_far {
            best = Some((merit, index, found));
        }
    }
    best.map(|(_, index, found)| (index, found))
}

fn pair_entries(
    question: &Question<'_>,
    tried: &[Tried],
    chosen: usize,
    separations: &[f64],
) -> Vec<PairEntry> {
    question
        .names
        .iter()
        .zip(separations)
        .enumerate()
        .filter_map(|(index, (pair, separation))| {
            // The run in which most beyond what is needed can be expected.
            let own = |tried: &Tried| tried.separations[index];
            let beyond = |tried: &Tried| own(tried) / tried.needed;
            let best = tried
                .iter()
                .max_by(|a, b| beyond(a).total_cmp(&beyond(b)))?;
            let here = &tried[chosen];
            let chosen_is_best = best.plan.recipe.id == here.plan.recipe.id;
            Some(PairEntry {
                pair: *pair,
                expected_separation: *separation,
                needed: here.needed,
                best_program: best.plan.recipe.id,
                best_separation: if chosen_is_best {
                    *separation
                } else {
                    own(best)
                },
                best_needed: best.needed,
            })
        })
        .collect()
}

/// The name of a recipe in a sentence.
fn name_of(tried: &[Tried], program: &str) -> &'static str {
    let mut all = tried.iter().map(|tried| &tried.plan.recipe);
    all.find(|recipe| recipe.id == program)
        .map_or("", |recipe| recipe.name)
}

/// Most pairs told apart first, then how far the closest of them, then the others.
fn merit(separations: &[f64], needed: f64) -> f64 {
    let told = separations.iter().filter(|value| **value >= needed).count();
    let beyond = |value: f64| (1.0 + value / needed).ln();
    let sum: f64 = separations.iter().copied().map(beyond).sum();
    1e3 * told as f64 + beyond(smallest(separations)) + 0.1 * sum
}

fn smallest(separations: &[f64]) -> f64 {
    separations.iter().copied().fold(f64::INFINITY, f64::min)
}

/// The run in which most of `unseen` would show at their typical size, against a baseline that is fitted again.
fn reveal(
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

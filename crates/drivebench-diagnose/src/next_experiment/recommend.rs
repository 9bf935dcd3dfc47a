//! Evaluation of the menu on the rivals, and its best run.

use rayon::prelude::*;

use super::plan::{COUNT, Planned, Recipe, planned};
use super::reveal::reveal;
use super::separation::{Response, Rival, refitted};
use super::{
    ExperimentLimits, FasterRun, MenuEntry, NextExperiment, PairEntry, Recommendation, SEPARATED,
};
use crate::{Diagnosis, Evidence};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::{self, FitError};
use drivebench_model::numerics::levenberg_marquardt::Options;
use drivebench_model::plant::{Input, Model, Scenario};

/// Most pairs that one run is to distinguish.
const MOST_PAIRS: usize = 3;
/// Runs of the menu whose separation is found with a full refit of the rival, at most.
const FINALISTS: usize = 3;
/// Gain of merit for which one more run of the menu is refitted: a third more separation.
const WORTH_A_REFIT: f64 = 0.3;
/// A diagnosis distinguishes two effects where the worse one leaves 2 % more of the squared error that the better one
/// explains, or of the noise; here 3 %, a margin for the error of the prediction.
const DISTINGUISHED_SHARE: f64 = 0.03;

/// Models that the runs in hand do not distinguish: the answer first, then its rivals.
struct Rivals<'a> {
    models: Vec<Rival<'a>>,
    /// The answer without its effect.
    base: Rival<'a>,
    /// Names of the answer's effect and of the rival's, for each rival after the first.
    names: Vec<[&'static str; 2]>,
    evidence: &'a Evidence,
}

/// A run of the menu and how far it separates each pair.
struct Tried {
    plan: Planned,
    separations: Vec<f64>,
    /// Separation from which a diagnosis of the run would distinguish a pair.
    needed: f64,
}

impl Tried {
    fn separates_any(&self) -> bool {
        self.separations.iter().any(|value| *value >= self.needed)
    }

    fn merit(&self) -> f64 {
        merit(&self.separations, self.needed)
    }
}

impl Rivals<'_> {
    /// Factor by which the squared errors of the better rival of a pair count less than white noise.
    fn inflation(&self, pair: usize) -> f64 {
        let [answer, rival] = [0, pair + 1].map(|place| self.models[place].inflation);
        answer.min(rival)
    }

    /// For each pair the smaller of the two directions from linear fits, over the pair's inflation; and the separation
    /// that is needed in this run. Where that is more than the difference of every pair before a rival is fitted to
    /// the run, this difference is the upper bound that is returned.
    fn evaluated(&self, plan: Planned) -> Tried {
        let noise = plan.noise(self.evidence.noise);
        let residuals = 2.0 * plan.rows();
        let rivals = self.models.par_iter();
        let runs: Vec<Option<Scenario>> = rivals.map(|own| plan.measured(own.model)).collect();
        let pairs = 0..self.names.len();
        let upper_bound = |pair: usize| {
            let squares = runs[0].as_ref().zip(runs[pair + 1].as_ref());
            squares.map_or(0.0, |(a, b)| squared_difference(a, b, noise)) / self.inflation(pair)
        };
        let at_most = Tried {
            separations: pairs.clone().map(upper_bound).collect(),
            needed: SEPARATED.max(DISTINGUISHED_SHARE * residuals),
            plan,
        };
        if !at_most.separates_any() {
            return at_most;
        }
        let responses = self.models.par_iter().zip(runs).map(|(rival, run)| {
            let run = run?;
            let (response, _) = Response::of(rival, &run, noise)?;
            Some((run, response))
        });
        let simulated: Vec<Option<(Scenario, Response)>> = responses.collect();
        let direction = |truth: usize, rival: usize| {
            let (run, _) = simulated[truth].as_ref()?;
            let (_, response) = simulated[rival].as_ref()?;
            response.separation_from(run, &self.models[rival], noise)
        };
        let separation = |pair: usize| {
            let both = [direction(0, pair + 1), direction(pair + 1, 0)];
            smaller(both) / self.inflation(pair)
        };
        let explainable = simulated[0].as_ref().and_then(|(run, _)| {
            let (mut response, difference) = Response::of(&self.base, run, noise)?;
            // Without the old data.
            response.information.fill(0.0);
            Some(response.separation(&difference) / self.models[0].inflation)
        });
        let gained = explainable.filter(|d| d.is_finite()).unwrap_or(0.0);
        Tried {
            separations: pairs.map(separation).collect(),
            needed: SEPARATED.max(DISTINGUISHED_SHARE * gained.max(residuals)),
            ..at_most
        }
    }

    /// The same with the rivals refitted in full.
    fn refitted(&self, plan: &Planned) -> Vec<f64> {
        let noise = plan.noise(self.evidence.noise);
        let one_way = |truth: usize, rival: usize| {
            let run = plan.measured(self.models[truth].model)?;
            refitted(&run, &self.models[rival], noise)
        };
        let separation = |pair: usize| {
            let (there, back) = rayon::join(|| one_way(0, pair + 1), || one_way(pair + 1, 0));
            smaller([there, back]) / self.inflation(pair)
        };
        (0..self.names.len()).into_par_iter().map(separation).collect()
    }

    /// The menu but for the recipes that are `known`, best first.
    fn tried(&self, limits: &ExperimentLimits, known: &[&Recipe]) -> Vec<Tried> {
        let models: Vec<&Model> = self.models.iter().map(|rival| rival.model).collect();
        let plans = (0..COUNT).into_par_iter().filter_map(|index| planned(index, &models, limits));
        let plans = plans.filter(|plan| !known.contains(&&plan.recipe));
        let mut tried: Vec<Tried> = plans.map(|plan| self.evaluated(plan)).collect();
        tried.sort_by(|a, b| b.merit().total_cmp(&a.merit()));
        tried
    }

    /// Index of the run that is best when the rivals are refitted in full, and its separations: the linear order is followed
    /// from its top until the next one could not be much better. Where the first separates no pair nothing is refitted.
    fn best(&self, tried: &[Tried]) -> Option<(usize, Vec<f64>)> {
        let first = tried.first()?;
        if !first.separates_any() {
            return Some((0, first.separations.clone()));
        }
        let mut best = None;
        let mut so_far = f64::NEG_INFINITY;
        for (index, next) in tried.iter().take(FINALISTS).enumerate() {
            if so_far + WORTH_A_REFIT >= next.merit() {
                break;
            }
            let found = self.refitted(&next.plan);
            let merit = merit(&found, next.needed);
            if merit > so_far {
                (so_far, best) = (merit, Some((index, found)));
            }
        }
        best
    }

    fn pair_entries(&self, tried: &[Tried], chosen: usize, separations: &[f64]) -> Vec<PairEntry> {
        let pairs = self.names.iter().zip(separations).enumerate();
        let entry = |(index, (pair, separation)): (usize, (&[&'static str; 2], &f64))| {
            // The run with the largest ratio of separation to need.
            let own = |tried: &Tried| tried.separations[index];
            let beyond = |tried: &Tried| own(tried) / tried.needed;
            let best = tried.iter().max_by(|a, b| beyond(a).total_cmp(&beyond(b)))?;
            let here = &tried[chosen];
            let chosen_is_best = best.plan.recipe.id == here.plan.recipe.id;
            Some(PairEntry {
                pair: *pair,
                expected_separation: *separation,
                needed: here.needed,
                best_program: best.plan.recipe.id,
                best_separation: if chosen_is_best { *separation } else { own(best) },
                best_needed: best.needed,
            })
        };
        pairs.filter_map(entry).collect()
    }
}

/// Squared difference of two simulated runs, in units of the noise.
fn squared_difference(a: &Scenario, b: &Scenario, noise: NoiseFloor) -> f64 {
    let sum = |a: &[f64], b: &[f64], noise: f64| {
        let squares = a.iter().zip(b).map(|(a, b)| ((a - b) / noise).powi(2));
        // A signal that was not measured does not count.
        squares.filter(|d| d.is_finite()).sum::<f64>()
    };
    sum(&a.current_a, &b.current_a, noise.current_a)
        + sum(&a.speed_rad_s, &b.speed_rad_s, noise.speed_rad_s)
}

/// The smaller separation, zero for a rival that cannot be simulated.
fn smaller(directions: [Option<f64>; 2]) -> f64 {
    let expected = |found: Option<f64>| found.filter(|value| value.is_finite()).unwrap_or(0.0);
    expected(directions[0]).min(expected(directions[1]))
}

/// The next run after this diagnosis: for its ambiguous pairs, else for the effects that the runs did not excite. `None`
/// where there are neither, or no voltage drives.
pub fn recommend(
    diagnosis: &Diagnosis,
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Result<Option<NextExperiment>, FitError> {
    if evidence.training.input != Input::Voltage {
        return Ok(None);
    }
    let evidence = &Evidence { noise: diagnosis.model.noise, ..evidence.clone() };
    if diagnosis.confusable.is_empty() {
        return Ok(reveal(diagnosis, evidence, limits));
    }
    let rivals = diagnosis.confusable.iter().map(|pair| pair[1]);
    let effects = diagnosis.model.model.effect_ids().into_iter().chain(rivals);
    let (evidence, _) = evidence.fitted_with(&effects.collect::<Vec<_>>());
    let evidence = &*evidence;
    let pairs = diagnosis.confusable.iter().zip(&diagnosis.rivals).take(MOST_PAIRS);
    let (mut names, mut rivals) = (Vec::new(), Vec::new());
    let Evidence { training, noise, .. } = evidence;
    let options = Options { one_of_many: false, ..Options::thrifty() };
    for (pair, rival) in pairs {
        let start = std::slice::from_ref(rival);
        names.push(*pair);
        rivals.push(output_error::fit_with(start, training, noise, options)?.model);
    }
    let answer = &diagnosis.model.model;
    let without = names.first().map(|pair| answer.without_effect(pair[0]));
    let Some(Ok(base)) = without else {
        return Ok(None);
    };
    let models: Vec<&Model> = std::iter::once(answer).chain(&rivals).collect();
    distinguish(&models, &base, names, evidence, limits)
}

/// The run that separates two fitted models best, within the limits. `evidence` are the runs of both fits, with the
/// noise that its baseline left ([`Evidence::with_baseline`]).
pub fn next_experiment(
    rivals: [&Model; 2],
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Result<Option<NextExperiment>, FitError> {
    let own = |model: &Model, other: &Model| {
        model.effect_ids().into_iter().rev().find(|id| !other.has(id)).unwrap_or("baseline")
    };
    let names = [own(rivals[0], rivals[1]), own(rivals[1], rivals[0])];
    let base = rivals[0].without_effect(names[0])?;
    distinguish(&rivals, &base, vec![names], evidence, limits)
}

/// Every recipe of the menu that this model can run within the limits.
pub fn menu_within(model: &Model, limits: &ExperimentLimits) -> Vec<Recipe> {
    let plans = (0..COUNT).filter_map(|index| planned(index, &[model], limits));
    plans.map(|plan| plan.recipe).collect()
}

fn distinguish(
    models: &[&Model],
    base: &Model,
    names: Vec<[&'static str; 2]>,
    evidence: &Evidence,
    limits: &ExperimentLimits,
) -> Result<Option<NextExperiment>, FitError> {
    let rivals = models.par_iter().map(|model| Rival::new(model, evidence));
    let question = Rivals {
        models: rivals.collect::<Result<Vec<_>, FitError>>()?,
        base: Rival::new(base, evidence)?,
        names,
        evidence,
    };
    let tried = question.tried(limits, &[]);
    let Some((chosen, separations)) = question.best(&tried) else {
        return Ok(None);
    };
    let pairs = question.pair_entries(&tried, chosen, &separations);
    let separated = pairs.iter().find(|pair| pair.is_separated());
    let separable = separated.is_some();
    let Some(first) = separated.or(pairs.first()).cloned() else {
        return Ok(None);
    };
    let plan = &tried[chosen].plan;
    let mut faster = None;
    if !separable && limits.slew_v_per_s.is_finite() {
        let free = ExperimentLimits { slew_v_per_s: f64::INFINITY, ..*limits };
        // Recipes that do not depend on the slew limit have been tried.
        let known: Vec<&Recipe> = tried.iter().map(|tried| &tried.plan.recipe).collect();
        let freely = question.tried(&free, &known);
        if let Some((quicker, separations)) = question.best(&freely) {
            let quicker = &freely[quicker];
            let largest = separations.iter().copied().fold(0.0, f64::max);
            if largest >= quicker.needed {
                let recipe = &quicker.plan.recipe;
                faster = Some(FasterRun {
                    slew_v_per_s: recipe.slew_v_per_s,
                    program: recipe.id,
                    separation: largest,
                });
            }
        }
    }
    let finding = if separable {
        Recommendation::Distinguishes
    } else {
        Recommendation::CannotDistinguish { faster }
    };
    let entry = |tried: &Tried| MenuEntry {
        program: tried.plan.recipe.id,
        expected_separation: smallest(&tried.separations),
        needed: tried.needed,
    };
    Ok(Some(NextExperiment {
        finding,
        bench: None,
        pair: Some(first.pair),
        reveals: Vec::new(),
        hidden: Vec::new(),
        expected_separation: first.expected_separation,
        menu: tried.iter().map(entry).collect(),
        peaks: separable.then_some(plan.peaks),
        recipe: separable.then(|| plan.recipe.clone()),
        pairs,
    }))
}

/// Number of separated pairs first, then the smallest separation, then the sum.
fn merit(separations: &[f64], needed: f64) -> f64 {
    let separated = separations.iter().filter(|value| **value >= needed).count();
    let beyond = |value: f64| (1.0 + value / needed).ln();
    let sum: f64 = separations.iter().copied().map(beyond).sum();
    1e3 * separated as f64 + beyond(smallest(separations)) + 0.1 * sum
}

fn smallest(separations: &[f64]) -> f64 {
    separations.iter().copied().fold(f64::INFINITY, f64::min)
}

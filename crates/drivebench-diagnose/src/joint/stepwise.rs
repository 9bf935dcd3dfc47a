//! Forward stepwise selection, the way to a model near enough to its runs for a linear solution: the single effect that,
//! refitted, explains most joins, one after the other. Times in the path from command to reading are scanned: what one of several
//! time constants of the motor does is linear in no step from zero.

use rayon::prelude::*;

use super::columns::linearise;
use super::eligible::why_not;
use super::events::Hypothesis;
use super::kalman::Noise;
use super::prediction_error::{fit, fit_as_followed};
use super::process_noise::terms_of;
use super::regression::{Candidate, FAR_MEAN_SQUARE, Linear, Variant};
use super::run::{LinearisedRun, squares};
use super::search::Runs;
use super::select::{Reduced, Set};
use super::solution::{placed, present};
use drivebench_model::plant::{ActiveEffect, Effect, Enters, Model};

/// A step towards the data: the model with one effect more, and the squares that it leaves.
type Step = (Hypothesis, f64);

/// Adds the single effects that explain most when refitted, four at most, one after the other, until the linear solution holds or
/// none takes a tenth of the squares. Steps are found by the first run, and every run must be simulated with them.
pub(super) fn approach(
    mut hypothesis: Hypothesis,
    eligible: &[&'static dyn Effect],
    all: Runs<'_>,
    noise: Noise,
) -> Option<Hypothesis> {
    for step in 0..4 {
        if all.work.is_spent() {
            break;
        }
        let runs = all.first().linearised_runs(&hypothesis, noise)?;
        let now = squares(&runs);
        let near = FAR_MEAN_SQUARE * runs[0].follower.rows as f64;
        let is_far = now >= near;
        let is_first = step == 0;
        // In units of its own residual a fit is never far from the data.
        if !is_far && (all.has_floor || !is_first) {
            break;
        }
        let best = || best_step(&hypothesis, eligible, &runs, near);
        let mut found = is_far.then(best).flatten();
        let is_there = |step: &Step| step.1 < near;
        if is_first && !(is_far && found.as_ref().is_some_and(is_there)) {
            let late = late(&hypothesis, eligible, &runs[0]);
            let steps = found.into_iter().chain(late);
            found = steps.min_by(|a, b| a.1.total_cmp(&b.1));
        }
        let is_simulated = |next: &Hypothesis| all.linearised_runs(next, noise).is_some();
        let is_worth = |step: &Step| step.1 < 0.9 * now && is_simulated(&step.0);
        let Some(step) = found.filter(is_worth) else {
            break;
        };
        hypothesis = step.0;
        // With the gains of what was measured a play is found at once; a free run without its oscillation ends in a local minimum.
        let has_coupling = |active| terms_of(active).coupling().is_some();
        if hypothesis.model.effects.iter().any(has_coupling)
            && let Some(own) = fit(&hypothesis, &runs).filter(|own| is_simulated(&own.hypothesis))
        {
            hypothesis = own.hypothesis;
        }
    }
    Some(hypothesis)
}

/// The best single effect beside what there is; `near` is where the squares are small enough.
fn best_step(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    runs: &[LinearisedRun<'_>],
    near: f64,
) -> Option<Step> {
    let linear = linearise(hypothesis, eligible, runs, false)?;
    let set = present(&linear);
    let reduced = Reduced::new(linear, 1.0, false)?;
    let linear = &reduced.linear;
    let columns = reduced.columns(&set);
    let mut singles: Vec<(f64, usize, usize)> = Vec::new();
    for (k, candidate) in linear.candidates.iter().enumerate() {
        if candidate.in_model || is_excluded(candidate, &set) {
            continue;
        }
        let logs = reduced.conditional(&columns, k);
        let mut order: Vec<usize> = (0..logs.len()).collect();
        order.sort_by(|a, b| logs[*b].total_cmp(&logs[*a]));
        // What has a shape and no size needs a start near it.
        let starts = if candidate.is_whole() { 3 } else { 1 };
        singles.extend(order.into_iter().take(starts).map(|v| (logs[v], k, v)));
    }
    singles.sort_by(|a, b| b.0.total_cmp(&a.0));
    let most = singles.first()?.0;
    singles.truncate(6);
    // The linear solution hardly holds for what is there wholly or not at all, and just how much that leaves is known.
    for whole in as_it_is(linear, &set) {
        if !singles.iter().any(|own| (own.1, own.2) == (whole.1, whole.2)) {
            singles.push(whole);
        }
    }
    singles.retain(|single| single.0 >= 0.2 * most);
    let mut best: Option<(usize, Step)> = None;
    let mut take = |candidate: usize, variant: usize| {
        let mut with = set.clone();
        with[candidate] = Some(variant);
        let start = placed(hypothesis, &reduced, &with, runs)?;
        // Far from the data a wider error of form would be the likelier: all have the same noise.
        let step = fit_as_followed(&start, runs)?;
        if best.as_ref().is_none_or(|best| step.1 < best.1.1) {
            best = Some((candidate, step));
        }
        best.as_ref().map(|best| (best.0, best.1.1))
    };
    let mut leads = None;
    for (_, candidate, variant) in &singles {
        leads = take(*candidate, *variant).or(leads);
    }
    // A fit that began too far off ends in a local minimum: the other forms of what leads are tried too.
    if let Some((candidate, mut squares)) = leads
        && linear.candidates[candidate].is_whole()
    {
        for variant in 0..linear.candidates[candidate].variants.len() {
            if squares < near {
                break;
            }
            let tried = (candidate, variant);
            if !singles.iter().any(|single| (single.1, single.2) == tried) {
                squares = take(candidate, variant).map_or(squares, |leads| leads.1);
            }
        }
    }
    best.map(|best| best.1)
}

/// The best single time in the path from command to reading, of all effects that have one, found by the first 5000 samples and
/// refitted to all of the run.
fn late(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    run: &LinearisedRun<'_>,
) -> Option<Step> {
    let scenario = run.scenario.stretch(0..run.scenario.samples().min(5000));
    let beginning = [run.around(&hypothesis.model, vec![], &scenario)?];
    let is_a_time = |effect: &&&'static dyn Effect| {
        let card = effect.card();
        let [spec] = effect.parameters() else {
            return false;
        };
        let mut known = card.alternatives.iter().chain([&card.id]);
        card.enters == Enters::Path
            && spec.unit == "s"
            && why_not(**effect, &scenario).is_none()
            && !known.any(|id| hypothesis.has(id))
    };
    let effects: Vec<&'static dyn Effect> = eligible.iter().filter(is_a_time).copied().collect();
    let steps = effects.into_par_iter().with_max_len(1);
    let steps = steps.filter_map(|effect| late_by(hypothesis, effect, &beginning));
    let best = steps.collect::<Vec<Step>>().into_iter();
    let best = best.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let whole = run.around(&hypothesis.model, vec![], run.scenario)?;
    fit_as_followed(&best.0, &[whole])
}

/// The best of the times of one effect: from one period of the sampling to a tenth of the run, each twice the last, refitted
/// from the motor that was found with the last; a fit finds what lies between.
fn late_by(
    hypothesis: &Hypothesis,
    effect: &'static dyn Effect,
    runs: &[LinearisedRun<'_>],
) -> Option<Step> {
    let times = &runs[0].scenario.sample_time_s;
    let length_s = times.last()? - times.first()?;
    let longest_s = (0.1 * length_s).min(effect.parameters()[0].max);
    let mut time_s = runs[0].scenario.mean_period_s();
    let mut start = hypothesis.clone();
    let mut best: Option<Step> = None;
    while time_s <= longest_s {
        let id = effect.card().id;
        start.model.effects.retain(|own| own.id() != id);
        let active = ActiveEffect::with(effect, &[time_s]);
        start.model.effects.push(active);
        time_s *= 2.0;
        let Some(step) = fit_as_followed(&start, runs) else {
            continue;
        };
        let least = best.as_ref().map_or(f64::INFINITY, |best| best.1);
        // Times beyond leave still more.
        if step.1 > 4.0 * least {
            break;
        }
        start.clone_from(&step.0);
        if step.1 < least {
            best = Some(step);
        }
    }
    best
}

/// Whether a candidate excludes something that is in the set.
fn is_excluded(candidate: &Candidate, set: &Set) -> bool {
    candidate.excludes.iter().any(|other| set[*other].is_some())
}

/// For each candidate that is there wholly or not at all its form that leaves least when it is put in and nothing else
/// moves: the fall of the cost, the candidate and the form.
fn as_it_is(linear: &Linear, set: &Set) -> Vec<(f64, usize, usize)> {
    let candidates = linear.candidates.iter().enumerate();
    candidates
        .filter(|(k, candidate)| {
            set[*k].is_none() && candidate.is_whole() && !is_excluded(candidate, set)
        })
        .filter_map(|(k, candidate)| {
            let fall = |variant: &Variant| {
                let (column, size) = (variant.columns[0].at, variant.mean);
                let present = linear.gram.row(column).transpose().dot(&linear.present);
                let right = linear.right[column] - present;
                size * right - 0.5 * size * size * linear.gram[(column, column)]
            };
            let forms = candidate.variants.iter().enumerate();
            forms.map(|(form, variant)| (fall(variant), k, form)).max_by(|a, b| a.0.total_cmp(&b.0))
        })
        .collect()
}

/// Where a search begins: at the fitted model; or, where that leaves a hundred times the noise, at the one that it was fitted
/// from, refitted along the run, if this leaves less: the free run of an incomplete model may be fitted by what is no machine.
pub(super) fn nearer([fitted, before]: [&Model; 2], runs: Runs<'_>, noise: Noise) -> Hypothesis {
    let along = |model: &Model| runs.first().linearised_runs(&Hypothesis::of(model), noise);
    let left = along(fitted).map(|runs| (squares(&runs), runs[0].follower.rows));
    let is_astray = left.is_none_or(|(left, rows)| left > 100.0 * rows as f64);
    let again = is_astray.then(|| fit_as_followed(&Hypothesis::of(before), &along(before)?));
    match again.flatten() {
        Some((again, squares)) if left.is_none_or(|left| squares < left.0) => again,
        _ => Hypothesis::of(fitted),
    }
}

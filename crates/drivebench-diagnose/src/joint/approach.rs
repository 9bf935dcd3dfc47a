//! Forward stepwise selection, the way to a model near enough to its runs for a linear solution: the single effect that,
//! refitted, explains most joins, one after the other. Times in the path from command to reading are scanned: what one of several
//! time constants of the motor does is linear in no step from zero.

use rayon::prelude::*;

use super::columns::{
    Candidate, FAR_MEAN_SQUARE, Linear, LinearisedRun, Variant, linearise, squares,
};
use super::eligible::why_not;
use super::events::Hypothesis;
use super::follow::Noise;
use super::prediction_error::{fit, fit_as_followed};
use super::search::Runs;
use super::select::{Reduced, Set};
use super::solution::{placed, present};
use drivebench_model::plant::{ActiveEffect, Effect, Enters, Model};

/// The same above which a fitted model may be no machine.
const ASTRAY_MEAN_SQUARE: f64 = 100.0;
/// Effects that join one by one before the sets are weighed.
const MOST_STEPS: usize = 4;
/// Share of the squares that one of them must leave at most.
const WORTH_A_STEP_SHARE: f64 = 0.9;
/// Single effects that are refitted for one step, and the share of the best one's gain from which they are.
const MOST_SINGLES: usize = 6;
const WORTH_A_REFIT_SHARE: f64 = 0.2;
/// Forms of what is there wholly or not at all from which a refit starts.
const STARTS: usize = 3;

/// Longest time in the path that is looked for, as a share of the run: a longer one leaves too little of it to be told by.
const LONGEST_SHARE: f64 = 0.1;
/// How many times as long as the last one each time is; a fit finds what lies between.
const LONGER: f64 = 2.0;
/// Growth of the squares over their least from which longer times are not tried.
const PAST_RATIO: f64 = 4.0;
/// Samples of the run by which times are scanned.
const MOST_SCANNED: usize = 5000;

/// A step towards the data: the model with one effect more, and what it leaves.
struct Step {
    hypothesis: Hypothesis,
    squares: f64,
}

/// Adds the single effects that explain most when refitted, one after the other, until the linear solution holds or none
/// explains a good part of what is left. Only the first run is looked at; a step that another one cannot be followed with is
/// none.
pub(super) fn approach(
    mut hypothesis: Hypothesis,
    eligible: &[&'static dyn Effect],
    all: Runs<'_>,
    noise: Noise,
) -> Option<Hypothesis> {
    for step in 0..MOST_STEPS {
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
        let mut found = if is_far {
            best_step(&hypothesis, eligible, &runs, near)
        } else {
            None
        };
        let is_there = |step: &Step| step.squares < near;
        if is_first && !(is_far && found.as_ref().is_some_and(is_there)) {
            let steps = found
                .into_iter()
                .chain(late(&hypothesis, eligible, &runs[0]));
            found = steps.min_by(|a, b| a.squares.total_cmp(&b.squares));
        }
        match found {
            Some(step)
                if step.squares < WORTH_A_STEP_SHARE * now
                    && all.linearised_runs(&step.hypothesis, noise).is_some() =>
            {
                hypothesis = step.hypothesis;
                // Led by what was measured a play is found at once; led without its ringing it ends in a hollow of impacts.
                if has_coupling(&hypothesis.model)
                    && let Some(own) = fit(&hypothesis, &runs)
                    && all.linearised_runs(&own.hypothesis, noise).is_some()
                {
                    hypothesis = own.hypothesis;
                }
            }
            _ => break,
        }
    }
    Some(hypothesis)
}

fn has_coupling(model: &Model) -> bool {
    let mut effects = model.effects.iter();
    effects.any(|active| {
        let terms = active.effect.terms(&active.values_or_guess());
        terms.coupling().is_some()
    })
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
    let with = |candidate: usize, variant: usize| {
        let mut with = set.clone();
        with[candidate] = Some(variant);
        with
    };
    let mut singles: Vec<(f64, usize, usize)> = Vec::new();
    for (k, candidate) in linear.candidates.iter().enumerate() {
        if candidate.in_model || says_the_same(candidate, &set) {
            continue;
        }
        let logs = reduced.conditional(&columns, k);
        let mut order: Vec<usize> = (0..logs.len()).collect();
        order.sort_by(|a, b| logs[*b].total_cmp(&logs[*a]));
        // Where the shape is all that there is, a start has to be near it.
        let starts = if candidate.is_whole() { STARTS } else { 1 };
        singles.extend(order.into_iter().take(starts).map(|v| (logs[v], k, v)));
    }
    singles.sort_by(|a, b| b.0.total_cmp(&a.0));
    let most = singles.first()?.0;
    singles.truncate(MOST_SINGLES);
    // A linear solution knows little of what is there wholly or not at all, and just how much that leaves is known.
    for whole in as_it_is(linear, &set) {
        if !singles
            .iter()
            .any(|single| (single.1, single.2) == (whole.1, whole.2))
        {
            singles.push(whole);
        }
    }
    singles.retain(|single| single.0 >= WORTH_A_REFIT_SHARE * most);
    let mut best: Option<(usize, Step)> = None;
    let mut take = |candidate: usize, variant: usize| {
        let set = with(candidate, variant);
        let start = placed(hypothesis, &reduced, &set, runs)?;
        // Far from the data a wider error of form would be the likelier: all are held against the same noise.
        let (hypothesis, squares) = fit_as_followed(&start, runs)?;
        if best.as_ref().is_none_or(|best| squares < best.1.squares) {
            let step = Step {
                hypothesis,
                squares,
            };
            best = Some((candidate, step));
        }
        best.as_ref().map(|best| (best.0, best.1.squares))
    };
    let mut leads = None;
    for (_, candidate, variant) in &singles {
        leads = take(*candidate, *variant).or(leads);
    }
    // A fit that began too far off ends in a hollow: the other forms of what leads are tried too.
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

/// The best single time in the path from command to reading, of all effects that have one, found by the beginning of the run
/// and refitted to all of it.
fn late(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    run: &LinearisedRun<'_>,
) -> Option<Step> {
    let scanned = run.scenario.samples().min(MOST_SCANNED);
    let scenario = run.scenario.stretch(0..scanned);
    let beginning = [
        LinearisedRun::new(&hypothesis.model, &scenario, run.start, run.noise)?.counted(run.work),
    ];
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
    let best = best.min_by(|a, b| a.squares.total_cmp(&b.squares))?;
    let whole = LinearisedRun::new(&hypothesis.model, run.scenario, run.start, run.noise)?;
    let whole = whole.counted(run.work);
    let (hypothesis, squares) = fit_as_followed(&best.hypothesis, &[whole])?;
    Some(Step {
        hypothesis,
        squares,
    })
}

/// The best of the times of one effect: from one period of the sampling on, each twice the last, refitted from the motor that
/// was found with the last.
fn late_by(
    hypothesis: &Hypothesis,
    effect: &'static dyn Effect,
    runs: &[LinearisedRun<'_>],
) -> Option<Step> {
    let times = &runs[0].scenario.sample_time_s;
    let length_s = times.last()? - times.first()?;
    let longest_s = (LONGEST_SHARE * length_s).min(effect.parameters()[0].max);
    let mut time_s = runs[0].scenario.mean_period_s();
    let mut start = hypothesis.clone();
    let mut best: Option<Step> = None;
    while time_s <= longest_s {
        let id = effect.card().id;
        start.model.effects.retain(|own| own.id() != id);
        let active = ActiveEffect::with(effect, &[time_s]);
        start.model.effects.push(active);
        time_s *= LONGER;
        let Some((hypothesis, squares)) = fit_as_followed(&start, runs) else {
            continue;
        };
        let least = best.as_ref().map_or(f64::INFINITY, |best| best.squares);
        if squares > PAST_RATIO * least {
            break;
        }
        start.clone_from(&hypothesis);
        if squares < least {
            best = Some(Step {
                hypothesis,
                squares,
            });
        }
    }
    best
}

/// Whether a candidate stands for something that is in the set.
fn says_the_same(candidate: &Candidate, set: &Set) -> bool {
    candidate.excludes.iter().any(|other| set[*other].is_some())
}

/// For each candidate that is there wholly or not at all its form that leaves least when it is put in and nothing else
/// moves: the fall of the cost, the candidate and the form.
fn as_it_is(linear: &Linear, set: &Set) -> Vec<(f64, usize, usize)> {
    let candidates = linear.candidates.iter().enumerate();
    candidates
        .filter(|(k, candidate)| {
            set[*k].is_none() && candidate.is_whole() && !says_the_same(candidate, set)
        })
        .filter_map(|(k, candidate)| {
            let fall = |variant: &Variant| {
                let (column, size) = (variant.columns[0].at, variant.mean);
                let present = linear.gram.row(column).transpose().dot(&linear.present);
                let right = linear.right[column] - present;
                size * right - 0.5 * size * size * linear.gram[(column, column)]
            };
            let forms = candidate.variants.iter().enumerate();
            forms
                .map(|(form, variant)| (fall(variant), k, form))
                .max_by(|a, b| a.0.total_cmp(&b.0))
        })
        .collect()
}

/// Where a search begins: at the fitted model; or where that is far astray at the one that it was fitted from, refitted
/// along the run, if this leaves less: a free run that lacks much is fitted by what is no machine.
pub(super) fn nearer([fitted, before]: [&Model; 2], runs: Runs<'_>, noise: Noise) -> Hypothesis {
    let led = |model: &Model| runs.first().linearised_runs(&Hypothesis::of(model), noise);
    let left = led(fitted).map(|runs| (squares(&runs), runs[0].follower.rows));
    let is_astray = left.is_none_or(|(left, rows)| left > ASTRAY_MEAN_SQUARE * rows as f64);
    let again = is_astray.then(|| fit_as_followed(&Hypothesis::of(before), &led(before)?));
    match again.flatten() {
        Some((again, squares)) if left.is_none_or(|left| squares < left.0) => again,
        _ => Hypothesis::of(fitted),
    }
}

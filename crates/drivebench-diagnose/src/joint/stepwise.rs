//! Forward stepwise selection (Draper & Smith, *Applied Regression Analysis*, ch. 15) with a nonlinear refit after each step,
//! until the linear solution holds. Delays and lags of commands and readings are scanned over powers of two, because their
//! effect is not linear over steps as long as a time constant of the motor.

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
use super::solution::{present, with_event_times};
use drivebench_model::plant::{ActiveEffect, Effect, Enters, Model, Scenario};

/// A step of the selection: the model with one effect more, and its sum of squares.
type Step = (Hypothesis, f64);

/// Adds at most four effects, each the one with the least sum of squares after its refit, until the linear solution holds or none
/// reduces the squares by 10 % (where it holds already, 100). The steps are found on the first run; every run must be simulable with them.
pub(super) fn forward_selection(
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
        let near = FAR_MEAN_SQUARE * runs[0].gains.rows as f64;
        let is_far = now >= near;
        let is_first = step == 0;
        // Without a measured sensor noise the squares are in units of the fit's own residual and always look near.
        if !is_far && (all.has_floor || !is_first) {
            break;
        }
        let best = || best_step(&hypothesis, eligible, &runs, near);
        let mut found = is_far.then(best).flatten();
        let is_there = |step: &Step| step.1 < near;
        if is_first && !(is_far && found.as_ref().is_some_and(is_there)) {
            let delay = best_delay(&hypothesis, eligible, &runs[0]);
            let steps = found.into_iter().chain(delay);
            found = steps.min_by(|a, b| a.1.total_cmp(&b.1));
        }
        let is_simulated = |next: &Hypothesis| all.linearised_runs(next, noise).is_some();
        // Near the data a delay counts by its likelihood, 50 nats: one that acts once in a run is a small share of the squares.
        let most = if is_far { 0.9 * now } else { now - 100.0 };
        let is_worth = |step: &Step| step.1 < most && is_simulated(&step.0);
        let Some(step) = found.filter(is_worth) else {
            break;
        };
        hypothesis = step.0;
        // The filtered fit finds the backlash, since its gains follow the measured oscillation; a fit by free run would end in a
        // local minimum.
        let has_coupling = |active| terms_of(active).coupling().is_some();
        if hypothesis.model.effects.iter().any(has_coupling)
            && let Some(own) = fit(&hypothesis, &runs).filter(|own| is_simulated(&own.hypothesis))
        {
            hypothesis = own.hypothesis;
        }
    }
    Some(hypothesis)
}

/// Best single effect to add; the search ends at squares below `near`.
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
        // An effect of fixed size is nonlinear in its shape and needs several starts.
        let starts = if candidate.has_fixed_size() { 3 } else { 1 };
        singles.extend(order.into_iter().take(starts).map(|v| (logs[v], k, v)));
    }
    singles.sort_by(|a, b| b.0.total_cmp(&a.0));
    let most = singles.first()?.0;
    singles.truncate(6);
    // For an effect of fixed size the linear estimate of the size is poor, but the squares at that size are exact.
    for gain in fixed_size_gains(linear, &set) {
        if !singles.iter().any(|own| (own.1, own.2) == (gain.1, gain.2)) {
            singles.push(gain);
        }
    }
    singles.retain(|single| single.0 >= 0.2 * most);
    // The refits of an effect of fixed size cost as much as those of all others: they come last.
    singles.sort_by_key(|single| linear.candidates[single.1].has_fixed_size());
    // A second inertia with its play has four parameters, and absorbs a part of whatever is missing: it has to leave half of the squares
    // of the best other effect. Of a servo with a drop of .15 V and a filter of 2 ms it left .54, and the search did not return from it.
    let weighed = |candidate: usize, squares: f64| {
        let has_fixed_size = linear.candidates[candidate].has_fixed_size();
        if has_fixed_size { 2.0 * squares } else { squares }
    };
    let mut best: Option<(usize, Step)> = None;
    let mut take = |candidate: usize, variant: usize| {
        let mut with = set.clone();
        with[candidate] = Some(variant);
        let start = with_event_times(hypothesis, &reduced, &with, runs)?;
        if !is_resolved(&start.model, runs[0].scenario) {
            return None;
        }
        // All are fitted with the same noise: far from the data the likelihood would prefer a larger error of form.
        let step = fit_as_followed(&start, runs)?;
        if !is_resolved(&step.0.model, runs[0].scenario) {
            return None;
        }
        let own = weighed(candidate, step.1);
        if best.as_ref().is_none_or(|best| own < weighed(best.0, best.1.1)) {
            best = Some((candidate, step));
        }
        best.as_ref().map(|best| (best.0, best.1.1))
    };
    let mut leads: Option<(usize, f64)> = None;
    for (_, candidate, variant) in &singles {
        // Nor are they needed where the linear solution holds with another effect.
        let has_fixed_size = linear.candidates[*candidate].has_fixed_size();
        if has_fixed_size && leads.is_some_and(|leads| leads.1 < near) {
            continue;
        }
        leads = take(*candidate, *variant).or(leads);
    }
    // A start too far away ends in a local minimum: try the other forms of the best candidate too.
    if let Some((candidate, mut squares)) = leads
        && linear.candidates[candidate].has_fixed_size()
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

/// Whether every oscillation lies below half the sampling rate: another would not be named.
fn is_resolved(model: &Model, scenario: &Scenario) -> bool {
    let most_hz = 0.5 / scenario.mean_period_s();
    model.effects.iter().all(|active| {
        let mut values = active.effect.parameters().iter().zip(active.values_or_guess());
        values.all(|(spec, value)| spec.unit != "Hz" || value <= most_hz)
    })
}

/// Best single delay or lag of the commands or readings, scanned on the first 5000 samples and refitted to the whole run.
fn best_delay(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    run: &LinearisedRun<'_>,
) -> Option<Step> {
    let scenario = run.scenario.stretch(0..run.scenario.samples().min(5000));
    let beginning = [run.relinearised(&hypothesis.model, vec![], &scenario)?];
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
    let steps = effects
        .into_par_iter()
        .with_max_len(1)
        .filter_map(|effect| scan_delay(hypothesis, effect, &beginning));
    let best = steps.collect::<Vec<Step>>().into_iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let whole = run.relinearised(&hypothesis.model, vec![], run.scenario)?;
    fit_as_followed(&best.0, &[whole])
}

/// Best time of one effect by a scan from one sample period to a tenth of the run in powers of two, each refitted from the
/// result of the one before.
fn scan_delay(
    hypothesis: &Hypothesis,
    effect: &'static dyn Effect,
    runs: &[LinearisedRun<'_>],
) -> Option<Step> {
    let times = &runs[0].scenario.sample_time_s;
    let length_s = times.last()? - times.first()?;
    let longest_s =
        (0.1 * length_s).min(effect.parameters()[0].in_run(&runs[0].scenario.scales).max);
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
        // Longer times fit still worse.
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

/// For each absent candidate of fixed size its best form with all other coefficients unchanged: the decrease of half the sum of
/// squares, the candidate and the form.
fn fixed_size_gains(linear: &Linear, set: &Set) -> Vec<(f64, usize, usize)> {
    let candidates = linear.candidates.iter().enumerate();
    candidates
        .filter(|(k, candidate)| {
            set[*k].is_none() && candidate.has_fixed_size() && !is_excluded(candidate, set)
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

/// Model to start the search from: the fitted one; or the other one, if its squares are less: that of an earlier search as it is, and
/// where the mean square of the fitted one exceeds 100 the given one, refitted by the filter: fitting the free run of an incomplete model
/// may end at parameters that no machine has.
pub(super) fn starting_model(
    [fitted, before]: [&Model; 2],
    runs: Runs<'_>,
    noise: Noise,
) -> Hypothesis {
    let along = |model: &Model| runs.first().linearised_runs(&Hypothesis::of(model), noise);
    let left = along(fitted).map(|runs| (squares(&runs), runs[0].gains.rows));
    let is_far = left.is_none_or(|(left, rows)| left > 100.0 * rows as f64);
    let other = if is_searched([fitted, before]) {
        along(before).map(|runs| (Hypothesis::of(before), squares(&runs)))
    } else {
        let again = is_far.then(|| fit_as_followed(&Hypothesis::of(before), &along(before)?));
        again.flatten()
    };
    match other {
        Some((other, squares)) if left.is_none_or(|left| squares < left.0) => other,
        _ => Hypothesis::of(fitted),
    }
}

/// Whether the second of two models is that of an earlier search, which alone has effects that the fitted one lacks.
pub(super) fn is_searched([fitted, before]: [&Model; 2]) -> bool {
    fitted.effects.len() < before.effects.len()
}

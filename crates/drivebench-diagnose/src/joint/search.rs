//! Search for the set of effects by iterated linearisation (Gauss-Newton): linearise, select, refit, until set and noise are stable.
//!
//! ```text
//! far from the data   stepwise: forward selection by refits, until the linear solution holds
//! near                linearise -> noise -> linearise -> posterior over the sets -> refit of the best set -> ...
//! ```

use super::columns::linearise;
use super::events::Hypothesis;
use super::free_run::{Unpredicted, disturbance_error, unpredicted};
use super::kalman::Noise;
use super::noise::maximum_likelihood;
use super::prediction_error::fit;
use super::refits::{RefitVerdict, Weighed, bar, keep_doubts, needed};
use super::regression::{Candidate, Linear};
use super::residuals::{excess_of, unknown_shares};
use super::run::{LinearisedRun, squares};
use super::select::{Posterior, Reduced, Set, select};
use super::solution::{FittedEvent, fitted_events, linearised_runs, present, with_event_times};
use super::stepwise::{forward_selection, is_searched, starting_model};
use crate::progress::{Event as Notice, Progress, Stage};
use crate::work::Work;
use drivebench_model::plant::{Effect, Input, Model, ParameterSpec, Scenario, State};

/// Limits of the iteration, each in rounds of selection and refit.
struct Limits {
    with_voltage_input: usize,
    /// Fewer, because the problem is linear.
    with_torque_input: usize,
    /// First rounds in which the noise is estimated.
    of_noise: usize,
    /// Further rounds because an event time has changed.
    of_event_times: usize,
    /// Probability below which an effect of fixed size is left out of the next rounds.
    improbable: f64,
}

const LIMITS: Limits = Limits {
    with_voltage_input: 12,
    with_torque_input: 5,
    of_noise: 3,
    of_event_times: 3,
    improbable: 0.01,
};

/// Result of the search.
pub(super) struct SearchResult {
    /// The best set, fitted to all runs, and its events with their times.
    pub(super) hypothesis: Hypothesis,
    pub(super) fitted_events: Vec<FittedEvent>,
    /// The linear problem around it, with the excess of what is left.
    pub(super) reduced: Reduced,
    pub(super) posterior: Posterior,
    /// Noise parameters of the runs.
    pub(super) noise: Noise,
    /// Long-run variance of the residuals of the best set over that of white noise, at least 1.
    pub(super) excess: f64,
    /// Root mean squares of current, A, and speed, rad/s, that the disturbance makes in a free run of the held-out run.
    pub(super) disturbance_error: [f64; 2],
    /// The same for its holes and its stamps.
    pub(super) unpredicted: Unpredicted<[f64; 2]>,
    /// For each candidate that is an unknown function in the best set, its share of the squared residuals.
    pub(super) unknown_share: Vec<f64>,
    /// Whether the budget was spent before set and noise were stable.
    pub(super) is_cut: bool,
}

/// Effects of a set, each with the runs in which it is an event.
type Names = Vec<(&'static str, Vec<usize>)>;

/// Whether a set is stable: equal to the one before it or an earlier one; the first of several counts only for the second, because
/// no refit preceded it.
fn was_visited(visited: &[Names], set: &Names) -> bool {
    match visited {
        [first] => first == set,
        _ => visited.iter().skip(1).any(|had| had == set),
    }
}

/// Whether a set has a new event and no new effect of fixed size, for which the linear solution does not hold. The time of such an
/// event is refined before the noise is estimated: on the coarse grid of times its residual would be taken for a disturbance.
fn has_new_event(linear: &Linear, set: &Set) -> bool {
    let candidates = linear.candidates.iter().zip(set);
    let mut new = candidates
        .filter(|(candidate, form)| form.is_some() && !candidate.in_model)
        .map(|(candidate, _)| candidate);
    new.clone().any(Candidate::is_event) && !new.any(Candidate::has_fixed_size)
}

/// Whether two noise models differ so much that the runs have to be filtered and linearised again.
fn differs(noise: &Noise, before: &Noise) -> bool {
    let change = |a: f64, b: f64| (a / b).ln().abs();
    change(noise.disturbance_n_m, before.disturbance_n_m) > 0.2
        || change(noise.input, before.input) > 0.3
}

/// Effects of a set, each with the runs in which it is an event.
fn names(linear: &Linear, set: &Set) -> Names {
    let candidates = linear.candidates.iter().zip(set);
    let named = candidates.filter_map(|(candidate, chosen)| {
        let runs = candidate.variants[(*chosen)?].event_times();
        Some((candidate.id, runs.map(|event_time| event_time.0).collect()))
    });
    named.collect()
}

fn improbable(linear: &Linear, posterior: &Posterior) -> Vec<&'static str> {
    let candidates = linear.candidates.iter().zip(&posterior.probability);
    let is_improbable = |(candidate, p): &(&Candidate, &f64)| {
        candidate.has_fixed_size() && !candidate.in_model && **p < LIMITS.improbable
    };
    candidates.filter(is_improbable).map(|(candidate, _)| candidate.id).collect()
}

/// Runs of a diagnosis, their initial states and the index of the held-out run.
#[derive(Clone, Copy)]
pub(super) struct Runs<'a> {
    pub(super) scenarios: &'a [&'a Scenario],
    pub(super) starts: &'a [State],
    pub(super) held_out: usize,
    /// Whether the sensor noise was measured, at standstill, rather than taken from the residual of a fit.
    pub(super) has_floor: bool,
    pub(super) work: &'a Work,
}

impl<'a> Runs<'a> {
    /// All runs, linearised about a hypothesis.
    pub(super) fn linearised_runs(
        &self,
        hypothesis: &Hypothesis,
        noise: Noise,
    ) -> Option<Vec<LinearisedRun<'a>>> {
        let work = Some(self.work);
        linearised_runs(hypothesis, self.scenarios, self.starts, noise, work)
    }

    /// The first run alone.
    pub(super) fn first(&self) -> Self {
        Self { scenarios: &self.scenarios[..1], starts: &self.starts[..1], ..*self }
    }
}

/// Searches the sets of `eligible` effects, from `models`: the fitted model and the one before the fit. `floor` is the initial
/// noise, with the sensor noise at standstill. A refit may end at parameters that cannot be simulated or linearised; the result
/// is then the last model that could. `None` if the first one cannot.
pub(super) fn search(
    models: [&Model; 2],
    eligible: &[&'static dyn Effect],
    runs: Runs<'_>,
    floor: Noise,
    progress: Progress<'_>,
) -> Option<SearchResult> {
    // An earlier search has tried them: they are tried again when the set is stable.
    let tried = eligible.iter().filter(|effect| is_searched(models) && has_fixed_size(**effect));
    let mut search = Search {
        improbable: tried.map(|effect| effect.card().id).collect(),
        eligible,
        runs,
        floor,
        noise: floor,
        is_near: false,
        verdicts: Vec::new(),
        replaced: None,
        last: Hypothesis::of(models[0]),
    };
    search.rounds(models, progress).or_else(|| {
        search.improbable.clear();
        search.result_at_last()
    })
}

fn has_fixed_size(effect: &dyn Effect) -> bool {
    !effect.parameters().iter().any(ParameterSpec::is_coefficient)
}

/// State of the iteration.
struct Search<'a> {
    eligible: &'a [&'static dyn Effect],
    runs: Runs<'a>,
    floor: Noise,
    /// Present estimate of the noise, and whether the initial model was near the data, by [`noise_of_model`].
    noise: Noise,
    is_near: bool,
    /// Results of refits, and the effect that replaces a richer one or two others.
    verdicts: Vec<RefitVerdict>,
    replaced: Option<&'static str>,
    /// The last model that could be simulated and linearised, initially the fitted one.
    last: Hypothesis,
    /// Effects of fixed size that the last selection found improbable: each of their forms costs a simulation of every run, so that
    /// they are left out until the set is stable.
    improbable: Vec<&'static str>,
}

impl<'a> Search<'a> {
    fn linearised_runs(&self, hypothesis: &Hypothesis) -> Option<Vec<LinearisedRun<'a>>> {
        self.runs.linearised_runs(hypothesis, self.noise)
    }

    /// Far from the data neither unknown curves nor new effects of fixed size are candidates: the linear solution does not hold for
    /// them, and a refit with an absent coupling is slow.
    fn linearised(
        &self,
        hypothesis: &Hypothesis,
        runs: &[LinearisedRun<'_>],
        is_far: bool,
    ) -> Option<Linear> {
        let is_tried = |effect: &&&'static dyn Effect| {
            let id = effect.card().id;
            let is_left_out = (is_far && has_fixed_size(**effect)) || self.improbable.contains(&id);
            !is_left_out || hypothesis.model.has(id)
        };
        let eligible: Vec<_> = self.eligible.iter().filter(is_tried).copied().collect();
        let mut linear = linearise(hypothesis, &eligible, runs, !is_far)?;
        bar(&mut linear, &self.verdicts, self.replaced);
        Some(linear)
    }

    /// Result at the last model that could be simulated and evaluated.
    fn result_at_last(&self) -> Option<SearchResult> {
        let runs = self.linearised_runs(&self.last)?;
        let reduced = Reduced::new(self.linearised(&self.last, &runs, false)?, 1.0, true)?;
        let posterior = posterior_of(&reduced);
        self.result(self.last.clone(), (reduced, posterior), &runs, false)
    }

    /// Linearises, selects and refits until set and noise are stable. With a torque input no forward selection is needed: the
    /// equation of motion is linear in all coefficients, however far the model is from the data.
    fn rounds(&mut self, models: [&Model; 2], progress: Progress<'_>) -> Option<SearchResult> {
        let (eligible, floor, scenarios) = (self.eligible, self.floor, self.runs.scenarios);
        let by_voltage = scenarios[0].input == Input::Voltage;
        let given = models[0].effect_ids();
        let mut hypothesis = Hypothesis::of(models[0]);
        if by_voltage {
            hypothesis = starting_model(models, self.runs, floor);
            hypothesis = forward_selection(hypothesis, eligible, self.runs, floor)?;
        }
        (self.noise, self.is_near) = noise_of_model(&hypothesis, eligible, self.runs, [floor; 2])?;
        let is_near = self.is_near;
        let (mut visited, mut moves): (Vec<Names>, usize) = (vec![], 0);
        let rounds = [LIMITS.with_torque_input, LIMITS.with_voltage_input][usize::from(by_voltage)];
        let mut round = 0;
        while round < rounds {
            let is_far = round == 0 && !is_near;
            let mut runs = self.linearised_runs(&hypothesis)?;
            let linear = self.linearised(&hypothesis, &runs, is_far)?;
            let mut reduced = Reduced::new(linear, 1.0, true)?;
            if round == 0 {
                report_shares(&reduced, progress);
                progress(Notice::Begun { stage: Stage::Check, of: 0 });
            }
            let (mut posterior, filtered_with) = (posterior_of(&reduced), self.noise);
            let is_first = by_voltage && is_near && round == 0;
            let is_to_be_placed = is_first && has_new_event(&reduced.linear, &posterior.best);
            if round < LIMITS.of_noise && !is_to_be_placed {
                // A large disturbance explains what an effect would; started from a small one, the effects enter first.
                let from = [self.noise, floor][usize::from(round == 0 && !is_near)];
                let better = maximum_likelihood(&runs, &reduced, &posterior.forms, &floor, from);
                if differs(&better, &self.noise) {
                    self.noise = better;
                }
            }
            let mut is_settled = self.noise == filtered_with;
            // More noise supports fewer effects; far from the data, less noise supports others: select again.
            if self.noise.disturbance_n_m > filtered_with.disturbance_n_m
                || (!is_near && !is_settled)
            {
                let filtered = self.linearised_runs(&hypothesis)?;
                let is_more = self.noise.disturbance_n_m > filtered_with.disturbance_n_m;
                if is_more && squares(&filtered) > squares(&runs) {
                    // More noise makes no innovation larger, except where the filter diverges: its gains are then too large for
                    // the delays of the model.
                    self.noise = filtered_with;
                } else {
                    runs = filtered;
                    let linear = self.linearised(&hypothesis, &runs, is_far)?;
                    reduced = Reduced::new(linear, 1.0, true)?;
                    posterior = posterior_of(&reduced);
                }
                is_settled = true;
            }
            self.last = hypothesis.clone();
            let set = names(&reduced.linear, &posterior.best);
            let start = with_event_times(&hypothesis, &reduced, &posterior.best, &runs)?;
            let stays = moves == LIMITS.of_event_times || start.events_stay(&hypothesis, scenarios);
            moves += usize::from(!stays);
            // Near the data a model to which the selection adds nothing is not linearised twice.
            let is_complete =
                visited.is_empty() && is_near && posterior.best == present(&reduced.linear);
            let is_stable = stays && is_settled && (is_complete || was_visited(&visited, &set));
            // With a torque input the equation of motion is linear, and a refit has nothing to refute.
            let is_last = round + 1 == rounds || self.runs.work.is_spent();
            if (is_stable || is_last) && !self.improbable.is_empty() {
                self.improbable.clear();
                continue;
            }
            round += 1;
            self.improbable.extend(improbable(&reduced.linear, &posterior));
            if by_voltage && is_stable && !is_last {
                let weighed = Weighed {
                    hypothesis: &hypothesis,
                    reduced: &reduced,
                    posterior: &posterior,
                    runs: &runs,
                };
                if let Some(other) = self.refuted_by_refits(&weighed, &given) {
                    visited.clear();
                    hypothesis = other;
                    continue;
                }
            }
            if is_stable || is_last {
                return self.result(hypothesis, (reduced, posterior), &runs, is_stable);
            }
            visited.push(set);
            if !is_settled {
                runs = self.linearised_runs(&hypothesis)?;
            }
            let (kept, next) = refitted(&hypothesis, &start, &runs, &self.verdicts);
            if !kept.is_empty() {
                self.verdicts.extend(kept);
                visited.clear();
            } else if let Some(next) = next {
                hypothesis = next;
                // What is fitted no longer counts as random.
                if is_near && (is_to_be_placed || !is_settled) {
                    let known = [floor, self.noise];
                    self.noise = noise_of_model(&hypothesis, eligible, self.runs, known)
                        .map_or(self.noise, |known| known.0);
                }
            }
        }
        None
    }

    /// Result for the stable set. If the residuals exceed white noise, the posterior is computed again with the information
    /// divided by the excess.
    fn result(
        &self,
        hypothesis: Hypothesis,
        (mut reduced, mut posterior): (Reduced, Posterior),
        runs: &[LinearisedRun<'_>],
        is_stable: bool,
    ) -> Option<SearchResult> {
        let excess = excess_of(&reduced, &posterior.best, runs);
        let unknown_share = unknown_shares(&reduced, &posterior.best, runs)?;
        let held_out = runs.get(self.runs.held_out)?;
        let (disturbance_error, unpredicted) = (disturbance_error(held_out), unpredicted(held_out));
        if excess > 1.0 {
            reduced = Reduced::new(reduced.linear, excess, true)?;
            let sets = [posterior.best.clone(), present(&reduced.linear)];
            posterior = select(&reduced, &sets);
        }
        keep_doubts(&self.verdicts, &reduced.linear, &mut posterior);
        let fitted_events = fitted_events(&reduced, &posterior.best, runs, excess)?;
        Some(SearchResult {
            hypothesis,
            fitted_events,
            reduced,
            posterior,
            noise: self.noise,
            excess,
            disturbance_error,
            unpredicted,
            unknown_share,
            is_cut: !is_stable && self.runs.work.is_spent(),
        })
    }

    /// Model to continue with if refits refute a stable set: with one effect instead of two, or without a refuted effect.
    fn refuted_by_refits(
        &mut self,
        weighed: &Weighed<'_>,
        given: &[&'static str],
    ) -> Option<Hypothesis> {
        if self.replaced.is_none()
            && let Some((simple, simpler)) = weighed.simpler(given)
        {
            self.replaced = Some(simple);
            return Some(simpler);
        }
        let (doubt, without) = weighed.doubtful(given)?;
        self.verdicts.push(doubt);
        Some(without)
    }
}

/// Posterior of the sets, searched from the empty set and from that of the model.
fn posterior_of(reduced: &Reduced) -> Posterior {
    let nothing = vec![None; reduced.linear.candidates.len()];
    select(reduced, &[nothing, present(&reduced.linear)])
}

/// Refit of `start`: effects of `hypothesis` whose removal the refit refutes, or the hypothesis to continue with; `None` where the
/// fit fails.
fn refitted(
    hypothesis: &Hypothesis,
    start: &Hypothesis,
    runs: &[LinearisedRun<'_>],
    verdicts: &[RefitVerdict],
) -> (Vec<RefitVerdict>, Option<Hypothesis>) {
    let Some(next) = fit(start, runs) else {
        return (Vec::new(), None);
    };
    let mut kept = needed(hypothesis, &next, runs);
    kept.retain(|own| !verdicts.contains(own));
    // A new set whose squares are 5 % larger has ended in a local minimum.
    let is_accepted = start.ids() == hypothesis.ids() || next.squares < 1.05 * squares(runs);
    let continues = kept.is_empty() && is_accepted;
    (kept, continues.then_some(next.hypothesis))
}

/// Initial noise, and whether the model is near the data: a mean square of the standardised innovations of at most 1.5. Near the
/// data it is the maximum-likelihood noise of the model's own innovations, otherwise `known`.
fn noise_of_model(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    runs: Runs<'_>,
    [floor, known]: [Noise; 2],
) -> Option<(Noise, bool)> {
    let runs = runs.linearised_runs(hypothesis, known)?;
    let rows: usize = runs.iter().map(|run| run.gains.rows).sum();
    if squares(&runs) > 1.5 * rows as f64 {
        return Some((known, false));
    }
    let is_present = |effect: &&&'static dyn Effect| hypothesis.model.has(effect.card().id);
    let effects: Vec<&'static dyn Effect> = eligible.iter().filter(is_present).copied().collect();
    let linear = linearise(hypothesis, &effects, &runs, false)?;
    let forms = vec![0; linear.candidates.len()];
    let reduced = Reduced::new(linear, 1.0, true)?;
    let noise = maximum_likelihood(&runs, &reduced, &forms, &floor, known);
    // A larger disturbance would explain what the missing effects do.
    let is_less = noise.disturbance_n_m <= known.disturbance_n_m;
    Some((if is_less { noise } else { known }, true))
}

/// Reports the share of the squares that each effect alone would explain.
fn report_shares(reduced: &Reduced, progress: Progress<'_>) {
    let candidates = &reduced.linear.candidates;
    for (k, candidate) in candidates.iter().enumerate() {
        if k == 0 || candidates[k - 1].id != candidate.id {
            progress(Notice::Screened { effect: candidate.id, share: reduced.share_alone(k) });
        }
    }
}

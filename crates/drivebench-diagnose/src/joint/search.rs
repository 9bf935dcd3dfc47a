//! Search for the set of effects by Gauss-Newton: linearised, weighed, refitted and linearised anew until set and noise stand.
//!
//! ```text
//! far from the data   approach: the single effect that, refitted, explains most joins, until the linear solution holds
//! near                linearise -> noise -> linearise -> posterior over the sets -> refit of the best set -> ...
//! ```

use super::columns::linearise;
use super::events::Hypothesis;
use super::free_run::{disturbance_error, unobserved};
use super::kalman::Noise;
use super::leftover::{excess_of, unknown_shares};
use super::noise::likeliest;
use super::prediction_error::fit;
use super::refits::{RefitVerdict, Weighed, bar, bar_wholes, keep_doubts, needed};
use super::regression::{Candidate, Linear};
use super::run::{LinearisedRun, squares};
use super::select::{Posterior, Reduced, Set, select};
use super::solution::{Happened, happened, linearised_runs, placed, present};
use super::stepwise::{approach, nearer};
use crate::progress::{Event as Notice, Progress, Stage};
use crate::work::Work;
use drivebench_model::plant::{Effect, Input, Model, Scenario, State};

/// Rounds of weighing and refitting, also where a torque drives: all is linear there, and what does not settle is not in the
/// catalogue. In the first three the noise is found too.
const MOST_ROUNDS: usize = 12;
const MOST_ROUNDS_BY_TORQUE: usize = 5;
const NOISE_ROUNDS: usize = 3;
/// Rounds that are spent because an event was found at another moment.
const MOST_MOVES: usize = 3;

/// What the search ends with.
pub(super) struct SearchResult {
    /// The best set, fitted on all runs, and when its events happened.
    pub(super) hypothesis: Hypothesis,
    pub(super) happened: Vec<Happened>,
    /// The linear problem around it, with the excess of what is left.
    pub(super) reduced: Reduced,
    pub(super) posterior: Posterior,
    /// What is random in the runs.
    pub(super) noise: Noise,
    /// Excess of what the best set leaves over white noise.
    pub(super) excess: f64,
    /// Root mean squares of current, A, and speed, rad/s, that the disturbance makes in a free run of the held-out run.
    pub(super) disturbance_error: [f64; 2],
    /// The same of what the holes of its record make.
    pub(super) unobserved: [f64; 2],
    /// For each candidate that is an unknown part of the best set, its share of the error.
    pub(super) unknown_share: Vec<f64>,
    /// Whether the budget was spent before set and noise stood.
    pub(super) is_cut: bool,
}

/// Names of a set, each with the runs in which it is one that happens.
type Names = Vec<(&'static str, Vec<usize>)>;

/// Whether a set stands: the one before it was the same, or one before that, but for the first, which is of no refit.
fn was_visited(visited: &[Names], set: &Names) -> bool {
    match visited {
        [first] => first == set,
        _ => visited.iter().skip(1).any(|had| had == set),
    }
}

/// Whether a set has an event that the model lacks, and nothing new that is there wholly or not at all, for which no linear
/// solution holds. Put only to a part of a second an event leaves what a disturbance of the load would explain better: it is
/// placed before the noise is found.
fn has_new_event(linear: &Linear, set: &Set) -> bool {
    let candidates = linear.candidates.iter().zip(set);
    let new = candidates.filter(|(candidate, form)| form.is_some() && !candidate.in_model);
    let mut new = new.map(|(candidate, _)| candidate);
    new.clone().any(Candidate::is_event) && !new.any(Candidate::is_whole)
}

/// Whether so much else is random that runs have to be linearised anew.
fn is_another(noise: &Noise, before: &Noise) -> bool {
    let change = |a: f64, b: f64| (a / b).ln().abs();
    change(noise.disturbance_n_m, before.disturbance_n_m) > 0.2
        || change(noise.input, before.input) > 0.3
}

/// The candidates of a set by their names, each with the runs in which it is one that happens.
fn names(linear: &Linear, set: &Set) -> Names {
    let candidates = linear.candidates.iter().zip(set);
    let named = candidates.filter_map(|(candidate, chosen)| {
        let runs = candidate.variants[(*chosen)?].moments();
        Some((candidate.id, runs.map(|moment| moment.0).collect()))
    });
    named.collect()
}

/// All runs of an answer, where each starts, and the place of the one that is held out.
#[derive(Clone, Copy)]
pub(super) struct Runs<'a> {
    pub(super) scenarios: &'a [&'a Scenario],
    pub(super) starts: &'a [State],
    pub(super) held_out: usize,
    /// Whether the noise of the sensors is known, and not the residual of a fit.
    pub(super) has_floor: bool,
    pub(super) work: &'a Work,
}

impl<'a> Runs<'a> {
    /// All of them around a hypothesis.
    pub(super) fn linearised_runs(
        &self,
        hypothesis: &Hypothesis,
        noise: Noise,
    ) -> Option<Vec<LinearisedRun<'a>>> {
        let work = Some(self.work);
        linearised_runs(hypothesis, self.scenarios, self.starts, noise, work)
    }

    /// The first of them.
    pub(super) fn first(&self) -> Self {
        Self { scenarios: &self.scenarios[..1], starts: &self.starts[..1], ..*self }
    }
}

/// Searches from a fitted model on, or from the one that it was fitted from, for the `eligible`, among them what the model has
/// already; `floor` is the noise to begin with, whose sensors are those at rest. A refit may end where the model is no machine,
/// or has sensors that are much too late, so that no column means anything: then the last model that could be simulated and
/// weighed is the answer. `None` where not even the first one can.
pub(super) fn search(
    models: [&Model; 2],
    eligible: &[&'static dyn Effect],
    runs: Runs<'_>,
    floor: Noise,
    progress: Progress<'_>,
) -> Option<SearchResult> {
    let mut search = Search {
        eligible,
        runs,
        floor,
        noise: floor,
        is_near: false,
        verdicts: Vec::new(),
        replaced: None,
        last: Hypothesis::of(models[0]),
    };
    search.rounds(models, progress).or_else(|| search.ended_at_last())
}

/// A search on its way.
struct Search<'a> {
    eligible: &'a [&'static dyn Effect],
    runs: Runs<'a>,
    floor: Noise,
    /// What is random as far as it is known, and whether little was missing to begin with.
    noise: Noise,
    is_near: bool,
    /// What refits found, and the simple effect that stands for a richer one or for two.
    verdicts: Vec<RefitVerdict>,
    replaced: Option<&'static str>,
    /// The last model that could be simulated and weighed: at first what the search began with.
    last: Hypothesis,
}

impl<'a> Search<'a> {
    fn linearised_runs(&self, hypothesis: &Hypothesis) -> Option<Vec<LinearisedRun<'a>>> {
        self.runs.linearised_runs(hypothesis, self.noise)
    }

    /// Far from the data neither unknown curves are eligible, nor anything new that is there wholly or not at all: no linear
    /// solution holds for that, and a refit with a coupling that is not there is slow and in vain.
    fn linearised(
        &self,
        hypothesis: &Hypothesis,
        runs: &[LinearisedRun<'_>],
        is_far: bool,
    ) -> Option<Linear> {
        let mut linear = linearise(hypothesis, self.eligible, runs, !is_far)?;
        bar(&mut linear, &self.verdicts, self.replaced);
        if is_far {
            bar_wholes(&mut linear);
        }
        Some(linear)
    }

    /// The answer at the last model that could be simulated and weighed.
    fn ended_at_last(&self) -> Option<SearchResult> {
        let runs = self.linearised_runs(&self.last)?;
        let reduced = Reduced::new(self.linearised(&self.last, &runs, false)?, 1.0, true)?;
        let posterior = weigh(&reduced);
        self.ended(self.last.clone(), (reduced, posterior), &runs, false)
    }

    /// Weighs, refits and linearises anew until set and noise stand. Where a torque drives no step by step approach is needed:
    /// the balance is linear, however much is missing.
    fn rounds(&mut self, models: [&Model; 2], progress: Progress<'_>) -> Option<SearchResult> {
        let (eligible, floor) = (self.eligible, self.floor);
        let scenarios = self.runs.scenarios;
        let by_voltage = scenarios[0].input == Input::Voltage;
        let given = models[0].effect_ids();
        let mut hypothesis = Hypothesis::of(models[0]);
        if by_voltage {
            hypothesis = nearer(models, self.runs, floor);
            hypothesis = approach(hypothesis, eligible, self.runs, floor)?;
        }
        (self.noise, self.is_near) = first_noise(&hypothesis, eligible, self.runs, [floor; 2])?;
        let is_near = self.is_near;
        let (mut visited, mut moves): (Vec<Names>, usize) = (vec![], 0);
        let rounds = [MOST_ROUNDS_BY_TORQUE, MOST_ROUNDS][usize::from(by_voltage)];
        for round in 0..rounds {
            let is_far = round == 0 && !is_near;
            let mut runs = self.linearised_runs(&hypothesis)?;
            let linear = self.linearised(&hypothesis, &runs, is_far)?;
            let mut reduced = Reduced::new(linear, 1.0, true)?;
            if round == 0 {
                screened(&reduced, progress);
                progress(Notice::Begun { stage: Stage::Check, of: 0 });
            }
            let (mut posterior, filtered_with) = (weigh(&reduced), self.noise);
            let is_first = by_voltage && is_near && round == 0;
            let is_to_be_placed = is_first && has_new_event(&reduced.linear, &posterior.best);
            if round < NOISE_ROUNDS && !is_to_be_placed {
                // A disturbance of the load explains what an effect would: from little of it on the effects come first.
                let from = [self.noise, floor][usize::from(round == 0 && !is_near)];
                let better = likeliest(&runs, &reduced, &posterior.forms, &floor, from);
                if is_another(&better, &self.noise) {
                    self.noise = better;
                }
            }
            let mut is_settled = self.noise == filtered_with;
            // With more noise fewer effects are supported; far from the data with less of it others are.
            if self.noise.disturbance_n_m > filtered_with.disturbance_n_m
                || (!is_near && !is_settled)
            {
                runs = self.linearised_runs(&hypothesis)?;
                let linear = self.linearised(&hypothesis, &runs, is_far)?;
                reduced = Reduced::new(linear, 1.0, true)?;
                posterior = weigh(&reduced);
                is_settled = true;
            }
            self.last = hypothesis.clone();
            let set = names(&reduced.linear, &posterior.best);
            let start = placed(&hypothesis, &reduced, &posterior.best, &runs)?;
            let stays = moves == MOST_MOVES || start.events_stay(&hypothesis, scenarios);
            moves += usize::from(!stays);
            // Near the data a model that lacks nothing need not be linearised twice.
            let is_whole =
                visited.is_empty() && is_near && posterior.best == present(&reduced.linear);
            let stands = stays && is_settled && (is_whole || was_visited(&visited, &set));
            // Where a torque drives, the balance of torques decides instead.
            let is_last = round + 1 == rounds || self.runs.work.is_spent();
            if by_voltage && stands && !is_last {
                let weighed = Weighed {
                    hypothesis: &hypothesis,
                    reduced: &reduced,
                    posterior: &posterior,
                    runs: &runs,
                };
                if let Some(other) = self.contested(&weighed, &given) {
                    visited.clear();
                    hypothesis = other;
                    continue;
                }
            }
            if stands || is_last {
                return self.ended(hypothesis, (reduced, posterior), &runs, stands);
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
                    self.noise = first_noise(&hypothesis, eligible, self.runs, known)
                        .map_or(self.noise, |known| known.0);
                }
            }
        }
        None
    }

    /// The answer where set and noise stand: the posterior again where what is left is more than white noise.
    fn ended(
        &self,
        hypothesis: Hypothesis,
        (mut reduced, mut posterior): (Reduced, Posterior),
        runs: &[LinearisedRun<'_>],
        stands: bool,
    ) -> Option<SearchResult> {
        let excess = excess_of(&reduced, &posterior.best, runs);
        let unknown_share = unknown_shares(&reduced, &posterior.best, runs)?;
        let held_out = runs.get(self.runs.held_out)?;
        let (disturbance_error, unobserved) = (disturbance_error(held_out), unobserved(held_out));
        if excess > 1.0 {
            reduced = Reduced::new(reduced.linear, excess, true)?;
            let sets = [posterior.best.clone(), present(&reduced.linear)];
            posterior = select(&reduced, &sets);
        }
        keep_doubts(&self.verdicts, &reduced.linear, &mut posterior);
        let happened = happened(&reduced, &posterior.best, runs, excess)?;
        Some(SearchResult {
            hypothesis,
            happened,
            reduced,
            posterior,
            noise: self.noise,
            excess,
            disturbance_error,
            unobserved,
            unknown_share,
            is_cut: !stands && self.runs.work.is_spent(),
        })
    }

    /// What a set that stands gives way to where refits refute it: the model with one effect for two, or that
    /// without an effect that they refute.
    fn contested(&mut self, weighed: &Weighed<'_>, given: &[&'static str]) -> Option<Hypothesis> {
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

/// The posterior from no effect and from those of the model on.
fn weigh(reduced: &Reduced) -> Posterior {
    let nothing = vec![None; reduced.linear.candidates.len()];
    select(reduced, &[nothing, present(&reduced.linear)])
}

/// What a refit of `start` finds: effects of `hypothesis` that have to stay, or the hypothesis to go on from. What cannot
/// be refitted stays as it was.
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
    // A twentieth more of the squares is another minimum.
    let stands = start.ids() == hypothesis.ids() || next.squares < 1.05 * squares(runs);
    let goes_on = kept.is_empty() && stands;
    (kept, goes_on.then_some(next.hypothesis))
}

/// The noise to begin with, from `known` on, and whether little is missing, by a mean square of 1.5: then it follows from what
/// the model itself leaves, at little cost.
fn first_noise(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    runs: Runs<'_>,
    [floor, known]: [Noise; 2],
) -> Option<(Noise, bool)> {
    let runs = runs.linearised_runs(hypothesis, known)?;
    let rows: usize = runs.iter().map(|run| run.follower.rows).sum();
    if squares(&runs) > 1.5 * rows as f64 {
        return Some((known, false));
    }
    let own = |effect: &&&'static dyn Effect| hypothesis.model.has(effect.card().id);
    let own: Vec<&'static dyn Effect> = eligible.iter().filter(own).copied().collect();
    let linear = linearise(hypothesis, &own, &runs, false)?;
    let forms = vec![0; linear.candidates.len()];
    let reduced = Reduced::new(linear, 1.0, true)?;
    let noise = likeliest(&runs, &reduced, &forms, &floor, known);
    // A disturbance of the load would explain what is missing: it is not taken for more than was thought.
    let is_less = noise.disturbance_n_m <= known.disturbance_n_m;
    Some((if is_less { noise } else { known }, true))
}

/// Reports what each effect would explain by itself.
fn screened(reduced: &Reduced, progress: Progress<'_>) {
    let candidates = &reduced.linear.candidates;
    for (k, candidate) in candidates.iter().enumerate() {
        if k == 0 || candidates[k - 1].id != candidate.id {
            progress(Notice::Screened { effect: candidate.id, share: reduced.share_alone(k) });
        }
    }
}

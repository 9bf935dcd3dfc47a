//! Search for the set of effects by Gauss-Newton: linearised, weighed, refitted and linearised anew until set and noise stand.
//!
//! ```text
//! far from the data   approach: the single effect that, refitted, explains most joins, until the linear solution holds
//! near                linearise -> noise -> linearise -> posterior over the sets -> refit of the best set -> ...
//! ```

use nalgebra::DVector;

use super::approach::{approach, nearer};
use super::columns::{Candidate, Linear, LinearisedRun, linearise, squares};
use super::events::Hypothesis;
use super::follow::Noise;
use super::free_run::{disturbance_error, excess, unobserved};
use super::noise::likeliest;
use super::prediction_error::fit;
use super::refits::{RefitVerdict, Weighed, bar, bar_what_rings, keep_doubts, needed};
use super::select::{Posterior, Reduced, Set, select};
use super::solution::{Happened, happened, linearised_runs, placed, present};
use super::tangent::{Deviations, Lane};
use crate::progress::{Event as Notice, Progress, Stage};
use crate::work::Work;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::{Effect, Input, Model, Scenario, State};

/// Mean square of the innovations below which little is missing.
const NEAR_MEAN_SQUARE: f64 = 1.5;
/// Rounds of weighing and refitting; in the first ones the noise is found too.
const MOST_ROUNDS: usize = 12;
/// The same where a torque drives: all is linear there, and what does not settle is not in the catalogue.
const MOST_ROUNDS_BY_TORQUE: usize = 5;
const NOISE_ROUNDS: usize = 3;
/// Rounds that are spent because an event was found at another moment.
const MOST_MOVES: usize = 3;
/// Changes of the logarithms of disturbance and of the input's error that ask for another linearisation.
const SAME_DISTURBANCE_LOG: f64 = 0.2;
const SAME_INPUT_LOG: f64 = 0.3;
/// Growth of the squares from which a refit has lost its way.
const LOST_RATIO: f64 = 1.05;

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
    /// How many times as large as expected what the best set leaves is.
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

/// Whether a set has an event that the model lacks, and nothing new that rings, of which no linear solution is true. Put only
/// to a part of a second an event leaves what a disturbance of the load would explain better: it is placed before the noise is
/// found.
fn has_new_event(linear: &Linear, set: &Set) -> bool {
    let candidates = linear.candidates.iter().zip(set);
    let new = candidates.filter(|(candidate, form)| form.is_some() && !candidate.in_model);
    let mut new = new.map(|(candidate, _)| candidate);
    new.clone().any(Candidate::is_event) && !new.any(Candidate::is_whole)
}

/// Whether so much else is random that runs have to be linearised anew.
fn is_another(noise: &Noise, before: &Noise) -> bool {
    let change = |a: f64, b: f64| (a / b).ln().abs();
    change(noise.disturbance_n_m, before.disturbance_n_m) > SAME_DISTURBANCE_LOG
        || change(noise.input, before.input) > SAME_INPUT_LOG
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

/// Runs that speak together, where each starts, and the place of the one that is held out.
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
        Self {
            scenarios: &self.scenarios[..1],
            starts: &self.starts[..1],
            ..*self
        }
    }
}

/// Searches from a fitted model on, or from the one that it was fitted from, for the `eligible`, among them what the model has
/// already; `floor` is the noise to begin with, whose sensors are those at rest. A refit may end where the model is no machine,
/// or is led by sensors that are much too late, so that no column means anything: then the last model that could be followed
/// and weighed is the answer. `None` where not even the first one can.
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
    search
        .rounds(models, progress)
        .or_else(|| search.ended_at_last())
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
    /// The last model that could be followed and weighed: at first what the search began with.
    last: Hypothesis,
}

impl<'a> Search<'a> {
    fn linearised_runs(&self, hypothesis: &Hypothesis) -> Option<Vec<LinearisedRun<'a>>> {
        self.runs.linearised_runs(hypothesis, self.noise)
    }

    /// Far from the data neither what follows an axis is eligible, nor anything new that rings: no linear solution is true of
    /// that, and a refit that a coupling joined by mistake is as slow as it is lost.
    fn linearised(
        &self,
        hypothesis: &Hypothesis,
        runs: &[LinearisedRun<'_>],
        is_far: bool,
    ) -> Option<Linear> {
        let mut linear = linearise(hypothesis, self.eligible, runs, !is_far)?;
        bar(&mut linear, &self.verdicts, self.replaced);
        if is_far {
            bar_what_rings(&mut linear);
        }
        Some(linear)
    }

    /// The answer at the last model that could be followed and weighed.
    fn ended_at_last(&self) -> Option<SearchResult> {
        let hypothesis = self.last.clone();
        let runs = self.linearised_runs(&hypothesis)?;
        let linear = self.linearised(&hypothesis, &runs, false)?;
        let sets = [vec![None; linear.candidates.len()], present(&linear)];
        let reduced = Reduced::new(linear, 1.0, true)?;
        let posterior = select(&reduced, &sets);
        self.ended(hypothesis, (reduced, posterior), &runs, false)
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
            let sets = [vec![None; linear.candidates.len()], present(&linear)];
            let mut reduced = Reduced::new(linear, 1.0, true)?;
            if round == 0 {
                screened(&reduced, progress);
                progress(Notice::Begun {
                    stage: Stage::Check,
                    of: 0,
                });
            }
            let (mut posterior, followed_with) = (select(&reduced, &sets), self.noise);
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
            let mut is_settled = self.noise == followed_with;
            // With more noise fewer effects are supported; far from the data with less of it others are.
            if self.noise.disturbance_n_m > followed_with.disturbance_n_m
                || (!is_near && !is_settled)
            {
                runs = self.linearised_runs(&hypothesis)?;
                let linear = self.linearised(&hypothesis, &runs, is_far)?;
                reduced = Reduced::new(linear, 1.0, true)?;
                posterior = select(&reduced, &sets);
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
            // Where a torque drives, the balance of torques has the last word instead.
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

    /// What a set that stands gives way to where refits speak against it: to the model with one effect for two, or to that
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
    let kept = needed(hypothesis, &next, runs).into_iter();
    let kept: Vec<RefitVerdict> = kept.filter(|own| !verdicts.contains(own)).collect();
    let is_same = start.ids() == hypothesis.ids();
    let stands = is_same || next.squares < LOST_RATIO * squares(runs);
    let goes_on = kept.is_empty() && stands;
    (kept, goes_on.then_some(next.hypothesis))
}

/// The noise to begin with, from `known` on, and whether little is missing: then what the model itself leaves tells the
/// noise, for next to nothing.
fn first_noise(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    runs: Runs<'_>,
    [floor, known]: [Noise; 2],
) -> Option<(Noise, bool)> {
    let runs = runs.linearised_runs(hypothesis, known)?;
    let rows: usize = runs.iter().map(|run| run.follower.rows).sum();
    if squares(&runs) > NEAR_MEAN_SQUARE * rows as f64 {
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

/// Hands on what each effect would explain by itself.
fn screened(reduced: &Reduced, progress: Progress<'_>) {
    let linear = &reduced.linear;
    for (k, candidate) in linear.candidates.iter().enumerate() {
        if k > 0 && linear.candidates[k - 1].id == candidate.id {
            continue;
        }
        progress(Notice::Screened {
            effect: candidate.id,
            share: reduced.share_alone(k),
        });
    }
}

/// The linear solution of a set in all columns, the nuisances' first.
fn solution(reduced: &Reduced, set: &Set) -> Option<DVector<f64>> {
    let linear = &reduced.linear;
    let m = linear.nuisances.len();
    let columns = reduced.columns(set);
    let (mean, _) = reduced.sizes(&columns)?;
    let mut solution = DVector::zeros(linear.gram.nrows());
    for (column, mean) in columns.iter().zip(mean.iter()) {
        solution[column + m] = *mean;
    }
    let explained = &linear.gram * &solution;
    let right = linear.right.rows(0, m) - explained.rows(0, m);
    let nuisances = linear.factor(&(0..m).collect::<Vec<_>>())?.solve(&right);
    solution.rows_mut(0, m).copy_from(&nuisances);
    Some(solution)
}

/// What two columns do to the readings of a run that is left to itself, in standard deviations of the sensors: for each
/// sample and column current and speed.
fn readings(
    run: &LinearisedRun<'_>,
    white: impl Fn(usize) -> [[f64; 2]; 2],
) -> impl Iterator<Item = [[f64; 2]; 2]> {
    let mut track = Deviations::default();
    (0..run.scenario.samples()).map(move |sample| {
        track.drift(&run.steps[sample]);
        let columns = white(sample);
        let mut lanes = [Lane::default(); 2];
        for (signal, lane) in lanes.iter_mut().enumerate() {
            lane[..2].copy_from_slice(&columns.map(|column| column[signal]));
        }
        let [current, speed] = track.colour(&run.follower.updates[sample], &lanes);
        let noise = &run.noise;
        [0, 1].map(|k| [current[k] / noise.current_a, speed[k] / noise.speed_rad_s])
    })
}

/// What each unknown part of a set takes from the error that the runs have without the set.
fn unknown_shares(reduced: &Reduced, set: &Set, runs: &[LinearisedRun<'_>]) -> Option<Vec<f64>> {
    let linear = &reduced.linear;
    let solution = solution(reduced, set)?;
    let share = |variant: usize, candidate: usize| {
        let (mut before, mut after, mut floor) = (0.0, 0.0, 0.0);
        for (run, columns) in runs.iter().zip(&linear.columns) {
            let mut own = DVector::zeros(solution.len());
            for column in linear.candidates[candidate].variants[variant].numbers() {
                own[column] = solution[column];
            }
            let (part, shift) = (columns * &own, columns * &linear.present);
            let pairs = readings(run, |sample| {
                let white = run.followed.white[sample];
                let whole = [0, 1].map(|signal| white[signal] + shift[2 * sample + signal]);
                [whole, [part[2 * sample], part[2 * sample + 1]]]
            });
            for [whole, part] in pairs {
                for (whole, part) in whole.into_iter().zip(part) {
                    before += whole * whole;
                    after += (whole - part).powi(2);
                }
            }
            floor += run.follower.rows as f64;
        }
        let taken = (before - after) / (before - floor);
        if before > floor {
            taken.clamp(0.0, 1.0)
        } else {
            0.0
        }
    };
    let candidates = linear.candidates.iter().zip(set).enumerate();
    let shares = candidates.map(|(k, (candidate, chosen))| match chosen {
        Some(variant) if candidate.is_unknown() => share(*variant, k),
        _ => 0.0,
    });
    Some(shares.collect())
}

/// Blocks whose sums tell how much the sizes of a set really scatter.
const BLOCKS: f64 = 20.0;

/// How many times as large as white noise makes it the variance of an effect's size is by the scatter between blocks of
/// the runs, for the worst of the set: what a torque leaves of a real machine is the same over a whole motion.
fn clustered(
    linear: &Linear,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    explained: &[DVector<f64>],
) -> f64 {
    let m = linear.nuisances.len();
    let (mut all, mut named): (Vec<usize>, Vec<usize>) = ((0..m).collect(), Vec::new());
    for (candidate, form) in linear.candidates.iter().zip(set) {
        let Some(form) = form else { continue };
        let variant = &candidate.variants[*form];
        all.extend(variant.numbers());
        let sizes = variant.columns.iter().filter(|own| own.unit > 0.0);
        named.extend(sizes.filter(|_| !candidate.is_unknown()).map(|own| own.at));
    }
    let samples: usize = runs.iter().map(|run| run.scenario.samples()).sum();
    let length = whole((samples as f64 / BLOCKS).ceil()).max(1);
    let mut worst: f64 = 1.0;
    for own in &named {
        let others: Vec<usize> = all.iter().copied().filter(|k| k != own).collect();
        let cross = DVector::from_fn(others.len(), |r, _| linear.gram[(others[r], *own)]);
        let Some(factor) = linear.factor(&others) else {
            continue;
        };
        let mut weights = DVector::zeros(linear.gram.nrows());
        weights[*own] = 1.0;
        for (column, share) in others.iter().zip(factor.solve(&cross).iter()) {
            weights[*column] = -share;
        }
        let (mut scatter, mut expected) = (0.0, 0.0);
        for ((run, columns), explained) in runs.iter().zip(&linear.columns).zip(explained) {
            let column = columns * &weights;
            let white: Vec<f64> = run.followed.white.iter().flatten().copied().collect();
            let product = |row: usize| column[row] * (white[row] - explained[row]);
            let products: Vec<f64> = (0..white.len()).map(product).collect();
            let blocks = products.chunks(2 * length);
            let sums = blocks.map(|block| block.iter().sum::<f64>());
            scatter += sums.map(|sum| sum * sum).sum::<f64>();
            expected += column.norm_squared();
        }
        if expected > 0.0 {
            worst = worst.max(scatter / expected);
        }
    }
    worst
}

/// The excess of what a set leaves at its linear solution.
fn excess_of(reduced: &Reduced, set: &Set, runs: &[LinearisedRun<'_>]) -> f64 {
    let linear = &reduced.linear;
    let Some(solution) = solution(reduced, set) else {
        return 1.0;
    };
    let explained = &solution - &linear.present;
    let explained: Vec<DVector<f64>> = linear.columns.iter().map(|w| w * &explained).collect();
    let by_blocks = if runs[0].scenario.input == Input::Voltage {
        1.0
    } else {
        clustered(linear, set, runs, &explained)
    };
    let left = runs.iter().zip(&explained).map(|(run, explained)| {
        let pairs = run
            .followed
            .white
            .iter()
            .zip(explained.as_slice().chunks(2));
        let left = pairs.map(|(white, explained)| [0, 1].map(|k| white[k] - explained[k]));
        (run, left.collect())
    });
    excess(&left.collect::<Vec<_>>()).max(by_blocks)
}

//! Rounds of linearising, selecting and refitting, until the set and the noise stand.

use nalgebra::DMatrix;

use super::columns::{Around, Linear, SLAB, linearise};
use super::follow::{Follower, Noise, follow};
use super::noise::likeliest;
use super::select::{Posterior, Reduced, Set, select};
use crate::diagnosis::family::takes_power;
use crate::numerics::levenberg_marquardt::{self, Options, Problem};
use crate::plant::{ActiveEffect, Effect, Model, ParameterRole, Scenario, Slot, State, effect, typical_size};

/// Mean square of the innovations above which a linear solution is not believed.
const FAR: f64 = 3.0;
const ROUNDS: usize = 10;

pub struct Found {
    pub model: Model,
    pub noise: Noise,
    pub linear: Linear,
    pub posterior: Posterior,
    pub mean: Vec<f64>,
    pub covariance: DMatrix<f64>,
    pub columns: Vec<usize>,
    pub excess: f64,
    /// For each candidate that is an unknown part, its share of the error.
    pub unknown_share: Vec<f64>,
    pub log: Vec<String>,
}

/// Innovations of the runs as a function of the free parameters, with their priors behind.
struct Innovations<'a> {
    model: Model,
    slots: Vec<Slot>,
    units: Vec<Unit>,
    runs: Vec<(&'a Follower, &'a Scenario, State)>,
    noise: Noise,
    len: usize,
}

#[derive(Clone, Copy)]
enum Unit {
    Logarithm { min: f64, max: f64, sd: f64, at: f64 },
    Linear { unit: f64, min: f64, max: f64, at: f64 },
}

impl<'a> Innovations<'a> {
    fn new(model: &Model, runs: &'a [Around<'a>], noise: Noise) -> Self {
        let training = runs[0].scenario;
        let slots = model.free_slots();
        let mut free = Vec::new();
        let mut units = Vec::new();
        for slot in slots {
            let Some(value) = model.get(&slot) else { continue };
            let unit = match &slot {
                Slot::Motor(_) => Unit::Logarithm { min: 1e-12, max: 1e9, sd: 0.3, at: value.ln() },
                Slot::Effect { spec, index, parameter, .. } => {
                    if matches!(spec.role, ParameterRole::Choice | ParameterRole::EventTime) {
                        continue;
                    }
                    let e = model.effects[*index].effect;
                    if spec.is_coefficient() {
                        let min = if takes_power(e.card().id) { 0.0 } else { spec.min };
                        Unit::Linear { unit: SLAB * typical_size(e, *parameter, model, training), min, max: spec.max, at: 0.0 }
                    } else if spec.logarithmic {
                        Unit::Logarithm { min: if spec.key == "boundary_a" { 0.9 } else { spec.min }, max: spec.max, sd: 1.0, at: value.ln() }
                    } else {
                        Unit::Linear { unit: spec.scale * 3.0, min: spec.min, max: spec.max, at: value / (3.0 * spec.scale) }
                    }
                }
            };
            free.push(slot);
            units.push(unit);
        }
        let len = runs.iter().map(|run| 2 * run.scenario.samples()).sum::<usize>() + free.len();
        Self { model: model.clone(), slots: free, units, runs: runs.iter().map(|run| (&run.follower, run.scenario, run.start)).collect(), noise, len }
    }

    fn start(&self) -> Vec<f64> {
        self.slots.iter().zip(&self.units).map(|(slot, unit)| {
            let value = self.model.get(slot).unwrap_or(f64::NAN);
            match unit { Unit::Logarithm { min, max, .. } => value.clamp(*min, *max).ln(), Unit::Linear { unit, .. } => value / unit }
        }).collect()
    }

    fn model_at(&self, x: &[f64]) -> Model {
        let mut model = self.model.clone();
        for ((slot, unit), x) in self.slots.iter().zip(&self.units).zip(x) {
            let value = match unit { Unit::Logarithm { .. } => x.exp(), Unit::Linear { unit, .. } => x * unit };
            model.set(slot, value);
        }
        model
    }
}

impl Problem for Innovations<'_> {
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
        let model = self.model_at(x);
        let mut at = 0;
        let mut white = Vec::new();
        for (follower, scenario, start) in &self.runs {
            if !follow(follower, &model, scenario, *start, &self.noise, &mut white) {
                return false;
            }
            for w in &white {
                out[at] = w[0];
                out[at + 1] = w[1];
                at += 2;
            }
        }
        for (unit, x) in self.units.iter().zip(x) {
            out[at] = match unit { Unit::Logarithm { sd, at, .. } => (x - at) / sd, Unit::Linear { at, .. } => x - at };
            at += 1;
        }
        true
    }
    fn residual_len(&self) -> usize { self.len }
    fn difference_step(&self, index: usize) -> f64 {
        match self.units[index] { Unit::Logarithm { .. } => 2e-3, Unit::Linear { .. } => 5e-3 }
    }
    fn clamp(&self, x: &mut [f64]) {
        for (x, unit) in x.iter_mut().zip(&self.units) {
            *x = match unit { Unit::Logarithm { min, max, .. } => x.clamp(min.ln(), max.ln()), Unit::Linear { unit, min, max, .. } => x.clamp(min / unit, max / unit) };
        }
    }
}

/// Refits everything of `model` that is free; the cost is the sum of squares.
fn refit(model: &Model, runs: &[Around<'_>], noise: Noise, carry: bool) -> Option<(Model, f64)> {
    let problem = Innovations::new(model, runs, noise);
    let minimum = levenberg_marquardt::minimise(&problem, &problem.start(), Options { most_iterations: 25, relative_cost: 1e-4, longest_step: 1.5, carry_jacobian: carry, one_of_many: false })?;
    Some((problem.model_at(&minimum.x), minimum.cost))
}

fn around<'a>(model: &'a Model, scenarios: &[&'a Scenario], starts: &[State], noise: Noise) -> Option<Vec<Around<'a>>> {
    scenarios.iter().zip(starts).map(|(s, start)| Around::new(model, s, *start, noise)).collect()
}

/// The model with a candidate's effect as the linear solution has it.
fn with_effect(model: &Model, id: &str, values: &[f64]) -> Option<Model> {
    let effect: &'static dyn Effect = effect::find(id)?;
    let mut model = model.clone();
    model.effects.retain(|active| active.id() != id);
    model.effects.push(ActiveEffect { effect, values: values.iter().copied().map(Some).collect() });
    Some(model)
}

/// The model at the linear solution of a set.
fn at_solution(model: &Model, linear: &Linear, reduced: &Reduced<'_>, set: &Set) -> Option<Model> {
    let columns = reduced.columns(set);
    let (mean, _) = reduced.sizes(&columns)?;
    let m = linear.nuisances.len();
    let size = |column: usize| columns.iter().position(|c| *c == column - m).map(|at| mean[at]);
    let mut next = model.clone();
    for (candidate, chosen) in linear.candidates.iter().zip(set) {
        if candidate.unknown { continue; }
        match chosen {
            None => {
                if candidate.in_model { next = next.without_effect(candidate.id).ok()?; }
            }
            Some(v) if !candidate.in_model => {
                let variant = &candidate.variants[*v];
                let mut values = variant.values.clone();
                let specs = effect::find(candidate.id)?.parameters();
                for ((column, unit), parameter) in variant.columns.iter().zip(&variant.units).zip(&variant.parameters) {
                    if specs.get(*parameter).is_some_and(|spec| spec.is_coefficient()) {
                        let mut x = size(*column)?;
                        if specs[*parameter].min >= 0.0 || takes_power(candidate.id) { x = x.max(0.02); }
                        values[*parameter] = x * unit;
                    }
                }
                next = with_effect(&next, candidate.id, &values)?;
            }
            Some(_) => {}
        }
    }
    Some(next)
}

/// Sum of the squares of the innovations.
fn squares(runs: &[Around<'_>]) -> f64 {
    let of = |run: &Around<'_>| run.followed.white.iter().map(|w| w[0] * w[0] + w[1] * w[1]).sum::<f64>();
    runs.iter().map(of).sum()
}

/// Adds, one after the other, the single effects that explain most when refitted, until the linear solution holds or none
/// explains a tenth of what is left. Only the first run is looked at.
fn approach(mut model: Model, scenario: &Scenario, start: State, noise: Noise, log: &mut Vec<String>) -> Option<Model> {
    for _ in 0..4 {
        let runs = around(&model, &[scenario], &[start], noise)?;
        let rows = runs[0].follower.rows as f64;
        let now = squares(&runs);
        if now / rows < FAR {
            break;
        }
        let linear = linearise(&model, &runs, false)?;
        let reduced = Reduced::new(&linear, 1.0, false)?;
        let set: Set = linear.candidates.iter().map(|c| c.in_model.then_some(0)).collect();
        let columns = reduced.columns(&set);
        let mut singles: Vec<(f64, Set, &'static str)> = Vec::new();
        for (k, c) in linear.candidates.iter().enumerate() {
            if c.in_model || c.excludes.iter().any(|o| set[*o].is_some()) {
                continue;
            }
            let logs = reduced.conditional(&columns, k);
            let mut order: Vec<usize> = (0..logs.len()).collect();
            order.sort_by(|a, b| logs[*b].total_cmp(&logs[*a]));
            // Where the shape is all that there is, it has to be near.
            let starts = if c.variants[0].mean > 0.0 { 3 } else { 1 };
            for v in order.into_iter().take(starts) {
                let mut with = set.clone();
                with[k] = Some(v);
                singles.push((logs[v], with, c.id));
            }
        }
        singles.sort_by(|a, b| b.0.total_cmp(&a.0));
        let most = singles.first()?.0;
        let mut best: Option<(Model, f64, usize)> = None;
        for (gain, with, id) in singles.iter().take(6) {
            if *gain < 0.2 * most {
                break;
            }
            let Some(next) = at_solution(&model, &linear, &reduced, with) else { continue };
            let Some((next, cost)) = refit(&next, &runs, noise, true) else { continue };
            log.push(format!("   tries {id} gain {gain:.0} of {:.0} cost {:.3}", 0.5 * now, cost / rows));
            if best.as_ref().is_none_or(|b| cost < b.1) {
                let k = (0..set.len()).find(|k| with[*k] != set[*k])?;
                best = Some((next, cost, k));
            }
        }
        // A search that began too far off ends in a hollow: where the shape is all that there is, the others are tried too.
        if let Some((_, cost, k)) = &best
            && *cost > FAR * rows
            && linear.candidates[*k].variants[0].mean > 0.0
        {
            let k = *k;
            for v in 0..linear.candidates[k].variants.len() {
                let mut with = set.clone();
                with[k] = Some(v);
                if singles.iter().take(6).any(|s| s.1 == with) {
                    continue;
                }
                let Some(next) = at_solution(&model, &linear, &reduced, &with) else { continue };
                let Some((next, cost)) = refit(&next, &runs, noise, true) else { continue };
                log.push(format!("   tries again cost {:.3}", cost / rows));
                if best.as_ref().is_none_or(|b| cost < b.1) {
                    best = Some((next, cost, k));
                }
                if cost < FAR * rows { break; }
            }
        }
        match best {
            Some((next, cost, _)) if cost < 0.9 * now => model = next,
            _ => break,
        }
    }
    Some(model)
}

pub fn search(model: &Model, scenarios: &[&Scenario], starts: &[State], floor: Noise) -> Option<Found> {
    let mut log = Vec::new();
    let clock = std::time::Instant::now();
    let ms = || clock.elapsed().as_secs_f64() * 1e3;
    let mut model = approach(model.clone(), scenarios[0], starts[0], floor, &mut log)?;
    log.push(format!("approached {:.0} ms {:?}", ms(), model.effect_ids()));
    let mut noise = floor;
    let mut seen: Vec<Vec<&'static str>> = Vec::new();
    for round in 0..ROUNDS {
        let mut runs = around(&model, scenarios, starts, noise)?;
        let now = squares(&runs);
        let mut linear = linearise(&model, &runs, round > 0)?;
        let mut reduced = Reduced::new(&linear, 1.0, true)?;
        let present: Set = linear.candidates.iter().map(|c| c.in_model.then_some(0)).collect();
        let sets: Vec<Set> = vec![vec![None; present.len()], present.clone()];
        let mut posterior = select(&reduced, &sets);
        let better = if round < 3 { likeliest(&runs, &linear, &reduced, &posterior.forms, &floor, noise) } else { noise };
        log.push(format!("round {round} {:.0} ms: chi2/n {:.3} noise {:?}", ms(), now / linear.rows as f64, better));
        let moved = (better.disturbance_n_m / noise.disturbance_n_m).ln().abs() > 0.2 || (better.voltage_v / noise.voltage_v).ln().abs() > 0.3;
        if moved {
            noise = better;
            drop(reduced);
            runs = around(&model, scenarios, starts, noise)?;
            linear = linearise(&model, &runs, round > 0)?;
            reduced = Reduced::new(&linear, 1.0, true)?;
            posterior = select(&reduced, &sets);
        }
        let now = squares(&runs);
        let names: Vec<&'static str> = linear.candidates.iter().zip(&posterior.best).filter(|(_, v)| v.is_some()).map(|(c, _)| c.id).collect();
        let promised = reduced.squares - {
            let columns = reduced.columns(&posterior.best);
            let (mean, _) = reduced.sizes(&columns)?;
            columns.iter().zip(mean.iter()).map(|(c, m)| reduced.right[*c] * m).sum::<f64>()
        };
        log.push(format!("   {:.0} ms: now {:.3} promised {:.3} best {names:?}", ms(), now / linear.rows as f64, promised / linear.rows as f64));
        let stands = round > 1 && seen[1..].contains(&names) || round == 1 && seen[0] == names;
        if stands || round + 1 == ROUNDS {
            let columns = reduced.columns(&posterior.best);
            let excess = excess(&linear, &reduced, &posterior.best, &runs).max(1.0);
            log.push(format!("done {:.0} ms, excess {excess:.2}", ms()));
            if excess > 1.0 {
                let tempered = Reduced::new(&linear, excess, true)?;
                posterior = select(&tempered, &[sets, vec![posterior.best.clone()]].concat());
            }
            let (mean, covariance) = reduced.sizes(&columns)?;
            let unknown_share = unknown_shares(&linear, &posterior.best, &columns, mean.as_slice(), &runs);
            drop(reduced);
            drop(runs);
            return Some(Found { model, noise, posterior, mean: mean.iter().copied().collect(), covariance, columns, linear, excess, unknown_share, log });
        }
        seen.push(names);
        let next = at_solution(&model, &linear, &reduced, &posterior.best)?;
        let changed = next.effect_ids() != model.effect_ids();
        let (next, cost) = refit(&next, &runs, noise, true)?;
        log.push(format!("   {:.0} ms: refit cost {:.3}", ms(), cost / linear.rows as f64));
        if cost < 1.05 * now || !changed {
            model = next;
        } else {
            log.push("   refused".to_owned());
        }
    }
    None
}

/// What each unknown part of a set takes from the error of the runs as it would run freely.
fn unknown_shares(linear: &Linear, set: &Set, columns: &[usize], mean: &[f64], runs: &[Around<'_>]) -> Vec<f64> {
    let m = linear.nuisances.len();
    let free = |run: &Around<'_>, white: &dyn Fn(usize) -> [f64; 2]| -> Vec<[f64; 2]> {
        let mut track = super::follow::Deviation::default();
        (0..run.scenario.samples())
            .map(|sample| {
                let passage = &run.follower.passages[sample];
                if passage.interval_s > 0.0 {
                    track.pass(passage, [0.0; 2], run.follower.forgets[sample], &run.dynamics);
                }
                let update = &run.follower.updates[sample];
                let z = track.colour(update, white(sample));
                [z[0] / run.noise.current_a, z[1] / run.noise.speed_rad_s]
            })
            .collect()
    };
    linear
        .candidates
        .iter()
        .zip(set)
        .map(|(candidate, chosen)| {
            let (true, Some(v)) = (candidate.unknown, chosen) else { return 0.0 };
            let (mut before, mut after, mut floor) = (0.0, 0.0, 0.0);
            for (run, w) in runs.iter().zip(&linear.columns) {
                let mut own = nalgebra::DVector::zeros(w.ncols());
                for column in &candidate.variants[*v].columns {
                    if let Some(at) = columns.iter().position(|c| c + m == *column) {
                        own[*column] = mean[at];
                    }
                }
                let part = w * own;
                let shift = w * &linear.present;
                let whole = free(run, &|k| {
                    let white = run.followed.white[k];
                    [white[0] + shift[2 * k], white[1] + shift[2 * k + 1]]
                });
                let part = free(run, &|k| [part[2 * k], part[2 * k + 1]]);
                for (z, p) in whole.iter().zip(&part) {
                    for signal in 0..2 {
                        before += z[signal].powi(2);
                        after += (z[signal] - p[signal]).powi(2);
                    }
                }
                floor += run.follower.rows as f64;
            }
            if before > floor { ((before - after) / (before - floor)).clamp(0.0, 1.0) } else { 0.0 }
        })
        .collect()
}

/// Lags over which what is left may be alike.
const LAGS: usize = 40;

/// How many times as large as white noise's the variance of sums of what the best set leaves is; one where it is white.
fn excess(linear: &Linear, reduced: &Reduced<'_>, set: &Set, runs: &[Around<'_>]) -> f64 {
    let m = linear.nuisances.len();
    let columns = reduced.columns(set);
    let Some((mean, _)) = reduced.sizes(&columns) else { return 1.0 };
    // The nuisances' part of the solution.
    let mut solution = nalgebra::DVector::zeros(linear.gram.nrows());
    for (column, mean) in columns.iter().zip(mean.iter()) {
        solution[column + m] = *mean;
    }
    let mut base = linear.gram.view((0, 0), (m, m)).into_owned();
    for (k, sd) in linear.nuisances.iter().enumerate() {
        base[(k, k)] += 1.0 / (sd * sd);
    }
    let right = linear.right.rows(0, m) - (&linear.gram * &solution).rows(0, m);
    if let Some(factor) = base.cholesky() {
        let nuisance = factor.solve(&right.into_owned());
        solution.rows_mut(0, m).copy_from(&nuisance);
    }
    let mut worst: f64 = 1.0;
    for signal in 0..2 {
        let mut sums = vec![0.0; LAGS + 1];
        let mut count = 0.0;
        for (run, w) in runs.iter().zip(&linear.columns) {
            let explained = w * (&solution - &linear.present);
            let left: Vec<f64> = run.followed.white.iter().enumerate().filter(|(k, _)| {
                let u = &run.follower.updates[*k];
                [u.current[4], u.speed[4]][signal] > 0.0
            }).map(|(k, white)| white[signal] - explained[2 * k + signal]).collect();
            count += left.len() as f64;
            for (lag, sum) in sums.iter_mut().enumerate() {
                if left.len() > lag {
                    *sum += left.iter().zip(&left[lag..]).map(|(a, b)| a * b).sum::<f64>();
                }
            }
        }
        if count > 0.0 {
            let mut long = sums[0];
            for sum in &sums[1..] {
                if *sum <= 2.0 * sums[0] / count.sqrt() { break; }
                long += 2.0 * sum;
            }
            worst = worst.max(long / count);
        }
    }
    worst
}

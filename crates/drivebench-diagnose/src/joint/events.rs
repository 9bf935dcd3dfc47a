//! Events that happen once: each run has its own moment of one, or none.
//!
//! What an event adds to the innovations is the signature of a jump; its moment is the one of the largest evidence, as in the
//! generalised likelihood ratio test of Willsky and Jones (IEEE Trans. Automatic Control 21, 1976), its size under a slab.
//!
//! ```text
//! what all runs share, events --in_run--> the model of one run
//! parts     an event in one run at one of many moments; several runs: one each (paired)
//! placed    the moment to the sample, by the evidence of moments side by side
//! ```

use nalgebra::DVector;
use rayon::prelude::*;

use super::regression::{Base, Candidate, Column, Form, Linear, Part, SLAB, Source, Variant};
use super::run::{LinearisedRun, with_events};
use super::screening::add_products;
use super::select::Set;
use super::tangent::{LANES, Lane, Tangent};
use drivebench_model::plant::{
    ActiveEffect, Effect, Model, ParameterRole, ParameterSpec, Path, Scenario, Terms, typical_size,
};

/// Time before its moment from which on an event may do anything, s.
const LEAD_S: f64 = 0.4;
/// Moments on either side of the best one that are evaluated on each level of a search.
const AROUND: i32 = 8;
/// Weights before, at and behind the moment, at one standard deviation: a slower onset or a faster one.
const SLOWER: [f64; 3] = [0.5, -1.0, 0.5];
/// Other forms of an onset: weights and the time before and behind the moment, s. Later or earlier and slower or faster, since its
/// rate is not known; and built up slowly, since that would pass for a friction beside it.
const ONSETS: [([f64; 3], f64); 5] =
    [([0.5, 0.0, -0.5], 0.01), (SLOWER, 0.01), (SLOWER, 0.1), (SLOWER, 0.4), (SLOWER, 1.6)];

/// An event of one run.
#[derive(Clone)]
pub(super) struct Event {
    pub(super) run: usize,
    pub(super) effect: &'static dyn Effect,
    pub(super) values: Vec<f64>,
}

/// Which of an effect's parameters is the time of its event; none where it is no event.
pub(crate) fn time_of(effect: &dyn Effect) -> Option<usize> {
    let mut specs = effect.parameters().iter();
    specs.position(|spec| spec.role == ParameterRole::EventTime)
}

impl Event {
    pub(super) fn id(&self) -> &'static str {
        self.effect.card().id
    }

    pub(super) fn time_s(&self) -> f64 {
        time_of(self.effect).map_or(f64::NAN, |k| self.values[k])
    }

    pub(super) fn put_at(&mut self, time_s: f64) {
        if let Some(k) = time_of(self.effect) {
            self.values[k] = time_s;
        }
    }

    pub(super) fn active(&self) -> ActiveEffect {
        ActiveEffect::with(self.effect, &self.values)
    }

    /// Its terms at another moment.
    fn terms_at(&self, time_s: f64) -> Box<dyn Terms> {
        let mut there = self.clone();
        there.put_at(time_s);
        there.effect.terms(&there.values)
    }

    /// Change by another form of its onset, so long before and behind the moment.
    fn onset(&self, (weights, around_s): ([f64; 3], f64)) -> Tangent {
        let parts = [-around_s, 0.0, around_s].into_iter().zip(weights);
        let terms_at = |after_s| self.terms_at(self.time_s() + after_s);
        Tangent::Event {
            parts: parts.map(|(after_s, weight)| (weight, terms_at(after_s))).collect(),
            begins_s: self.time_s() - around_s - LEAD_S,
        }
    }

    /// The tangent of `unit` of its size where it is; `None` where that is no forcing.
    pub(super) fn slope(&self, unit: f64) -> Option<Tangent> {
        let acts = self.effect.terms(&self.values).path() == Path::default();
        acts.then(|| self.tangent(unit, self.time_s()))
    }

    /// The same with a slab of it at another moment.
    fn tangent(&self, slab: f64, time_s: f64) -> Tangent {
        let mut there = self.clone();
        there.values[self.effect.size_index()] = slab;
        Tangent::Event { parts: vec![(1.0, there.terms_at(time_s))], begins_s: time_s - LEAD_S }
    }
}

/// What all runs share, and what happens in one of them.
#[derive(Clone)]
pub(super) struct Hypothesis {
    pub(super) model: Model,
    pub(super) events: Vec<Event>,
}

impl Hypothesis {
    /// A fitted model, whose events are those of the first run.
    pub(super) fn of(model: &Model) -> Self {
        let (events, shared) = (model.effects.iter().cloned())
            .partition::<Vec<_>, _>(|active| time_of(active.effect).is_some());
        let mut model = model.clone();
        model.effects = shared;
        let event = |active: &ActiveEffect| Event {
            run: 0,
            effect: active.effect,
            values: active.values_or_guess(),
        };
        let events = events.iter().map(event).collect();
        Self { model, events }
    }

    /// A model of one run, with its events.
    pub(super) fn whole(model: &Model) -> Self {
        Self { model: model.clone(), events: vec![] }
    }

    pub(super) fn events_of(&self, run: usize) -> Vec<ActiveEffect> {
        let own = self.events.iter().filter(|event| event.run == run);
        own.map(Event::active).collect()
    }

    /// The model of one run.
    pub(super) fn in_run(&self, run: usize) -> Model {
        with_events(&self.model, &self.events_of(run))
    }

    pub(super) fn has(&self, id: &str) -> bool {
        self.model.has(id) || self.events.iter().any(|event| event.id() == id)
    }

    pub(super) fn without(&self, id: &str) -> Self {
        let mut without = self.clone();
        without.model.effects.retain(|active| active.id() != id);
        without.events.retain(|event| event.id() != id);
        without
    }

    /// Whether no event is more than a period and a half from where it is `before`: its form is linear only close to there.
    pub(super) fn events_stay(&self, before: &Self, scenarios: &[&Scenario]) -> bool {
        self.events.iter().all(|event| {
            let period_s = scenarios[event.run].mean_period_s();
            before.events.iter().any(|other| {
                (other.id(), other.run) == (event.id(), event.run)
                    && (other.time_s() - event.time_s()).abs() <= 1.5 * period_s
            })
        })
    }

    /// What there is, an event once for each of its runs.
    pub(super) fn ids(&self) -> Vec<(&'static str, usize)> {
        let shared = self.model.effect_ids().into_iter().map(|id| (id, 0));
        let events = self.events.iter().map(|event| (event.id(), 1 + event.run));
        shared.chain(events).collect()
    }
}

/// Parts of a run at whose ends an effect is looked for. Steps of the load stand for a disturbance, too.
fn parts_of_run(effect: &dyn Effect) -> usize {
    if effect.card().is_disturbance_step { 96 } else { 48 }
}

fn spacing_s(run: &LinearisedRun<'_>, effect: &dyn Effect) -> f64 {
    let last_s = run.scenario.sample_time_s[run.scenario.samples() - 1];
    (last_s - run.scenario.begin_s()) / parts_of_run(effect) as f64
}

/// Log of the prior of what happens in one run only at a given moment, in so many runs.
fn log_share_of_one(effect: &dyn Effect, runs: usize) -> f64 {
    let only = if runs > 1 { 0.5 / runs as f64 } else { 1.0 };
    only.ln() - ((parts_of_run(effect) - 1) as f64).ln()
}

/// The same of what happens in two runs at given moments.
fn log_share_of_two(effect: &dyn Effect) -> f64 {
    0.5_f64.ln() - 2.0 * ((parts_of_run(effect) - 1) as f64).ln()
}

/// An event in each of its forms: as the model has it, and in the runs in which the model lacks it.
pub(super) fn parts(
    hypothesis: &Hypothesis,
    effect: &'static dyn Effect,
    runs: &[LinearisedRun<'_>],
) -> Vec<Part> {
    let id = effect.card().id;
    let size = Effect::size_index(effect);
    let model = &hypothesis.model;
    let specs = effect.parameters().iter();
    let guess: Vec<f64> = specs.map(ParameterSpec::guess).collect();
    let slab = |run: usize| SLAB * typical_size(effect, size, model, runs[run].scenario);
    // The column of an event whose size is so many slabs.
    let add = |form: &mut Form, event: &Event, present: f64| {
        let (unit, time_s) = (slab(event.run), event.time_s());
        let column = Column {
            moment: Some((event.run, time_s)),
            ..Column::of(Some(size), unit, present / unit)
        };
        form.column(Source::In(event.run, event.tangent(unit, time_s)), column);
    };
    let is_own = |event: &&Event| event.id() == id && event.run < runs.len();
    let own: Vec<&Event> = hypothesis.events.iter().filter(is_own).collect();
    let mut parts = Vec::new();
    if !own.is_empty() {
        let mut part = Part::new(effect);
        part.candidate.in_model = true;
        let log_prior = match own.len() {
            1 => log_share_of_one(effect, runs.len()),
            _ => log_share_of_two(effect),
        };
        let mut form = Form::new(own[0].values.clone(), log_prior);
        for event in &own {
            add(&mut form, event, event.values[size]);
        }
        for (event, onset) in own.iter().flat_map(|event| ONSETS.map(|onset| (event, onset))) {
            form.column(Source::In(event.run, event.onset(onset)), Column::default());
        }
        part.push(form);
        parts.push(part);
    }
    // Beside what the model has, the other run may have it too.
    let mut part = Part::new(effect);
    let mut log_share = log_share_of_one(effect, runs.len());
    if !own.is_empty() {
        part.candidate.log_odds = 0.0;
        log_share = log_share_of_two(effect) - log_share;
    }
    for (number, run) in runs.iter().enumerate() {
        if own.iter().any(|event| event.run == number) {
            continue;
        }
        let part_s = spacing_s(run, effect);
        let grid = (1..parts_of_run(effect)).map(|place| (part_s * place as f64, false));
        let others = hypothesis.events.iter();
        let others = others.filter(|event| event.run == number && event.id() != id);
        for (time_s, is_rival) in grid.chain(others.map(|event| (event.time_s(), true))) {
            let mut event = Event { run: number, effect, values: guess.clone() };
            event.put_at(time_s);
            event.values[size] = slab(number);
            let mut form = Form::new(event.values.clone(), log_share);
            add(&mut form, &event, 0.0);
            form.variant.is_rival = is_rival;
            part.push(form);
        }
    }
    parts.push(part);
    parts
}

/// Adds to events that may be in several runs the forms in which they are: of what the model lacks the likeliest moments of
/// two runs together, of what it has either alone.
pub(super) fn pair(linear: &mut Linear, runs: &[LinearisedRun<'_>]) {
    if runs.len() < 2 {
        return;
    }
    let inside = linear.candidates.iter().filter(|own| own.in_model);
    let inside = inside.flat_map(|own| own.variants[0].numbers());
    let base: Vec<usize> = (0..linear.nuisances.len()).chain(inside).collect();
    let Some(given) = Base::of_columns(linear, &base) else {
        return;
    };
    let gain = |column: usize| {
        let cross = DVector::from_fn(base.len(), |r, _| linear.gram[(base[r], column)]);
        let own = linear.gram[(column, column)] + 1.0;
        let [own, rest] = given.left(&cross, own, linear.right[column]);
        0.5 * rest * rest / own - 0.5 * own.ln()
    };
    let paired = |candidate: &Candidate| {
        if candidate.in_model {
            alone(candidate, runs.len())
        } else {
            together(candidate, runs, &gain)
        }
    };
    let added: Vec<Vec<Variant>> = linear.candidates.iter().map(paired).collect();
    for (candidate, added) in linear.candidates.iter_mut().zip(added) {
        candidate.variants.extend(added);
    }
}

/// An event of the model that is in two runs, in either alone.
fn alone(candidate: &Candidate, runs: usize) -> Vec<Variant> {
    let both = &candidate.variants[0];
    let Some(effect) = candidate.effect.filter(|_| both.moments().count() > 1) else {
        return vec![];
    };
    let own = both.columns.iter().filter(|column| column.moment.is_some());
    let only = |column: &Column| Variant {
        columns: vec![*column],
        log_prior: log_share_of_one(effect, runs),
        ..both.clone()
    };
    own.map(only).collect()
}

/// An event that the model lacks, in two runs at once: four likely moments of each, and those of other events. What was there
/// before either moved is no event but always there, and would give the effects that always are a sign that they do not have.
fn together(
    candidate: &Candidate,
    runs: &[LinearisedRun<'_>],
    gain: &impl Fn(usize) -> f64,
) -> Vec<Variant> {
    let Some(effect) = candidate.effect else {
        return vec![];
    };
    let of_run = |run: usize| -> Vec<&Variant> {
        let is_own = |form: &&Variant| form.moments().next().is_some_and(|own| own.0 == run);
        let own = candidate.variants.iter().filter(is_own);
        let mut own: Vec<_> = own.map(|form| (gain(form.columns[0].at), form)).collect();
        own.sort_by(|a, b| b.0.total_cmp(&a.0));
        let own = own.into_iter().map(|own| own.1).enumerate();
        let paired = own.filter(|(place, form)| *place < 4 || form.is_rival);
        paired.map(|(_, form)| form).collect()
    };
    let observable_s = [0, 1].map(|run| moves_s(&runs[run]) + spacing_s(&runs[run], effect));
    let happens = |form: &Variant| {
        let mut moments = form.moments();
        moments.any(|(run, time_s)| time_s > observable_s[run])
    };
    let (first, second) = (of_run(0), of_run(1));
    let with_second = |a| second.iter().map(move |b| (a, b));
    let pairs = first.iter().flat_map(with_second);
    pairs
        .filter(|(a, b)| happens(a) || happens(b))
        .map(|(a, b)| Variant {
            columns: [&a.columns[..], &b.columns].concat(),
            log_prior: log_share_of_two(effect),
            ..(*a).clone()
        })
        .collect()
}

/// When the shaft of a run turns first, s after its first command.
fn moves_s(run: &LinearisedRun<'_>) -> f64 {
    let mut directions = run.followed.direction.iter();
    let first = directions.position(|direction| *direction != 0.0);
    let time_s = first.map(|sample| run.scenario.sample_time_s[sample]);
    time_s.map_or(f64::INFINITY, |time_s| time_s - run.scenario.begin_s())
}

/// When an event happened, with the interval that holds the moment with 95 %.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    pub(super) time_s: f64,
    pub(super) interval_s: [f64; 2],
}

/// The evidence of an event beside the rest of a set, by the whitened residual of a run without all that is in the model.
struct Search<'a> {
    run: &'a LinearisedRun<'a>,
    event: &'a Event,
    slab: f64,
    residual: Vec<[f64; 2]>,
    columns: Vec<&'a [f32]>,
    given: Base,
}

impl Search<'_> {
    /// Log evidence of the event at each of these moments.
    fn gains(&self, times_s: &[f64]) -> Vec<f64> {
        let gains = |some: &[f64]| -> Vec<f64> {
            let tangent = |time_s: &f64| self.event.tangent(self.slab, *time_s);
            let tangents: Vec<Tangent> = some.iter().map(tangent).collect();
            let tangents: Vec<&Tangent> = tangents.iter().collect();
            let mut products: Vec<Lane> = vec![[0.0; LANES]; self.columns.len() + 3];
            let (columns, residual) = (&self.columns, &self.residual);
            add_products(self.run, columns, residual, &tangents, &mut products);
            let gain = |lane| self.given.gain(&products, lane, 1);
            (0..some.len()).map(gain).collect()
        };
        let groups = times_s.par_chunks(LANES).with_max_len(1);
        groups.map(gains).collect::<Vec<_>>().concat()
    }

    /// The likeliest moment near the one that the event has; `excess` is that of the variance of what is left.
    fn nearest(&self, excess: f64) -> Moment {
        let times = &self.run.scenario.sample_time_s;
        let end_s = times[times.len() - 1] - self.run.scenario.begin_s();
        let period_s = self.run.scenario.mean_period_s();
        let spacing_s = spacing_s(self.run, self.event.effect);
        let is_inside = |time_s: &f64| (0.0..end_s).contains(time_s);
        // Four parts on either side: linearised far from the data it was wrong by more than one.
        let mut step_s = 4.0 * spacing_s / f64::from(AROUND);
        let mut best_s = self.event.time_s();
        let mut evaluated: Vec<(f64, f64)> = Vec::new();
        // Five levels, down to a quarter of a period.
        for _ in 0..5 {
            let tried = (-AROUND..=AROUND).map(|k| best_s + f64::from(k) * step_s);
            let tried: Vec<f64> = tried.filter(is_inside).collect();
            evaluated.extend(tried.iter().copied().zip(self.gains(&tried)));
            let likeliest = evaluated.iter().max_by(|a, b| a.1.total_cmp(&b.1));
            best_s = likeliest.map_or(best_s, |evaluated| evaluated.0);
            if step_s < 0.25 * period_s {
                break;
            }
            step_s *= 2.0 / f64::from(AROUND);
        }
        let gains = evaluated.iter().map(|evaluated| evaluated.1);
        // 1.92 nats below the top end the interval of 95 %.
        let least = gains.fold(f64::NEG_INFINITY, f64::max) - 1.92 * excess;
        // Where nothing moves the moment may be anywhere.
        let wide_s = 0.5 * spacing_s;
        for side in [-1.0, 1.0] {
            let reach = evaluated.iter().filter(|evaluated| evaluated.1 > least);
            let reach = reach.map(|evaluated| side * evaluated.0);
            let mut from_s = reach.fold(f64::MIN, f64::max) * side;
            loop {
                let further = (1..=LANES).map(|k| from_s + side * wide_s * k as f64);
                let further: Vec<f64> = further.filter(is_inside).collect();
                let gains = self.gains(&further);
                let likely = gains.iter().take_while(|gain| **gain > least).count();
                evaluated.extend(further.iter().copied().zip(gains).take(likely));
                if likely < LANES {
                    break;
                }
                from_s = further[LANES - 1];
            }
        }
        // Between two samples nothing is observed.
        let half_s = 0.5 * period_s;
        let likely = evaluated.iter().filter(|evaluated| evaluated.1 > least);
        let interval_s = likely.fold([best_s - half_s, best_s + half_s], |[low, high], own| {
            [low.min(own.0), high.max(own.0)]
        });
        Moment { time_s: best_s, interval_s }
    }
}

/// When an event of a set happened, beside all else that is in it; as it was where it is not in the set.
pub(super) fn placed(
    event: &Event,
    linear: &Linear,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    excess: f64,
) -> Moment {
    let place = || -> Option<Moment> {
        let chosen = linear.candidates.iter().zip(set);
        let chosen = chosen.filter_map(|(own, form)| Some((own.id, &own.variants[(*form)?])));
        let columns: Vec<(&str, &Column)> = chosen
            .flat_map(|(id, form)| form.columns.iter().map(move |column| (id, column)))
            .collect();
        let is_own = |(id, column): &&(&str, &Column)| {
            *id == event.id() && column.moment.is_some_and(|own| own.0 == event.run)
        };
        let own = columns.iter().find(is_own)?.1;
        let (run, whitened) = (runs.get(event.run)?, linear.columns.get(event.run)?);
        // Other forms of its onset are left out: they stand for another moment.
        let others = columns
            .iter()
            .filter(|(id, column)| *id != event.id() || column.moment.is_some())
            .map(|(_, column)| column.at);
        let base = (0..linear.nuisances.len()).chain(others);
        let base: Vec<usize> = base.filter(|column| *column != own.at).collect();
        let given = Base::of_columns(linear, &base)?;
        let shift = whitened * &linear.present;
        let residual =
            |(k, white): (usize, &[f64; 2])| [white[0] + shift[2 * k], white[1] + shift[2 * k + 1]];
        let white = run.followed.white.iter().enumerate();
        let search = Search {
            run,
            event,
            slab: own.unit,
            residual: white.map(residual).collect(),
            columns: base.iter().map(|k| &whitened.columns[*k][..]).collect(),
            given,
        };
        Some(search.nearest(excess))
    };
    place().unwrap_or(Moment { time_s: event.time_s(), interval_s: [event.time_s(); 2] })
}

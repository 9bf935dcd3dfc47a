//! Events: effects that begin at an unknown time of a run, by the generalised likelihood ratio of a jump (Willsky and Jones, IEEE
//! Trans. Automatic Control 21, 1976): the time is that of the largest evidence, the size has the prior of a slab.
//!
//! ```text
//! shared model, events --in_run--> model of one run
//! parts           an event in one run at the times of a grid; in two runs: pairs of times
//! event_time_of   the likeliest time to a quarter of a sampling period, with its interval
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

/// Longest rise of an event's onset before its nominal time, in time constants of onsets: before, its column is zero.
const LEAD_ONSETS: f64 = 40.0;
/// Weights before, at and after the event time of a slower (or, negative, faster) onset, at one standard deviation.
const SLOWER: [f64; 3] = [0.5, -1.0, 0.5];
/// Errors of the form of an onset: weights, and the distance before and after the event time, in time constants of onsets. Shifted by
/// one, and spread over 1 to 160 (four to forty times of response) because the rate of rise is not known: a slow rise would otherwise be taken for a change of friction.
const ONSETS: [([f64; 3], f64); 5] =
    [([0.5, 0.0, -0.5], 1.0), (SLOWER, 1.0), (SLOWER, 10.0), (SLOWER, 40.0), (SLOWER, 160.0)];

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

    fn terms_at(&self, time_s: f64) -> Box<dyn Terms> {
        let mut there = self.clone();
        there.put_at(time_s);
        there.effect.terms(&there.values)
    }

    /// Tangent of an error of its onset's form.
    fn onset(&self, (weights, around): ([f64; 3], f64), onset_s: f64) -> Tangent {
        let around_s = around * onset_s;
        let parts = [-around_s, 0.0, around_s].into_iter().zip(weights);
        let terms_at = |after_s| self.terms_at(self.time_s() + after_s);
        Tangent::Event {
            parts: parts.map(|(after_s, weight)| (weight, terms_at(after_s))).collect(),
            begins_s: self.time_s() - around_s - LEAD_ONSETS * onset_s,
        }
    }

    /// Tangent of `unit` of its size at its time; `None` where it acts in the path and is no forcing.
    pub(super) fn slope(&self, unit: f64, onset_s: f64) -> Option<Tangent> {
        let acts = self.effect.terms(&self.values).path() == Path::default();
        acts.then(|| self.tangent(unit, self.time_s(), onset_s))
    }

    /// Tangent of a slab of it at another time.
    fn tangent(&self, slab: f64, time_s: f64, onset_s: f64) -> Tangent {
        let mut there = self.clone();
        there.values[self.effect.size_index()] = slab;
        Tangent::Event {
            parts: vec![(1.0, there.terms_at(time_s))],
            begins_s: time_s - LEAD_ONSETS * onset_s,
        }
    }
}

/// The model that all runs share, and the events of each run.
#[derive(Clone)]
pub(super) struct Hypothesis {
    pub(super) model: Model,
    pub(super) events: Vec<Event>,
}

impl Hypothesis {
    /// Of a fitted model; its events are those of the first run.
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

    /// Of a model of one run, its events kept in the model.
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

    /// Whether no event time differs from that in `before` by more than 1.5 sampling periods, within which its column is linear.
    pub(super) fn events_stay(&self, before: &Self, scenarios: &[&Scenario]) -> bool {
        self.events.iter().all(|event| {
            let period_s = scenarios[event.run].mean_period_s();
            before.events.iter().any(|other| {
                (other.id(), other.run) == (event.id(), event.run)
                    && (other.time_s() - event.time_s()).abs() <= 1.5 * period_s
            })
        })
    }

    /// Ids of its effects, an event once for each of its runs.
    pub(super) fn ids(&self) -> Vec<(&'static str, usize)> {
        let shared = self.model.effect_ids().into_iter().map(|id| (id, 0));
        let events = self.events.iter().map(|event| (event.id(), 1 + event.run));
        shared.chain(events).collect()
    }
}

/// Grid of event times: parts of a run. Steps of the load get a finer one, because many small ones represent a disturbance.
fn parts_of_run(effect: &dyn Effect) -> usize {
    if effect.card().is_disturbance_step { 96 } else { 48 }
}

fn spacing_s(run: &LinearisedRun<'_>, effect: &dyn Effect) -> f64 {
    let last_s = run.scenario.sample_time_s[run.scenario.samples() - 1];
    (last_s - run.scenario.begin_s()) / parts_of_run(effect) as f64
}

/// Log prior of an event at a given time of one run, of so many runs.
fn log_share_of_one(effect: &dyn Effect, runs: usize) -> f64 {
    let only = if runs > 1 { 0.5 / runs as f64 } else { 1.0 };
    only.ln() - ((parts_of_run(effect) - 1) as f64).ln()
}

/// Log prior of an event in two runs at given times.
fn log_share_of_two(effect: &dyn Effect) -> f64 {
    0.5_f64.ln() - 2.0 * ((parts_of_run(effect) - 1) as f64).ln()
}

/// The candidates of an event: as in the model, and in the runs in which the model lacks it.
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
    let typical = |run: &LinearisedRun<'_>| SLAB * typical_size(effect, size, model, run.scenario);
    let slabs: Vec<f64> = runs.iter().map(typical).collect();
    let onset_s = |run: usize| runs[run].scenario.scales.onset_s();
    // The column of an event whose size is so many slabs.
    let add = |form: &mut Form, event: &Event, present: f64| {
        let (unit, time_s) = (slabs[event.run], event.time_s());
        let column = Column {
            event_time: Some((event.run, time_s)),
            ..Column::of(Some(size), unit, present / unit)
        };
        let tangent = event.tangent(unit, time_s, onset_s(event.run));
        form.column(Source::In(event.run, tangent), column);
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
            let onset = event.onset(onset, onset_s(event.run));
            form.column(Source::In(event.run, onset), Column::default());
        }
        part.push(form);
        parts.push(part);
    }
    // The other run may have it, too.
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
        let others =
            hypothesis.events.iter().filter(|event| event.run == number && event.id() != id);
        for (time_s, is_rival) in grid.chain(others.map(|event| (event.time_s(), true))) {
            let mut event = Event { run: number, effect, values: guess.clone() };
            event.put_at(time_s);
            event.values[size] = slabs[number];
            let mut form = Form::new(event.values.clone(), log_share);
            add(&mut form, &event, 0.0);
            form.variant.is_rival = is_rival;
            part.push(form);
        }
    }
    parts.push(part);
    parts
}

/// Adds forms of events in two runs: pairs of likely times of an event that the model lacks, and each run alone of one that it has.
pub(super) fn pair(linear: &mut Linear, runs: &[LinearisedRun<'_>]) {
    if runs.len() < 2 {
        return;
    }
    let inside = linear
        .candidates
        .iter()
        .filter(|own| own.in_model)
        .flat_map(|own| own.variants[0].numbers());
    let indices: Vec<usize> = (0..linear.nuisances.len()).chain(inside).collect();
    let Some(base) = Base::of_columns(linear, &indices) else {
        return;
    };
    let gain = |column: usize| {
        let cross = DVector::from_fn(indices.len(), |r, _| linear.gram[(indices[r], column)]);
        let own = linear.gram[(column, column)] + 1.0;
        let [own, rest] = base.schur_complement(&cross, own, linear.right[column]);
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

/// Forms of an event of the model in two runs: in either run alone.
fn alone(candidate: &Candidate, runs: usize) -> Vec<Variant> {
    let both = &candidate.variants[0];
    let Some(effect) = candidate.effect.filter(|_| both.event_times().count() > 1) else {
        return vec![];
    };
    let own = both.columns.iter().filter(|column| column.event_time.is_some());
    let only = |column: &Column| Variant {
        columns: vec![*column],
        log_prior: log_share_of_one(effect, runs),
        ..both.clone()
    };
    own.map(only).collect()
}

/// Forms of an event that the model lacks, in two runs: the four likeliest times of each run, and those of other events. An event
/// before either shaft has turned equals an effect without a time, and is left out.
fn together(
    candidate: &Candidate,
    runs: &[LinearisedRun<'_>],
    gain: &impl Fn(usize) -> f64,
) -> Vec<Variant> {
    let Some(effect) = candidate.effect else {
        return vec![];
    };
    let of_run = |run: usize| -> Vec<&Variant> {
        let is_own = |form: &&Variant| form.event_times().next().is_some_and(|own| own.0 == run);
        let mut own: Vec<_> = candidate
            .variants
            .iter()
            .filter(is_own)
            .map(|form| (gain(form.columns[0].at), form))
            .collect();
        own.sort_by(|a, b| b.0.total_cmp(&a.0));
        let own = own.into_iter().map(|own| own.1).enumerate();
        let paired = own.filter(|(place, form)| *place < 4 || form.is_rival);
        paired.map(|(_, form)| form).collect()
    };
    let observable_s = [0, 1].map(|run| moves_s(&runs[run]) + spacing_s(&runs[run], effect));
    let happens = |form: &Variant| {
        let mut event_times = form.event_times();
        event_times.any(|(run, time_s)| time_s > observable_s[run])
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

/// Time at which the shaft of a run first turns, s after its first command.
fn moves_s(run: &LinearisedRun<'_>) -> f64 {
    let mut directions = run.filtered.direction.iter();
    let first = directions.position(|direction| *direction != 0.0);
    let time_s = first.map(|sample| run.scenario.sample_time_s[sample]);
    time_s.map_or(f64::INFINITY, |time_s| time_s - run.scenario.begin_s())
}

/// Estimated time of an event with its 95 % interval by the profile likelihood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EventTime {
    pub(super) time_s: f64,
    pub(super) interval_s: [f64; 2],
}

/// Evidence of an event at any time given the rest of a set, from the whitened residual of a run.
struct Search<'a> {
    run: &'a LinearisedRun<'a>,
    event: &'a Event,
    slab: f64,
    residual: Vec<[f64; 2]>,
    columns: Vec<&'a [f32]>,
    base: Base,
}

impl Search<'_> {
    /// Log evidence of the event at each of these times.
    fn gains(&self, times_s: &[f64]) -> Vec<f64> {
        let gains = |some: &[f64]| -> Vec<f64> {
            let onset_s = self.run.scenario.scales.onset_s();
            let tangent = |time_s: &f64| self.event.tangent(self.slab, *time_s, onset_s);
            let tangents: Vec<Tangent> = some.iter().map(tangent).collect();
            let tangents: Vec<&Tangent> = tangents.iter().collect();
            let mut products: Vec<Lane> = vec![[0.0; LANES]; self.columns.len() + 3];
            let (columns, residual) = (&self.columns, &self.residual);
            add_products(self.run, columns, residual, &tangents, &mut products);
            let gain = |lane| self.base.gain(&products, lane, 1);
            (0..some.len()).map(gain).collect()
        };
        let groups = times_s.par_chunks(LANES).with_max_len(1);
        groups.map(gains).collect::<Vec<_>>().concat()
    }

    /// The likeliest time near that of the event; `excess`: variance of the residual over that of white noise.
    fn likeliest_time(&self, excess: f64) -> EventTime {
        let times = &self.run.scenario.sample_time_s;
        let end_s = times[times.len() - 1] - self.run.scenario.begin_s();
        let period_s = self.run.scenario.mean_period_s();
        let spacing_s = spacing_s(self.run, self.event.effect);
        let is_inside = |time_s: &f64| (0.0..end_s).contains(time_s);
        // Four parts on either side in eight steps each: linearised far from the data it was wrong by more than one part.
        let mut step_s = 0.5 * spacing_s;
        let mut best_s = self.event.time_s();
        let mut evaluated: Vec<(f64, f64)> = Vec::new();
        // Five levels, down to a quarter of a period.
        for _ in 0..5 {
            let tried: Vec<f64> =
                (-8..=8).map(|k| best_s + f64::from(k) * step_s).filter(is_inside).collect();
            evaluated.extend(tried.iter().copied().zip(self.gains(&tried)));
            let likeliest = evaluated.iter().max_by(|a, b| a.1.total_cmp(&b.1));
            best_s = likeliest.map_or(best_s, |evaluated| evaluated.0);
            if step_s < 0.25 * period_s {
                break;
            }
            step_s *= 0.25;
        }
        let gains = evaluated.iter().map(|evaluated| evaluated.1);
        // Half of the 95 % quantile of chi-squared with one degree of freedom (3.84).
        let least = gains.fold(f64::NEG_INFINITY, f64::max) - 1.92 * excess;
        // At rest the likelihood is flat: the interval grows step by step.
        let wide_s = 0.5 * spacing_s;
        for side in [-1.0, 1.0] {
            let reach = evaluated
                .iter()
                .filter(|evaluated| evaluated.1 > least)
                .map(|evaluated| side * evaluated.0);
            let mut from_s = reach.fold(f64::MIN, f64::max) * side;
            loop {
                let further: Vec<f64> = (1..=LANES)
                    .map(|k| from_s + side * wide_s * k as f64)
                    .filter(is_inside)
                    .collect();
                let gains = self.gains(&further);
                let likely = gains.iter().take_while(|gain| **gain > least).count();
                evaluated.extend(further.iter().copied().zip(gains).take(likely));
                if likely < LANES {
                    break;
                }
                from_s = further[LANES - 1];
            }
        }
        // At least half a sampling period to each side.
        let half_s = 0.5 * period_s;
        let likely = evaluated.iter().filter(|evaluated| evaluated.1 > least);
        let interval_s = likely.fold([best_s - half_s, best_s + half_s], |[low, high], own| {
            [low.min(own.0), high.max(own.0)]
        });
        EventTime { time_s: best_s, interval_s }
    }
}

/// Time of an event of a set given the rest of the set; unchanged where it is not in the set.
pub(super) fn event_time_of(
    event: &Event,
    linear: &Linear,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    excess: f64,
) -> EventTime {
    let place = || -> Option<EventTime> {
        let chosen = linear
            .candidates
            .iter()
            .zip(set)
            .filter_map(|(own, form)| Some((own.id, &own.variants[(*form)?])));
        let columns: Vec<(&str, &Column)> = chosen
            .flat_map(|(id, form)| form.columns.iter().map(move |column| (id, column)))
            .collect();
        let is_own = |(id, column): &&(&str, &Column)| {
            *id == event.id() && column.event_time.is_some_and(|own| own.0 == event.run)
        };
        let own = columns.iter().find(is_own)?.1;
        let (run, whitened) = (runs.get(event.run)?, linear.columns.get(event.run)?);
        // Without the columns of its onset's form: a shifted onset is another time.
        let others = columns
            .iter()
            .filter(|(id, column)| *id != event.id() || column.event_time.is_some())
            .map(|(_, column)| column.at);
        let indices: Vec<usize> =
            (0..linear.nuisances.len()).chain(others).filter(|column| *column != own.at).collect();
        let base = Base::of_columns(linear, &indices)?;
        let shift = whitened * &linear.present;
        let residual =
            |(k, white): (usize, &[f64; 2])| [white[0] + shift[2 * k], white[1] + shift[2 * k + 1]];
        let white = run.filtered.white.iter().enumerate();
        let search = Search {
            run,
            event,
            slab: own.unit,
            residual: white.map(residual).collect(),
            columns: indices.iter().map(|k| &whitened.columns[*k][..]).collect(),
            base,
        };
        Some(search.likeliest_time(excess))
    };
    place().unwrap_or(EventTime { time_s: event.time_s(), interval_s: [event.time_s(); 2] })
}

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

use super::columns::{Candidate, Column, Form, Linear, LinearisedRun, Part, SLAB, Source, Variant};
use super::forms::{Base, add_products};
use super::select::Set;
use super::tangent::{LANES, Lane, Tangent};
use drivebench_model::plant::{
    ActiveEffect, Effect, Instant, Model, ParameterRole, ParameterSpec, Path, Scenario, Terms,
    typical_size,
};

/// Moments of a run that are tried are parts of so many, of a step of the load and of each of the others.
const PLACES: usize = 96;
const PLACES_OTHER: usize = 48;
/// Time before its moment from which on an event may do anything, s.
const LEAD_S: f64 = 0.4;
/// Moments of each run that are tried in pairs.
const PAIRED: usize = 4;
/// Moments on either side of the one that is looked for more finely, and how much finer they lie each time.
const AROUND: i32 = 8;
/// Parts of a run on either side within which it is looked for: linearised far from the data it was put wrong by more than
/// one.
const WIDE_PARTS: f64 = 4.0;
/// Levels of looking more finely.
const LEVELS: usize = 5;
/// Periods of a run by which an event may still move.
const STAYS_PERIODS: f64 = 1.5;
/// Part of a period below which moments are not told apart.
const FINE_PERIODS: f64 = 0.25;
/// Fall of the log likelihood at the ends of a 95 % interval.
const INTERVAL_NATS: f64 = 1.92;

/// Time before and behind the moment by which an onset may have another form, s: nobody knows how fast it comes.
const ONSET_S: f64 = 0.01;
/// Its forms, at one standard deviation: later or earlier, and slower or faster, by the weights before, at and behind it.
const ONSET_FORMS: [[f64; 3]; 2] = [[0.5, 0.0, -0.5], SLOWER];
const SLOWER: [f64; 3] = [0.5, -1.0, 0.5];
/// Times before and behind the moment over which it may build up, s: what comes slowly would pass for a friction beside it.
const BUILDS_UP_S: [f64; 3] = [0.1, 0.4, 1.6];

/// A sum of terms that have no states, each with its weight.
struct Weighted(Vec<(f64, Box<dyn Terms>)>);

impl Weighted {
    fn sum(&self, of: impl Fn(&dyn Terms) -> f64) -> f64 {
        let parts = self.0.iter();
        parts.map(|(weight, terms)| weight * of(&**terms)).sum()
    }
}

impl Terms for Weighted {
    fn voltage_v(&self, at: &Instant, own: &[f64]) -> f64 {
        self.sum(|terms| terms.voltage_v(at, own))
    }

    fn torque_n_m(&self, at: &Instant, own: &[f64]) -> f64 {
        self.sum(|terms| terms.torque_n_m(at, own))
    }

    fn friction_n_m(&self, at: &Instant) -> f64 {
        self.sum(|terms| terms.friction_n_m(at))
    }

    fn current_rate_gain(&self, at: &Instant) -> f64 {
        self.sum(|terms| terms.current_rate_gain(at))
    }

    fn inertia_gain(&self, at: &Instant) -> f64 {
        self.sum(|terms| terms.inertia_gain(at))
    }
}

/// An event of one run.
#[derive(Clone)]
pub(super) struct Event {
    pub(super) run: usize,
    pub(super) effect: &'static dyn Effect,
    pub(super) values: Vec<f64>,
}

/// Which of an effect's parameters says when it happens; none where it is no event.
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

    /// What another form of its onset does, which differs so long before and behind the moment.
    fn bent(&self, weights: [f64; 3], around_s: f64) -> Box<dyn Terms> {
        let parts = [-around_s, 0.0, around_s].into_iter().zip(weights);
        let part = |(after_s, weight): (f64, f64)| {
            let mut there = self.clone();
            there.put_at(self.time_s() + after_s);
            (weight, self.effect.terms(&there.values))
        };
        Box::new(Weighted(parts.map(part).collect()))
    }

    /// What `unit` of its size does where it is; `None` where that is no forcing.
    pub(super) fn slope(&self, unit: f64) -> Option<Tangent> {
        let acts = self.effect.terms(&self.values).path() == Path::default();
        acts.then(|| self.tangent(unit, self.time_s()))
    }

    /// The same with a slab of it at another moment.
    fn tangent(&self, slab: f64, time_s: f64) -> Tangent {
        let mut values = self.values.clone();
        values[self.effect.size_index()] = slab;
        if let Some(k) = time_of(self.effect) {
            values[k] = time_s;
        }
        Tangent::Event {
            terms: self.effect.terms(&values),
            begins_s: time_s - LEAD_S,
        }
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
        let mut model = model.clone();
        let mut events = Vec::new();
        model.effects.retain(|active| {
            let is_event = time_of(active.effect).is_some();
            if is_event {
                events.push(Event {
                    run: 0,
                    effect: active.effect,
                    values: active.values_or_guess(),
                });
            }
            !is_event
        });
        Self { model, events }
    }

    /// A model of one run, whatever happens in it.
    pub(super) fn whole(model: &Model) -> Self {
        Self {
            model: model.clone(),
            events: vec![],
        }
    }

    pub(super) fn events_of(&self, run: usize) -> Vec<ActiveEffect> {
        let own = self.events.iter().filter(|event| event.run == run);
        own.map(Event::active).collect()
    }

    /// The model of one run.
    pub(super) fn in_run(&self, run: usize) -> Model {
        let mut model = self.model.clone();
        model.effects.extend(self.events_of(run));
        model
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

    /// Whether no event happens at another sample than `before`: its form is linear only close to where it is.
    pub(super) fn events_stay(&self, before: &Self, scenarios: &[&Scenario]) -> bool {
        self.events.iter().all(|event| {
            let period_s = scenarios[event.run].mean_period_s();
            let mut others = before.events.iter();
            others.any(|other| {
                (other.id(), other.run) == (event.id(), event.run)
                    && (other.time_s() - event.time_s()).abs() <= STAYS_PERIODS * period_s
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
    if effect.card().is_disturbance_step {
        PLACES
    } else {
        PLACES_OTHER
    }
}

fn spacing_s(run: &LinearisedRun<'_>, effect: &dyn Effect) -> f64 {
    let last_s = run.scenario.sample_time_s[run.scenario.samples() - 1];
    (last_s - run.scenario.begin_s()) / parts_of_run(effect) as f64
}

/// Log of the share beforehand of what happens in one run only at a given moment, in so many runs.
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
    let slab = |run: &LinearisedRun<'_>| SLAB * typical_size(effect, size, model, run.scenario);
    let of_size = |unit, moment, present| Column {
        moment: Some(moment),
        ..Column::of(Some(size), unit, present)
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
            let unit = slab(&runs[event.run]);
            let source = Source::In(event.run, event.tangent(unit, event.time_s()));
            let (moment, present) = ((event.run, event.time_s()), event.values[size] / unit);
            form.column(source, of_size(unit, moment, present));
        }
        for event in &own {
            let at_once = ONSET_FORMS.map(|weights| (weights, ONSET_S));
            let slowly = BUILDS_UP_S.map(|around_s| (SLOWER, around_s));
            for (weights, around_s) in at_once.into_iter().chain(slowly) {
                let bent = Tangent::Event {
                    terms: event.bent(weights, around_s),
                    begins_s: event.time_s() - around_s - LEAD_S,
                };
                form.column(Source::In(event.run, bent), Column::default());
            }
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
        let unit = slab(run);
        let part_s = spacing_s(run, effect);
        let grid = (1..parts_of_run(effect)).map(|place| part_s * place as f64);
        let others = hypothesis.events.iter();
        let others = others.filter(|event| event.run == number && event.id() != id);
        let others = others.map(|event| (event.time_s(), true));
        for (time_s, is_rival) in grid.map(|time_s| (time_s, false)).chain(others) {
            let mut event = Event {
                run: number,
                effect,
                values: guess.clone(),
            };
            event.put_at(time_s);
            event.values[size] = unit;
            let source = Source::In(number, event.tangent(unit, time_s));
            let mut form = Form::new(event.values, log_share);
            form.column(source, of_size(unit, (number, time_s), 0.0));
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
    let base: Vec<usize> = (0..linear.nuisances.len())
        .chain(in_model(&linear.candidates))
        .collect();
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

fn in_model(candidates: &[Candidate]) -> impl Iterator<Item = usize> {
    let inside = candidates.iter().filter(|candidate| candidate.in_model);
    inside.flat_map(|candidate| candidate.variants[0].numbers())
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

/// An event that the model lacks, in two runs at once. What was there before either moved is no event but always there, and
/// would lend the effects that always are a sign that they do not have.
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
        let is_paired = |(place, own): &(usize, (f64, &Variant))| *place < PAIRED || own.1.is_rival;
        let own = own.into_iter().enumerate().filter(is_paired);
        own.map(|(_, own)| own.1).collect()
    };
    let (first, second) = (of_run(0), of_run(1));
    let both = |a: &Variant, b: &Variant| Variant {
        columns: [&a.columns[..], &b.columns].concat(),
        log_prior: log_share_of_two(effect),
        ..a.clone()
    };
    let observable_s = [0, 1].map(|run| moves_s(&runs[run]) + spacing_s(&runs[run], effect));
    let happens = |form: &Variant| {
        let mut moments = form.moments();
        moments.any(|(run, time_s)| time_s > observable_s[run])
    };
    let pairs = first
        .iter()
        .flat_map(|a| second.iter().map(move |b| (a, b)));
    let pairs = pairs.filter(|(a, b)| happens(a) || happens(b));
    pairs.map(|(a, b)| both(a, b)).collect()
}

/// When the shaft of a run turns first, s after its first command.
fn moves_s(run: &LinearisedRun<'_>) -> f64 {
    let directions = run.followed.direction.iter();
    let first = directions
        .zip(&run.scenario.sample_time_s)
        .find(|(direction, _)| **direction != 0.0);
    first.map_or(f64::INFINITY, |(_, time_s)| time_s - run.scenario.begin_s())
}

/// When an event happened, with the interval that holds the moment with 95 %.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    pub(super) time_s: f64,
    pub(super) interval_s: [f64; 2],
}

/// Where the whitened residual of a run, all that is in the model taken out, asks for an event beside the rest of a set.
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
            let lanes = 0..some.len();
            lanes
                .map(|lane| self.given.gain(&products, lane, 1))
                .collect()
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
        let mut step_s = WIDE_PARTS * spacing_s / f64::from(AROUND);
        let mut best_s = self.event.time_s();
        let mut evaluated: Vec<(f64, f64)> = Vec::new();
        for _ in 0..LEVELS {
            let tried = (-AROUND..=AROUND).map(|k| best_s + f64::from(k) * step_s);
            let tried: Vec<f64> = tried.filter(is_inside).collect();
            evaluated.extend(tried.iter().copied().zip(self.gains(&tried)));
            let likeliest = evaluated.iter().max_by(|a, b| a.1.total_cmp(&b.1));
            best_s = likeliest.map_or(best_s, |evaluated| evaluated.0);
            if step_s < FINE_PERIODS * period_s {
                break;
            }
            step_s *= 2.0 / f64::from(AROUND);
        }
        let gains = evaluated.iter().map(|evaluated| evaluated.1);
        let most = gains.fold(f64::NEG_INFINITY, f64::max);
        let least = most - INTERVAL_NATS * excess;
        // Where nothing moves the moment may be anywhere.
        let wide_s = 0.5 * spacing_s;
        for side in [-1.0, 1.0] {
            let reach = evaluated.iter().filter(|evaluated| evaluated.1 > least);
            let mut from_s = reach
                .map(|evaluated| side * evaluated.0)
                .fold(f64::MIN, f64::max)
                * side;
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
        let likely = evaluated.iter().filter(|evaluated| evaluated.1 > least);
        // Between two samples nothing is observed.
        let half_s = 0.5 * period_s;
        let interval_s = likely.fold(
            [best_s - half_s, best_s + half_s],
            |[low, high], evaluated| [low.min(evaluated.0), high.max(evaluated.0)],
        );
        Moment {
            time_s: best_s,
            interval_s,
        }
    }
}

/// The column that an event of a set has.
fn column_of(linear: &Linear, set: &Set, event: &Event) -> Option<Column> {
    let chosen = linear.candidates.iter().zip(set);
    let own = chosen.filter(|(candidate, _)| candidate.id == event.id());
    let forms = own.filter_map(|(candidate, form)| Some(&candidate.variants[(*form)?]));
    let mut columns = forms.flat_map(|form| &form.columns).copied();
    columns.find(|column| column.moment.is_some_and(|own| own.0 == event.run))
}

/// When each of the events of a set happened, beside all else that is in it; as it was where it is not in the set.
pub(super) fn placed(
    events: &[Event],
    linear: &Linear,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    excess: f64,
) -> Vec<Moment> {
    let placed = |event: &Event| {
        let there = Moment {
            time_s: event.time_s(),
            interval_s: [event.time_s(); 2],
        };
        place(event, linear, set, runs, excess).unwrap_or(there)
    };
    events.iter().map(placed).collect()
}

fn place(
    event: &Event,
    linear: &Linear,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    excess: f64,
) -> Option<Moment> {
    let own = column_of(linear, set, event)?;
    let (run, whitened) = (runs.get(event.run)?, linear.columns.get(event.run)?);
    let chosen = linear.candidates.iter().zip(set);
    let others = chosen.flat_map(|(candidate, form)| {
        let columns = form.map_or(&[][..], |form| &candidate.variants[form].columns);
        // What another form of its onset does is what is looked for.
        let is_other = candidate.id != event.id();
        let kept = columns
            .iter()
            .filter(move |own| is_other || own.moment.is_some());
        kept.map(|column| column.at)
    });
    let base = (0..linear.nuisances.len()).chain(others);
    let base: Vec<usize> = base.filter(|column| *column != own.at).collect();
    let given = Base::of_columns(linear, &base)?;
    let shift = whitened * &linear.present;
    let white = run.followed.white.iter().enumerate();
    let residual = white
        .map(|(k, white)| [0, 1].map(|signal| white[signal] + shift[2 * k + signal]))
        .collect();
    let search = Search {
        run,
        event,
        slab: own.unit,
        residual,
        columns: base.iter().map(|k| &whitened.columns[*k][..]).collect(),
        given,
    };
    Some(search.nearest(excess))
}

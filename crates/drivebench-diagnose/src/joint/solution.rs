//! The posterior mean of a set as a hypothesis: the runs linearised there, the model and the events that it has.

use rayon::prelude::*;

use super::columns::{Candidate, Column, Linear, LinearisedRun};
use super::events::{self, Event, Hypothesis, Moment};
use super::follow::Noise;
use super::select::{Reduced, Set};
use crate::work::Work;
use drivebench_model::plant::{ActiveEffect, Scenario, State};

/// A positive coefficient starts no lower than this share of its slab: at zero it has no slope to go by.
const LEAST_START_SHARE: f64 = 0.02;

/// An event of the best set.
#[derive(Clone)]
pub(super) struct Happened {
    pub(super) event: Event,
    pub(super) moment: Moment,
    /// Standard deviation of its size.
    pub(super) deviation: f64,
}

pub(super) fn linearised_runs<'a>(
    hypothesis: &Hypothesis,
    scenarios: &[&'a Scenario],
    starts: &[State],
    noise: Noise,
    work: Option<&'a Work>,
) -> Option<Vec<LinearisedRun<'a>>> {
    let runs = scenarios.par_iter().zip(starts).enumerate();
    runs.with_max_len(1)
        .map(|(number, (scenario, start))| {
            let own = hypothesis.events_of(number);
            let run = LinearisedRun::beside(&hypothesis.model, own, scenario, *start, noise)?;
            Some(run.counted(work))
        })
        .collect()
}

/// The candidates that a model has.
pub(super) fn present(linear: &Linear) -> Set {
    let candidates = linear.candidates.iter();
    candidates
        .map(|candidate| candidate.in_model.then_some(0))
        .collect()
}

/// The events of a form of a candidate, as large as the linear solution has them.
fn happening(
    candidate: &Candidate,
    form: usize,
    size: impl Fn(usize) -> Option<f64>,
) -> Option<Vec<Event>> {
    let variant = &candidate.variants[form];
    let effect = candidate.effect?;
    let time = events::time_of(effect)?;
    let happens = |(column, (run, time_s)): (&Column, (usize, f64))| {
        let values = variant.values.clone();
        let mut event = Event {
            run,
            effect,
            values,
        };
        let index = event.effect.size_index();
        event.values[time] = time_s;
        let spec = &effect.parameters()[index];
        event.values[index] = (size(column.at)? * column.unit).clamp(spec.min, spec.max);
        Some(event)
    };
    let columns = variant.columns.iter();
    let moments = columns.filter_map(|column| Some((column, column.moment?)));
    moments.map(happens).collect()
}

/// What there is at the linear solution of a set.
pub(super) fn at_solution(
    hypothesis: &Hypothesis,
    reduced: &Reduced,
    set: &Set,
) -> Option<Hypothesis> {
    let linear = &reduced.linear;
    let columns = reduced.columns(set);
    let (mean, _) = reduced.sizes(&columns)?;
    let m = linear.nuisances.len();
    let place = |column: usize| columns.iter().position(|own| *own == column - m);
    let size = |column: usize| place(column).map(|at| mean[at]);
    let mut next = hypothesis.model.clone();
    let mut happens: Vec<Event> = Vec::new();
    for (candidate, chosen) in linear.candidates.iter().zip(set) {
        let Some(effect) = candidate.effect else {
            continue;
        };
        if candidate.is_event() {
            if let Some(form) = chosen {
                happens.extend(happening(candidate, *form, size)?);
            }
            continue;
        }
        match chosen {
            None => {
                if candidate.in_model {
                    next = next.without_effect(candidate.id).ok()?;
                }
            }
            Some(v) if !candidate.in_model => {
                let variant = &candidate.variants[*v];
                let mut values = variant.values.clone();
                let specs = effect.parameters();
                for column in &variant.columns {
                    let parameter = column.parameter.filter(|k| specs[*k].is_coefficient());
                    let Some(parameter) = parameter else { continue };
                    let mut x = size(column.at)?;
                    if specs[parameter].min >= 0.0 || effect.card().takes_power {
                        x = x.max(LEAST_START_SHARE);
                    }
                    values[parameter] = x * column.unit;
                }
                next.effects.retain(|active| active.id() != candidate.id);
                next.effects.push(ActiveEffect::with(effect, &values));
            }
            Some(_) => {}
        }
    }
    Some(Hypothesis {
        model: next,
        events: happens,
    })
}

/// The same with its events at their likeliest moments.
pub(super) fn placed(
    hypothesis: &Hypothesis,
    reduced: &Reduced,
    set: &Set,
    runs: &[LinearisedRun<'_>],
) -> Option<Hypothesis> {
    let mut next = at_solution(hypothesis, reduced, set)?;
    let moments = events::placed(&next.events, &reduced.linear, set, runs, 1.0);
    for (event, moment) in next.events.iter_mut().zip(moments) {
        event.put_at(moment.time_s);
    }
    Some(next)
}

/// The events of a set with all that is known of them.
pub(super) fn happened(
    reduced: &Reduced,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    excess: f64,
) -> Option<Vec<Happened>> {
    let linear = &reduced.linear;
    let columns = reduced.columns(set);
    let (mean, covariance) = reduced.sizes(&columns)?;
    let m = linear.nuisances.len();
    let at = |column: usize| columns.iter().position(|c| *c == column - m);
    let mut all = Vec::new();
    for (candidate, chosen) in linear.candidates.iter().zip(set) {
        let Some(form) = chosen.filter(|_| candidate.is_event()) else {
            continue;
        };
        let variant = &candidate.variants[form];
        let own = happening(candidate, form, |column| at(column).map(|k| mean[k]))?;
        let moments = events::placed(&own, linear, set, runs, excess);
        let columns = variant.columns.iter().filter(|own| own.moment.is_some());
        for ((mut event, moment), column) in own.into_iter().zip(moments).zip(columns) {
            let k = at(column.at)?;
            event.put_at(moment.time_s);
            all.push(Happened {
                event,
                moment,
                deviation: covariance[(k, k)].sqrt() * column.unit,
            });
        }
    }
    Some(all)
}

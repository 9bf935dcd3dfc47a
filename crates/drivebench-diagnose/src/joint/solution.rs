//! Posterior mean of a set converted to a hypothesis: a model with its events.

use rayon::prelude::*;

use super::events::{self, Event, EventTime, Hypothesis};
use super::kalman::Noise;
use super::regression::{Candidate, Linear};
use super::run::LinearisedRun;
use super::select::{Estimate, Reduced, Set};
use crate::work::Work;
use drivebench_model::plant::{ActiveEffect, Scenario, State};

/// An event of the best set.
#[derive(Clone)]
pub(super) struct FittedEvent {
    pub(super) event: Event,
    pub(super) event_time: EventTime,
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
            LinearisedRun::with(&hypothesis.model, own, scenario, *start, noise, work)
        })
        .collect()
}

/// The set of the candidates that the model has.
pub(super) fn present(linear: &Linear) -> Set {
    let candidates = linear.candidates.iter();
    candidates.map(|candidate| candidate.in_model.then_some(0)).collect()
}

/// The events of a form of a candidate at the linear solution, each with the standard deviation of its size.
fn events_of_form(
    candidate: &Candidate,
    form: usize,
    estimate: &Estimate,
) -> Option<Vec<(Event, f64)>> {
    let variant = &candidate.variants[form];
    let effect = candidate.effect?;
    let columns = variant.columns.iter();
    let event_times = columns.filter_map(|column| Some((column, column.event_time?)));
    event_times
        .map(|(column, (run, time_s))| {
            let mut event = Event { run, effect, values: variant.values.clone() };
            event.put_at(time_s);
            let spec = &effect.parameters()[effect.size_index()];
            let (mean, variance) = estimate.of(column.at)?;
            event.values[effect.size_index()] = (mean * column.unit).clamp(spec.min, spec.max);
            Some((event, variance.sqrt() * column.unit))
        })
        .collect()
}

/// Hypothesis at the posterior mean of a set.
pub(super) fn at_solution(
    hypothesis: &Hypothesis,
    reduced: &Reduced,
    set: &Set,
) -> Option<Hypothesis> {
    let estimate = reduced.estimate(set)?;
    let mut next = hypothesis.model.clone();
    let mut happens: Vec<Event> = Vec::new();
    for (candidate, chosen) in reduced.linear.candidates.iter().zip(set) {
        let Some(effect) = candidate.effect else {
            continue;
        };
        match chosen {
            Some(form) if candidate.is_event() => {
                let own = events_of_form(candidate, *form, &estimate)?;
                happens.extend(own.into_iter().map(|own| own.0));
            }
            None if candidate.in_model && !candidate.is_event() => {
                next = next.without_effect(candidate.id).ok()?;
            }
            Some(v) if !candidate.in_model => {
                let variant = &candidate.variants[*v];
                let mut values = variant.values.clone();
                let specs = effect.parameters();
                for column in &variant.columns {
                    let parameter = column.parameter.filter(|k| specs[*k].is_coefficient());
                    let Some(parameter) = parameter else { continue };
                    let mut x = estimate.of(column.at)?.0;
                    if specs[parameter].min >= 0.0 || effect.card().takes_power {
                        // A positive coefficient has no derivative at zero.
                        x = x.max(0.02);
                    }
                    values[parameter] = x * column.unit;
                }
                next.effects.retain(|active| active.id() != candidate.id);
                next.effects.push(ActiveEffect::with(effect, &values));
            }
            _ => {}
        }
    }
    Some(Hypothesis { model: next, events: happens })
}

/// The same with the events at their maximum-likelihood times.
pub(super) fn with_event_times(
    hypothesis: &Hypothesis,
    reduced: &Reduced,
    set: &Set,
    runs: &[LinearisedRun<'_>],
) -> Option<Hypothesis> {
    let mut next = at_solution(hypothesis, reduced, set)?;
    for event in &mut next.events {
        event.put_at(events::event_time_of(event, &reduced.linear, set, runs, 1.0).time_s);
    }
    Some(next)
}

/// The events of a set with their times and sizes.
pub(super) fn fitted_events(
    reduced: &Reduced,
    set: &Set,
    runs: &[LinearisedRun<'_>],
    excess: f64,
) -> Option<Vec<FittedEvent>> {
    let linear = &reduced.linear;
    let estimate = reduced.estimate(set)?;
    let mut all = Vec::new();
    for (candidate, chosen) in linear.candidates.iter().zip(set) {
        let Some(form) = chosen.filter(|_| candidate.is_event()) else {
            continue;
        };
        for (mut event, deviation) in events_of_form(candidate, form, &estimate)? {
            let event_time = events::event_time_of(&event, linear, set, runs, excess);
            event.put_at(event_time.time_s);
            all.push(FittedEvent { event, event_time, deviation });
        }
    }
    Some(all)
}

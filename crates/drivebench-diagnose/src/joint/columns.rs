//! Design matrix of the regression on which effects are selected: sensitivity of the standardised innovations to each parameter,
//! by tangent linearisation or by finite differences, for one slab.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::eligible::{resolves_wave, why_not};
use super::events::{self, Hypothesis};
use super::nuisances::{bends, nuisances, unknown_curves};
use super::regression::{Candidate, Column, Form, Linear, Part, SLAB, Source};
use super::run::LinearisedRun;
use super::screening::{drop_refuted, keep_likeliest};
use super::tangent::{self, LANES, Tangent};
use super::whitened::Whitened;
use drivebench_model::plant::effect::Axis;
use drivebench_model::plant::{
    ActiveEffect, Balance, Effect, Enters, Input, Model, ParameterRole, ParameterSpec, Scenario,
    typical_size,
};

/// Columns of an effect that the model has: its parameters and the perturbations of its form.
fn of_model(model: &Model, effect: &'static dyn Effect, scenario: &Scenario) -> Option<Part> {
    let id = effect.card().id;
    let specs = effect.parameters();
    let mut part = Part::new(effect);
    part.candidate.in_model = true;
    let mut effects = model.effects.iter();
    let values = effects.find(|active| active.id() == id)?.values_or_guess();
    let along = tangent::are_tangents(model, scenario);
    let mut form = Form::new(values.clone(), 0.0);
    if !specs.iter().any(ParameterSpec::is_coefficient) {
        form.fixed_size(model.without_effect(id).ok()?, true);
    }
    for (index, spec) in specs.iter().enumerate() {
        if spec.role == ParameterRole::Choice {
            continue;
        }
        let is_size = spec.is_coefficient();
        let unit = if is_size {
            SLAB * typical_size(effect, index, model, scenario)
        } else if spec.logarithmic {
            // The prior of a shape's logarithm: a factor of two.
            0.7 * values[index]
        } else {
            spec.in_run(&scenario.scales).scale
        };
        let (present, share) = if is_size { (values[index] / unit, 0.02) } else { (0.0, 0.01) };
        let step = share * unit;
        form.variant.positive |= is_size && (spec.min >= 0.0 || effect.card().takes_power);
        let change = (step, step / unit);
        let tangent =
            along.then(|| tangent::parameter_tangent(effect, &values, index, unit, change));
        let source = tangent.flatten().map_or_else(
            || {
                let mut moved = model.clone();
                let mut there = values.clone();
                there[index] += step;
                let own = moved.effects.iter_mut().filter(|other| other.id() == id);
                own.for_each(|own| *own = ActiveEffect::with(effect, &there));
                Source::difference(moved, step / unit)
            },
            Source::Tangent,
        );
        form.column(source, Column::of(Some(index), unit, present));
    }
    for tangent in bends(model, effect, &values, scenario) {
        form.column(Source::Tangent(tangent), Column::default());
    }
    part.push(form);
    Some(part)
}

/// Columns of an effect that the model lacks, for each form of its grid.
fn not_in_model(model: &Model, effect: &'static dyn Effect, scenario: &Scenario) -> Part {
    let (specs, card) = (effect.parameters(), effect.card());
    let mut part = Part::new(effect);
    let coefficients: Vec<(usize, f64)> = (0..specs.len())
        .filter(|k| specs[*k].is_coefficient())
        .map(|k| (k, SLAB * typical_size(effect, k, model, scenario)))
        .collect();
    let order = specs.iter().position(|spec| spec.key == "order");
    let grid = shape_grid(effect, scenario);
    let log_prior = -(grid.len() as f64).ln();
    for shape in grid {
        let mut limit = card.limit.iter();
        let periods = order.map_or(1.0, |order| shape[order]);
        if limit.any(|limit| shape[limit.parameter] < limit.least_in(effect, scenario))
            || (card.needs_angle && !resolves_wave(effect, scenario, periods))
        {
            continue;
        }
        let mut form = Form::new(shape.clone(), log_prior);
        if coefficients.is_empty() {
            let mut with = model.clone();
            with.effects.push(ActiveEffect::with(effect, &shape));
            form.fixed_size(with, false);
        }
        for (index, slab) in coefficients.iter().copied() {
            let mut values = shape.clone();
            for (other, _) in &coefficients {
                values[*other] = 0.0;
            }
            values[index] = slab;
            form.variant.values[index] = slab;
            form.variant.positive |= specs[index].min >= 0.0 || card.takes_power;
            let source = coefficient_alone(model, effect, &values, index);
            form.column(source, Column::of(Some(index), slab, 0.0));
        }
        part.push(form);
    }
    part
}

/// Every combination of the grids of an effect's shapes, choices and event times; its coefficients at zero.
fn shape_grid(effect: &dyn Effect, training: &Scenario) -> Vec<Vec<f64>> {
    let specs = effect.parameters();
    let mut grid = vec![vec![0.0; specs.len()]];
    for (index, spec) in specs.iter().enumerate() {
        if spec.is_coefficient() {
            continue;
        }
        let with = |values: &Vec<f64>, shape: f64| {
            let mut values = values.clone();
            values[index] = shape;
            values
        };
        let range = spec.in_run(&training.scales);
        let shapes = |values| range.shapes().map(move |shape| with(values, shape));
        grid = grid.iter().flat_map(shapes).collect();
    }
    grid
}

/// Column of one coefficient of an effect, all other coefficients at zero: its tangent, or a finite difference over a quarter of
/// the slab.
fn coefficient_alone(
    model: &Model,
    effect: &'static dyn Effect,
    values: &[f64],
    index: usize,
) -> Source {
    let step = 0.25;
    if let Some(tangent) = tangent::coefficient_tangent(effect, values, index) {
        return Source::Tangent(tangent);
    }
    let mut with = model.clone();
    let mut values = values.to_vec();
    values[index] *= step;
    with.effects.push(ActiveEffect::with(effect, &values));
    Source::difference(with, step)
}

/// Sources of the columns of the effects that the model has, or of those that it lacks.
fn sources_of(parts: &[Part], in_model: bool) -> impl Iterator<Item = &Source> {
    let parts = parts.iter();
    let own = parts.filter(move |part| part.candidate.in_model == in_model);
    own.flat_map(|part| part.sources.iter().flatten())
}

/// Linear problem of `runs` about a hypothesis, with which every run must have been filtered.
pub(super) fn linearise(
    hypothesis: &Hypothesis,
    eligible: &[&'static dyn Effect],
    runs: &[LinearisedRun<'_>],
    unknowns: bool,
) -> Option<Linear> {
    let (training, model) = (runs[0].scenario, &hypothesis.model);
    let (always, nuisances): (Vec<Source>, Vec<f64>) =
        nuisances(model, training)?.into_iter().unzip();
    let of_effect = |effect: &&'static dyn Effect| {
        if events::time_of(*effect).is_some() {
            Some(events::parts(hypothesis, *effect, runs))
        } else if model.has(effect.card().id) {
            of_model(model, *effect, training).map(|part| vec![part])
        } else {
            Some(vec![not_in_model(model, *effect, training)])
        }
    };
    let parts: Vec<Vec<Part>> = eligible
        .par_iter()
        .filter(|effect| why_not(**effect, training).is_none())
        .map(of_effect)
        .collect::<Option<_>>()?;
    let mut parts: Vec<Part> = parts.into_iter().flatten().collect();
    parts.retain(|part| !part.sources.is_empty());
    if unknowns {
        parts.extend(unknown_curves(runs));
    }

    // Columns of the model first: forms are screened given these.
    let inside: Vec<&Source> = always.iter().chain(sources_of(&parts, true)).collect();
    let base = columns_of(&inside, runs);
    let precision_of = |k| nuisances.get(k).map_or(1.0, |sd: &f64| 1.0 / (sd * sd));
    let precision: Vec<f64> = (0..base[0].columns.len()).map(precision_of).collect();
    keep_likeliest(&mut parts, runs, &base, &precision);
    drop_refuted(&mut parts, &runs[0], &base[0], &precision);
    let others = columns_of(&sources_of(&parts, false).collect::<Vec<_>>(), runs);

    // Numbered in the candidates' order.
    let mut order: Vec<(bool, usize)> = (0..always.len()).map(|k| (true, k)).collect();
    let (mut next_in, mut next_out) = (always.len(), 0);
    for part in &mut parts {
        let in_model = part.candidate.in_model;
        let next = if in_model { &mut next_in } else { &mut next_out };
        for column in part.candidate.variants.iter_mut().flat_map(|own| &mut own.columns) {
            column.at = order.len();
            order.push((in_model, *next));
            *next += 1;
        }
    }
    let mut candidates: Vec<Candidate> = parts.into_iter().map(|part| part.candidate).collect();
    exclusions(&mut candidates, training.input);
    let columns = base.into_iter().zip(others).zip(runs).map(|((mut base, mut others), run)| {
        let take = |(inside, k): &(bool, usize)| {
            let from = if *inside { &mut base } else { &mut others };
            std::mem::take(&mut from.columns[*k])
        };
        Whitened::new(order.iter().map(take).collect(), run.rows())
    });
    let columns: Vec<Whitened> = columns.collect();
    let mut linear = assemble(nuisances, candidates, runs, columns);
    events::pair(&mut linear, runs);
    Some(linear)
}

/// Columns with the numbers of their sources.
type Numbered = Vec<(usize, Vec<f32>)>;

/// Columns of the runs, each from these sources.
pub(super) fn columns_of(sources: &[&Source], runs: &[LinearisedRun<'_>]) -> Vec<Whitened> {
    enum Work<'a> {
        Difference(usize, &'a Model, f64),
        Tangents(Vec<(usize, &'a Tangent)>),
    }
    let empty = |run: &LinearisedRun<'_>| Whitened::new(vec![vec![]; sources.len()], run.rows());
    let mut out: Vec<Whitened> = runs.iter().map(empty).collect();
    // Simulations first: they take longest, and what is short then fills the gaps.
    let mut works = Vec::new();
    for number in 0..runs.len() {
        for (k, source) in sources.iter().enumerate() {
            match source {
                Source::Difference { model, step } => {
                    works.push((number, Work::Difference(k, model, *step)));
                }
                Source::Known(column) if number == 0 => out[0].columns[k].clone_from(column),
                _ => {}
            }
        }
    }
    for number in 0..runs.len() {
        let tangents: Vec<(usize, &Tangent)> = (sources.iter().enumerate())
            .filter_map(|(k, source)| Some((k, source.tangent(number)?)))
            .collect();
        let chunks = tangents.chunks(LANES);
        works.extend(chunks.map(|some| (number, Work::Tangents(some.to_vec()))));
    }
    let done = |(number, work): (usize, Work<'_>)| -> (usize, Numbered) {
        let run = &runs[number];
        let columns = match work {
            Work::Difference(k, model, step) => {
                vec![(k, run.difference(model, run.scenario, step))]
            }
            Work::Tangents(some) => {
                // All of them cost as much as 10 exact sub-steps an interval.
                run.count(10 * run.grid.motions.len() as u64);
                let (numbers, tangents): (Vec<usize>, Vec<&Tangent>) = some.into_iter().unzip();
                numbers.into_iter().zip(run.tangent_columns(&tangents)).collect()
            }
        };
        (number, columns)
    };
    let works = works.into_par_iter().with_max_len(1);
    let done: Vec<(usize, Numbered)> = works.map(done).collect();
    for (number, columns) in done {
        for (k, column) in columns {
            out[number].columns[k] = column;
        }
    }
    out
}

fn assemble(
    nuisances: Vec<f64>,
    candidates: Vec<Candidate>,
    runs: &[LinearisedRun<'_>],
    columns: Vec<Whitened>,
) -> Linear {
    let p = columns[0].columns.len();
    let mut products = DMatrix::zeros(p + 1, p + 1);
    for (run, columns) in runs.iter().zip(&columns) {
        products += columns.gram(&run.filtered.white);
    }
    let gram = products.view((0, 0), (p, p)).into_owned();
    let mut right: DVector<f64> = products.view((0, p), (p, 1)).column(0).into_owned();
    let mut squares = products[(p, p)];
    // Effects that are in the model are taken out linearly.
    let mut present = DVector::zeros(p);
    let variants = candidates.iter().flat_map(|candidate| &candidate.variants);
    for column in variants.flat_map(|variant| &variant.columns) {
        present[column.at] = column.present;
    }
    let shift = &gram * &present;
    squares += 2.0 * right.dot(&present) + present.dot(&shift);
    right += shift;
    let scales = runs[0].scenario.scales;
    Linear { nuisances, candidates, gram, right, squares, columns, present, scales }
}

/// Whether the effect is a torque with a state of its own.
fn depends_on_the_past(effect: &dyn Effect) -> bool {
    let guesses: Vec<f64> = effect.parameters().iter().map(ParameterSpec::guess).collect();
    effect.card().enters == Enters::Torque && effect.terms(&guesses).states() > 0
}

/// Candidates that exclude each other: alternatives of one family, and under a voltage an unknown curve and an effect over the
/// same axis. A torque's own curve is what a run is made of: there what is unknown stands beside the effects, not for them.
fn exclusions(candidates: &mut [Candidate], input: Input) {
    let curve = |c: &Candidate| match c.id {
        "torque over speed" => Some((Balance::Torque, Some(Axis::Speed))),
        "torque over angle" => Some((Balance::Torque, Some(Axis::Angle))),
        "torque over past speed" => Some((Balance::Torque, None)),
        "voltage over current" => Some((Balance::Voltage, Some(Axis::Current))),
        _ => c.effect.and_then(|effect| {
            let own = effect.card().curve.map(|(balance, axis)| (balance, Some(axis)));
            own.or_else(|| depends_on_the_past(effect).then_some((Balance::Torque, None)))
        }),
    };
    let names = |a: &Candidate, b: &Candidate| {
        a.effect.map(Effect::card).is_some_and(|card| {
            let mut others = card.alternatives.iter().chain(card.excludes);
            others.any(|id| *id == b.id)
        })
    };
    let is_same = |a: &Candidate, b: &Candidate| {
        names(a, b)
            || names(b, a)
            || (input == Input::Voltage
                && a.is_unknown() != b.is_unknown()
                && curve(a).is_some()
                && curve(a) == curve(b))
    };
    for k in 0..candidates.len() {
        let others = (0..candidates.len()).filter(|other| *other != k);
        let excludes = others.filter(|other| is_same(&candidates[k], &candidates[*other]));
        candidates[k].excludes = excludes.collect();
    }
}

//! Columns of the regression on which effects are selected: what each at its slab size would add to the whitened innovations of a
//! linearised run.

use std::borrow::Cow;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::acting::constants;
use super::eligible::{resolves_wave, why_not};
use super::events::{self, Hypothesis};
use super::follow::{Dynamics, Followed, Follower, Noise, Passage, follow, lead};
use super::forms::{drop_refuted, keep_likeliest};
use super::nuisances::{bends, nuisances, unknown_curves};
use super::tangent::{self, LANES, Step, Tangent, carry};
use super::whitened::Whitened;
use crate::work::Work;
use drivebench_model::plant::effect::Axis;
use drivebench_model::plant::{
    ActiveEffect, Balance, Effect, Input, Instant, Model, ParameterRole, ParameterSpec, Scenario,
    ShaftAngle, State, typical_size,
};

/// The plausible size of an effect before any data, in typical sizes (three per cent of the largest torque or voltage).
pub(super) const SLAB: f64 = 2.0;

/// Mean square of the innovations above which a linear solution is not believed, and refutes nothing.
pub(super) const FAR_MEAN_SQUARE: f64 = 3.0;

/// One column of a form.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Column {
    /// Its number among all columns.
    pub at: usize,
    /// The parameter that it is of; none of what only bends the form.
    pub parameter: Option<usize>,
    /// Size of its unit, in the unit of its parameter.
    pub unit: f64,
    /// Where the model has the effect already: the coordinate that it has there.
    pub present: f64,
    /// Of an event the run and when it happens there, s after the run's first command.
    pub moment: Option<(usize, f64)>,
}

impl Column {
    pub(super) fn of(parameter: Option<usize>, unit: f64, present: f64) -> Self {
        Self {
            parameter,
            unit,
            present,
            ..Self::default()
        }
    }
}

/// One form of an effect.
#[derive(Clone, Debug, Default)]
pub(super) struct Variant {
    pub columns: Vec<Column>,
    /// Values of all parameters, coefficients at the slab.
    pub values: Vec<f64>,
    /// Whether it is at the moment of another event of the model: only there can the two be told apart, or not.
    pub is_rival: bool,
    /// Of what is there wholly or not at all the prior mean of its first column, in its unit; else zero.
    pub mean: f64,
    pub positive: bool,
    pub log_prior: f64,
}

impl Variant {
    /// The numbers of its columns.
    pub(super) fn numbers(&self) -> impl Iterator<Item = usize> + '_ {
        self.columns.iter().map(|column| column.at)
    }

    /// Of an event the runs in which it happens, each with its moment.
    pub(super) fn moments(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.columns.iter().filter_map(|column| column.moment)
    }
}

/// Fisher information of one column beside others and its score, the gradient of the log likelihood at zero, both in slabs.
#[derive(Clone, Copy, Debug)]
pub(super) struct ColumnInformation {
    pub information: f64,
    pub score: f64,
    /// The slab, in the unit of its parameter.
    pub unit: f64,
}

#[derive(Clone, Default)]
pub(super) struct Candidate {
    pub id: &'static str,
    /// None: a curve that is no effect.
    pub effect: Option<&'static dyn Effect>,
    pub in_model: bool,
    pub log_odds: f64,
    pub variants: Vec<Variant>,
    /// Of an event of which few forms have columns what all its moments say beside the model.
    pub moments: Vec<ColumnInformation>,
    /// Candidates that say the same and are out where this one is in.
    pub excludes: Vec<usize>,
}

impl Candidate {
    /// Whether it is there wholly or not at all, as a shaft's elasticity: its shape is all that there is.
    pub(super) fn is_whole(&self) -> bool {
        self.variants[0].mean > 0.0
    }

    /// Whether `size` of a form that is there wholly or not at all would be another share of it: the linear solution does
    /// not hold there. What the model has already was fitted: there its shapes ask for another fit, not for none of it.
    pub(super) fn exceeds_linear_range(&self, size: f64, form: &Variant) -> bool {
        !self.in_model && form.mean > 0.0 && (size / form.mean - 1.0).abs() > 0.5
    }

    /// Whether it happens once, in each run at a moment of its own.
    pub(super) fn is_event(&self) -> bool {
        self.variants[0].moments().next().is_some()
    }

    /// Whether its steps, at all moments, stand for the disturbance.
    pub(super) fn is_disturbance_step(&self) -> bool {
        self.effect
            .is_some_and(|effect| effect.card().is_disturbance_step)
    }

    /// Whether it is a curve that no effect gives.
    pub(super) fn is_unknown(&self) -> bool {
        self.effect.is_none()
    }
}

/// The linear problem of one or several runs.
#[derive(Clone)]
pub(super) struct Linear {
    /// Standard deviations beforehand of what is always in: the motor's parameters and the stamps' errors.
    pub nuisances: Vec<f64>,
    pub candidates: Vec<Candidate>,
    pub gram: DMatrix<f64>,
    pub right: DVector<f64>,
    pub squares: f64,
    /// Whitened columns of each run.
    pub columns: Vec<Whitened>,
    pub present: DVector<f64>,
}

impl Linear {
    /// Precision beforehand of a column.
    pub(super) fn precision(&self, column: usize) -> f64 {
        let sd = self.nuisances.get(column);
        sd.map_or(1.0, |sd| 1.0 / (sd * sd))
    }

    /// The normal matrix of some columns with their precision beforehand, factored; none where it is singular.
    pub(super) fn factor(&self, columns: &[usize]) -> Option<Cholesky<f64, Dyn>> {
        let k = columns.len();
        let mut normal = DMatrix::from_fn(k, k, |r, c| self.gram[(columns[r], columns[c])]);
        for (d, column) in columns.iter().enumerate() {
            normal[(d, d)] += self.precision(*column);
        }
        normal.cholesky()
    }
}

/// How a column comes about.
pub(super) enum Source {
    /// The difference that another model makes, over a step.
    Difference {
        model: Model,
        step: f64,
    },
    Tangent(Tangent),
    /// Likewise, in one of the runs only.
    In(usize, Tangent),
    /// Known at the beginning of the first run already, and of no interest beyond.
    Known(Vec<f32>),
}

impl Source {
    /// Its tangent in the run of this number, if it has one there.
    pub(super) const fn tangent(&self, number: usize) -> Option<&Tangent> {
        match self {
            Self::Tangent(tangent) => Some(tangent),
            Self::In(run, tangent) if *run == number => Some(tangent),
            _ => None,
        }
    }
}

/// One run linearised along the filter: everything of it that columns need.
pub(super) struct LinearisedRun<'a> {
    pub model: Model,
    /// What of the model happens in this run alone.
    pub(super) events: Vec<ActiveEffect>,
    pub scenario: &'a Scenario,
    pub start: State,
    pub noise: Noise,
    pub follower: Follower,
    pub followed: Followed,
    pub dynamics: Dynamics,
    /// The middle of the interval before each sample.
    pub(super) instants: Vec<Instant>,
    /// How deviations pass the interval.
    pub(super) steps: Vec<Step>,
    /// Where simulations of it are counted.
    pub(super) work: Option<&'a Work>,
}

impl<'a> LinearisedRun<'a> {
    pub(super) fn new(
        model: &Model,
        scenario: &'a Scenario,
        start: State,
        noise: Noise,
    ) -> Option<Self> {
        Self::beside(model, vec![], scenario, start, noise)
    }

    /// With its simulations counted.
    #[must_use]
    pub(super) const fn counted(mut self, work: Option<&'a Work>) -> Self {
        self.work = work;
        self
    }

    /// Counts sub-steps that were simulated of it.
    pub(super) fn count(&self, steps: u64) {
        if let Some(work) = self.work {
            work.add(steps);
        }
    }

    /// With events that other runs do not have.
    pub(super) fn beside(
        model: &Model,
        events: Vec<ActiveEffect>,
        scenario: &'a Scenario,
        start: State,
        noise: Noise,
    ) -> Option<Self> {
        let model = with_events(model, &events);
        let (follower, followed) = lead(&model, scenario, start, &noise)?;
        let mut white = followed.white.iter().flatten();
        if !white.all(|white| white.is_finite()) {
            return None;
        }
        let dynamics = Dynamics::of(&model, scenario.input)?;
        let instants = instants(&model, scenario, &followed);
        let step = |(passage, forget): (&Passage, &f64)| {
            if passage.interval_s > 0.0 {
                Step::of(passage, *forget, &dynamics)
            } else {
                Step::still()
            }
        };
        let passages = follower.passages.iter().zip(&follower.forgets);
        let steps = passages.map(step).collect();
        Some(Self {
            model: model.into_owned(),
            events,
            scenario,
            start,
            noise,
            follower,
            followed,
            dynamics,
            instants,
            steps,
            work: None,
        })
    }

    /// What another model, beside the run's own events, does to the whitened innovations, over `step`, in the whole run or
    /// the beginning of it that `scenario` is; nothing where it cannot follow.
    pub(super) fn difference(&self, model: &Model, scenario: &Scenario, step: f64) -> Vec<f32> {
        let model = with_events(model, &self.events);
        let mut out = Vec::with_capacity(scenario.samples());
        let steps = follow(
            &self.follower,
            &model,
            scenario,
            self.start,
            &self.noise,
            &mut out,
        );
        let Some(steps) = steps else {
            return vec![0.0; 2 * scenario.samples()];
        };
        self.count(steps);
        let over = 1.0 / step;
        let pairs = out.iter().zip(&self.followed.white);
        let change = |(a, b): (&[f64; 2], &[f64; 2])| [0, 1].map(|k| single((b[k] - a[k]) * over));
        bounded(pairs.flat_map(change).collect())
    }

    /// Columns of as many tangents as there are lanes, or fewer.
    fn along(&self, tangents: &[&Tangent]) -> Vec<Vec<f32>> {
        let mut columns = vec![Vec::with_capacity(self.rows()); tangents.len()];
        carry(self, tangents, |first, white| {
            for (lane, column) in columns.iter_mut().enumerate() {
                column.resize(2 * first, 0.0);
                column.extend(white.iter().map(|row| single(row[lane])));
            }
        });
        columns.into_iter().map(bounded).collect()
    }

    /// Two for each sample, whether measured or not.
    pub(super) fn rows(&self) -> usize {
        2 * self.scenario.samples()
    }
}

/// Standard deviations of an innovation beyond which no column goes: the motor's own parameters reach a millionth of it.
const MOST_DEVIATIONS: f32 = 1e12;

/// A column, or nothing in its place where it grows without bound along the run, as the ringing of a stiff shaft in a form that
/// the run is far from: no linear effect stands for that, and one such number spoils every solution.
fn bounded(column: Vec<f32>) -> Vec<f32> {
    if column.iter().all(|cell| cell.abs() < MOST_DEVIATIONS) {
        column
    } else {
        vec![0.0; column.len()]
    }
}

/// Sum of the squares of the innovations.
pub(super) fn squares(runs: &[LinearisedRun<'_>]) -> f64 {
    let white = runs.iter().flat_map(|run| run.followed.white.iter());
    white.flatten().map(|value| value * value).sum()
}

fn with_events<'a>(model: &'a Model, events: &[ActiveEffect]) -> Cow<'a, Model> {
    if events.is_empty() {
        return Cow::Borrowed(model);
    }
    let mut model = model.clone();
    model.effects.extend_from_slice(events);
    Cow::Owned(model)
}

#[expect(clippy::cast_possible_truncation, reason = "stored like this")]
const fn single(value: f64) -> f32 {
    value as f32
}

fn instants(model: &Model, scenario: &Scenario, followed: &Followed) -> Vec<Instant> {
    let angles = scenario.shaft_angle();
    let mut angle = 0;
    let mut event = 0;
    let motor = constants(model, scenario);
    let instant = |sample: usize| {
        let from = sample.saturating_sub(1);
        let mid_s = 0.5 * (scenario.sample_time_s[from] + scenario.sample_time_s[sample]);
        while angle < angles.len() && angles[angle].0 <= mid_s {
            angle += 1;
        }
        let angle_rad = match (angle.checked_sub(1), angles.get(angle)) {
            (Some(before), Some(after)) => {
                let before = angles[before];
                before.1 + (mid_s - before.0) / (after.0 - before.0) * (after.1 - before.1)
            }
            (Some(before), None) => angles[before].1,
            (None, after) => after.map_or(0.0, |after| after.1),
        };
        while event + 1 < scenario.events.len() && scenario.events[event + 1].0 <= mid_s {
            event += 1;
        }
        let mean = |k: usize| 0.5 * (followed.after[from][k] + followed.before[sample][k]);
        let input = scenario.events[event].1;
        let by_voltage = scenario.input == Input::Voltage;
        Instant {
            time_s: mid_s - scenario.begin_s(),
            voltage_v: input,
            current_a: if by_voltage { mean(0) } else { input },
            speed_rad_s: mean(1),
            angle: ShaftAngle::at(angle_rad),
            ..motor
        }
    };
    (0..scenario.samples()).map(instant).collect()
}

/// Standard deviation of how much of an effect is there that is there wholly or not at all, for the form that was tried.
const WHOLE: f64 = 0.15;

/// A candidate whose columns have no numbers yet.
pub(super) struct Part {
    pub(super) candidate: Candidate,
    /// Where the columns of each variant come from.
    pub(super) sources: Vec<Vec<Source>>,
}

impl Part {
    pub(super) fn new(effect: &'static dyn Effect) -> Self {
        let share = effect.card().share_beforehand;
        Self::named(effect.card().id, Some(effect), (share / (1.0 - share)).ln())
    }

    pub(super) fn named(
        id: &'static str,
        effect: Option<&'static dyn Effect>,
        log_odds: f64,
    ) -> Self {
        let candidate = Candidate {
            id,
            effect,
            log_odds,
            ..Candidate::default()
        };
        Self {
            candidate,
            sources: vec![],
        }
    }

    pub(super) fn push(&mut self, form: Form) {
        self.candidate.variants.push(form.variant);
        self.sources.push(form.sources);
    }
}

/// A variant under construction.
pub(super) struct Form {
    pub(super) variant: Variant,
    sources: Vec<Source>,
}

impl Form {
    pub(super) fn new(values: Vec<f64>, log_prior: f64) -> Self {
        let variant = Variant {
            values,
            log_prior,
            ..Variant::default()
        };
        Self {
            variant,
            sources: vec![],
        }
    }

    /// Of an effect whose shape is all that there is: what the model with it, or without it, does in whole.
    fn whole(&mut self, model: Model, sign: f64, present: f64) {
        let step = sign / WHOLE;
        self.variant.mean = 1.0 / WHOLE;
        let source = Source::Difference { model, step };
        self.column(source, Column::of(None, 0.0, present));
    }

    /// One column more, numbered when all are known.
    pub(super) fn column(&mut self, source: Source, column: Column) {
        self.sources.push(source);
        self.variant.columns.push(column);
    }
}

/// An effect of the model: its parameters, and what else its form may be.
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
        form.whole(model.without_effect(id).ok()?, -1.0, 1.0 / WHOLE);
    }
    for (index, spec) in specs.iter().enumerate() {
        if spec.role == ParameterRole::Choice {
            continue;
        }
        let (unit, present, step) = if spec.is_coefficient() {
            let unit = SLAB * typical_size(effect, index, model, scenario);
            (unit, values[index] / unit, 0.02 * unit)
        } else {
            // A shape's logarithm, known to a factor of two beforehand.
            let logarithm = 0.7 * values[index];
            let unit = if spec.logarithmic {
                logarithm
            } else {
                spec.scale
            };
            (unit, 0.0, 0.01 * unit)
        };
        let takes_power = spec.min >= 0.0 || effect.card().takes_power;
        form.variant.positive |= spec.is_coefficient() && takes_power;
        let change = (step, step / unit);
        let tangent = along.then(|| tangent::of_effect(effect, &values, index, unit, change));
        let source = tangent.flatten().map_or_else(
            || {
                let mut moved = model.clone();
                let mut there = values.clone();
                there[index] += step;
                let own = moved.effects.iter_mut().filter(|other| other.id() == id);
                own.for_each(|own| *own = ActiveEffect::with(effect, &there));
                Source::Difference {
                    model: moved,
                    step: step / unit,
                }
            },
            Source::Tangent,
        );
        form.column(source, Column::of(Some(index), unit, present));
    }
    for source in bends(model, effect, &values, scenario) {
        form.column(source, Column::default());
    }
    part.push(form);
    Some(part)
}

/// An effect that the model lacks, in each form of its grid.
fn beside_model(model: &Model, effect: &'static dyn Effect, scenario: &Scenario) -> Part {
    let specs = effect.parameters();
    let mut part = Part::new(effect);
    let coefficients = (0..specs.len()).filter(|k| specs[*k].is_coefficient());
    let coefficients: Vec<usize> = coefficients.collect();
    let slab = |k: &usize| SLAB * typical_size(effect, *k, model, scenario);
    let slabs: Vec<f64> = coefficients.iter().map(slab).collect();
    let order = specs.iter().position(|spec| spec.key == "order");
    let grid = shape_grid(effect, scenario);
    let log_prior = -(grid.len() as f64).ln();
    for shape in grid {
        let mut limit = effect.card().limit.iter();
        if limit.any(|limit| shape[limit.parameter] < limit.least) {
            continue;
        }
        let periods = order.map_or(1.0, |order| shape[order]);
        if effect.card().needs_angle && !resolves_wave(effect, scenario, periods) {
            continue;
        }
        let mut form = Form::new(shape.clone(), log_prior);
        if coefficients.is_empty() {
            let mut with = model.clone();
            with.effects.push(ActiveEffect::with(effect, &shape));
            form.whole(with, 1.0, 0.0);
        }
        for (index, slab) in coefficients.iter().zip(&slabs) {
            let mut values = shape.clone();
            for other in &coefficients {
                values[*other] = 0.0;
            }
            values[*index] = *slab;
            form.variant.values[*index] = *slab;
            form.variant.positive |= specs[*index].min >= 0.0 || effect.card().takes_power;
            let source = alone(model, effect, &values, *index);
            form.column(source, Column::of(Some(*index), *slab, 0.0));
        }
        part.push(form);
    }
    part
}

/// Every combination of the grids of an effect's shapes, choices and event times; its coefficients at zero.
fn shape_grid(effect: &dyn Effect, training: &Scenario) -> Vec<Vec<f64>> {
    let specs = effect.parameters();
    let length_s = training.sample_time_s[training.samples() - 1] - training.begin_s();
    let mut grid = vec![vec![0.0; specs.len()]];
    for (index, spec) in specs.iter().enumerate() {
        if spec.is_coefficient() {
            continue;
        }
        let unit = if spec.role == ParameterRole::EventTime {
            length_s
        } else {
            1.0
        };
        let with = |values: &Vec<f64>, shape: f64| {
            let mut values = values.clone();
            values[index] = shape * unit;
            values
        };
        let shapes = |values| spec.shapes.iter().map(move |shape| with(values, *shape));
        grid = grid.iter().flat_map(shapes).collect();
    }
    grid
}

/// What one coefficient of an effect adds, all others at zero.
fn alone(model: &Model, effect: &'static dyn Effect, values: &[f64], index: usize) -> Source {
    const PROBE: f64 = 0.25;
    if let Some(tangent) = tangent::alone_at(effect, values, index) {
        return Source::Tangent(tangent);
    }
    let mut with = model.clone();
    let mut values = values.to_vec();
    values[index] *= PROBE;
    with.effects.push(ActiveEffect::with(effect, &values));
    Source::Difference {
        model: with,
        step: PROBE,
    }
}

/// Where the columns of what the model has come from, or of what it lacks.
fn sources_of(parts: &[Part], in_model: bool) -> impl Iterator<Item = &Source> {
    let own = parts
        .iter()
        .filter(move |part| part.candidate.in_model == in_model);
    own.flat_map(|part| part.sources.iter().flatten())
}

/// The linear problem of `runs` around one model and what happens in each. Every run must be followed with that.
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
            Some(vec![beside_model(model, *effect, training)])
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

    // What the model has comes first: it tells which of many forms are worth a place among the columns.
    let inside: Vec<&Source> = always.iter().chain(sources_of(&parts, true)).collect();
    let base = columns_of(&inside, runs);
    let precision = |k| nuisances.get(k).map_or(1.0, |sd: &f64| 1.0 / (sd * sd));
    let precision: Vec<f64> = (0..base[0].columns.len()).map(precision).collect();
    keep_likeliest(&mut parts, runs, &base, &precision);
    drop_refuted(&mut parts, &runs[0], &base[0], &precision);
    let others = columns_of(&sources_of(&parts, false).collect::<Vec<_>>(), runs);

    // Numbered in the candidates' order.
    let mut order: Vec<(bool, usize)> = (0..always.len()).map(|k| (true, k)).collect();
    let (mut next_in, mut next_out) = (always.len(), 0);
    for part in &mut parts {
        let next = if part.candidate.in_model {
            &mut next_in
        } else {
            &mut next_out
        };
        for (variant, sources) in part.candidate.variants.iter_mut().zip(&part.sources) {
            for (column, at) in variant.columns.iter_mut().zip(order.len()..) {
                column.at = at;
            }
            order.extend((*next..*next + sources.len()).map(|k| (part.candidate.in_model, k)));
            *next += sources.len();
        }
    }
    let mut candidates: Vec<Candidate> = parts.into_iter().map(|part| part.candidate).collect();
    exclusions(&mut candidates, training.input);
    let columns = base.into_iter().zip(others).zip(runs);
    let columns = columns.map(|((mut base, mut others), run)| {
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

/// Cost of carrying some tangents over a sample, in exact sub-steps.
const TANGENTS_COST: u64 = 10;

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
        let tangents = sources.iter().enumerate();
        let tangents = tangents.filter_map(|(k, source)| Some((k, source.tangent(number)?)));
        let tangents: Vec<(usize, &Tangent)> = tangents.collect();
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
                run.count(TANGENTS_COST * run.scenario.samples() as u64);
                let (numbers, tangents): (Vec<usize>, Vec<&Tangent>) = some.into_iter().unzip();
                numbers.into_iter().zip(run.along(&tangents)).collect()
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
        products += columns.gram(&run.followed.white);
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
    Linear {
        nuisances,
        candidates,
        gram,
        right,
        squares,
        columns,
        present,
    }
}

/// A torque's own curve is what a run is made of: there what is unknown stands beside the effects, not for them.
fn exclusions(candidates: &mut [Candidate], input: Input) {
    let curve = |c: &Candidate| match c.id {
        "torque over speed" => Some((Balance::Torque, Axis::Speed)),
        "torque over angle" => Some((Balance::Torque, Axis::Angle)),
        "voltage over current" => Some((Balance::Voltage, Axis::Current)),
        _ => c.effect.and_then(|effect| effect.card().curve),
    };
    // A model with one effect of a family does not get the other too.
    let names = |a: &Candidate, b: &Candidate| {
        let card = a.effect.map(Effect::card);
        card.is_some_and(|card| {
            let mut others = card.alternatives.iter().chain(card.excludes);
            others.any(|id| *id == b.id)
        })
    };
    let says_the_same = |a: &Candidate, b: &Candidate| {
        names(a, b)
            || names(b, a)
            || (input == Input::Voltage
                && a.is_unknown() != b.is_unknown()
                && curve(a).is_some()
                && curve(a) == curve(b))
    };
    for k in 0..candidates.len() {
        let own = &candidates[k];
        let others = (0..candidates.len()).filter(|other| *other != k);
        let excludes = others.filter(|other| says_the_same(own, &candidates[*other]));
        candidates[k].excludes = excludes.collect();
    }
}

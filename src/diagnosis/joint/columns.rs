//! What each effect at its slab size would add to the whitened innovations of a followed run.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::follow::{Deviation, Followed, Follower, Noise, follow, lead, Dynamics};
use crate::diagnosis::family::{curve_of, related, takes_power};
use crate::diagnosis::shapes::shape_grid;
use crate::plant::effect::CATALOGUE;
use crate::plant::{
    ActiveEffect, Input, Instant, Model, MotorKey, ParameterRole, Scenario, Slot, State,
    Terms, typical_size,
};

/// The plausible size of an effect before any data, in typical sizes (three per cent of the largest torque or voltage).
pub const SLAB: f64 = 2.0;

/// One form of an effect.
#[derive(Clone, Debug)]
pub struct Variant {
    pub columns: Vec<usize>,
    /// Values of all parameters, coefficients at the slab.
    pub values: Vec<f64>,
    /// Size of each column's unit, in the unit of its parameter.
    pub units: Vec<f64>,
    pub parameters: Vec<usize>,
    /// Where the model has the effect already: the coordinates that it has there.
    pub present: Vec<f64>,
    /// Of what is there wholly or not at all the prior mean of its first column, in its unit; else zero.
    pub mean: f64,
    pub positive: bool,
    pub log_prior: f64,
}

#[derive(Clone, Debug)]
pub struct Candidate {
    pub id: &'static str,
    pub in_model: bool,
    pub unknown: bool,
    pub log_odds: f64,
    pub variants: Vec<Variant>,
    /// Candidates that say the same and are out where this one is in.
    pub excludes: Vec<usize>,
}

impl Candidate {
    /// Whether it is there wholly or not at all, as a shaft's elasticity: its shape is all that there is.
    pub fn is_whole(&self) -> bool {
        self.variants[0].mean > 0.0
    }
}

/// The linear problem of one or several runs.
#[derive(Clone, Debug)]
pub struct Linear {
    /// Standard deviations beforehand of what is always in: the motor's parameters and the stamps' errors.
    pub nuisances: Vec<f64>,
    pub candidates: Vec<Candidate>,
    pub gram: DMatrix<f64>,
    pub right: DVector<f64>,
    pub squares: f64,
    pub rows: usize,
    pub log_variance: f64,
    /// Whitened columns of each run.
    pub columns: Vec<DMatrix<f64>>,
    pub present: DVector<f64>,
}

enum Source {
    Fd(Model, f64),
    Terms { terms: Box<dyn Terms>, scale: f64 },
    /// Another form of a term: itself times a power of its own size (1, 2), its square (3), or late (0).
    Form { terms: Box<dyn Terms>, power: i32 },
    /// Torque against positive motion, and voltage drop, at each interval.
    Curve(Curve),
    /// In one of the runs only.
    In(usize, Box<Source>),
}

#[derive(Clone, Copy)]
enum Curve {
    TorqueOverSpeed { centre: f64, width: f64, size: f64 },
    TorqueOverAngle { order: f64, sine: bool, size: f64 },
    VoltageOverCurrent { centre: f64, width: f64, size: f64 },
}

impl Curve {
    fn at(self, at: &Instant) -> [f64; 2] {
        let hat = |x: f64, centre: f64, width: f64| (1.0 - ((x - centre) / width).abs()).max(0.0);
        match self {
            Self::TorqueOverSpeed { centre, width, size } => [0.0, size * hat(at.speed_rad_s, centre, width)],
            Self::TorqueOverAngle { order, sine, size } => {
                let (s, c) = (order * at.angle_rad).sin_cos();
                [0.0, size * if sine { s } else { c }]
            }
            Self::VoltageOverCurrent { centre, width, size } => [size * hat(at.current_a, centre, width), 0.0],
        }
    }
}

/// Everything of one run that columns need.
pub struct Around<'a> {
    pub model: &'a Model,
    pub scenario: &'a Scenario,
    pub start: State,
    pub noise: Noise,
    pub follower: Follower,
    pub followed: Followed,
    pub dynamics: Dynamics,
    instants: Vec<Instant>,
}

impl<'a> Around<'a> {
    pub fn new(model: &'a Model, scenario: &'a Scenario, start: State, noise: Noise) -> Option<Self> {
        let (follower, followed) = lead(model, scenario, start, &noise)?;
        let dynamics = Dynamics::of(model, scenario.input)?;
        let instants = instants(model, scenario, &followed);
        Some(Self { model, scenario, start, noise, follower, followed, dynamics, instants })
    }

    fn difference(&self, model: &Model, step: f64) -> Option<Vec<f64>> {
        let mut out = Vec::with_capacity(self.scenario.samples());
        if !follow(&self.follower, model, self.scenario, self.start, &self.noise, &mut out) {
            return None;
        }
        Some(
            out.iter()
                .zip(&self.followed.white)
                .flat_map(|(a, b)| [(b[0] - a[0]) / step, (b[1] - a[1]) / step])
                .collect(),
        )
    }

    fn along(&self, mut forcing: impl FnMut(usize, &Instant, f64) -> [f64; 2]) -> Vec<f64> {
        let n = self.scenario.samples();
        let mut out = Vec::with_capacity(2 * n);
        let mut deviation = Deviation::default();
        for sample in 0..n {
            let passage = &self.follower.passages[sample];
            if passage.interval_s > 0.0 {
                let forcing = forcing(sample, &self.instants[sample], passage.direction);
                deviation.pass(passage, forcing, self.follower.forgets[sample], &self.dynamics);
            }
            let white = deviation.correct(&self.follower.updates[sample], [0.0; 2]);
            out.extend(white);
        }
        out
    }

    fn column(&self, source: &Source, number: usize) -> Option<Vec<f64>> {
        let (inductance, inertia) = (self.dynamics.inverse_inductance, self.dynamics.inverse_inertia);
        Some(match source {
            Source::Fd(model, step) => self.difference(model, *step)?,
            Source::Terms { terms, scale } => {
                let mut own = vec![0.0; terms.states()];
                let mut rate = own.clone();
                let motor = &self.model.motor;
                let (r, ke) = (motor.get(MotorKey::Resistance).unwrap_or(0.0), motor.get(MotorKey::BackEmf).unwrap_or(0.0));
                self.along(|sample, at, direction| {
                    let sums = terms.sums(at, &own);
                    if !own.is_empty() {
                        terms.derivative(at, &own, &mut rate);
                        let h = self.follower.passages[sample].interval_s;
                        for (own, rate) in own.iter_mut().zip(&rate) {
                            *own += h * rate;
                        }
                    }
                    let inductive = at.voltage_v - r * at.current_a - ke * at.speed_rad_s;
                    [
                        (-sums.voltage_v + sums.current_rate_gain * inductive) * inductance * scale,
                        -(sums.torque_n_m + direction * sums.friction_n_m) * inertia * scale,
                    ]
                })
            }
            Source::Form { terms, power } => {
                let mut most = [0.0_f64; 3];
                for at in &self.instants {
                    let sums = terms.sums(at, &[]);
                    for (most, value) in most.iter_mut().zip([sums.voltage_v, sums.torque_n_m, sums.friction_n_m]) {
                        *most = most.max(value.abs());
                    }
                }
                let bent = |value: f64, most: f64| {
                    if most <= 0.0 { return 0.0; }
                    FORM * value * (value / most).abs().powi(*power)
                };
                self.along(|_, at, direction| {
                    let sums = terms.sums(at, &[]);
                    [
                        -bent(sums.voltage_v, most[0]) * inductance,
                        -(bent(sums.torque_n_m, most[1]) + direction * bent(sums.friction_n_m, most[2])) * inertia,
                    ]
                })
            }
            Source::In(run, source) => {
                if *run == number { self.column(source, number)? } else { vec![0.0; 2 * self.scenario.samples()] }
            }
            Source::Curve(curve) => self.along(|_, at, _| {
                let [v, t] = curve.at(at);
                [-v * inductance, -t * inertia]
            }),
        })
    }
}

fn instants(model: &Model, scenario: &Scenario, followed: &Followed) -> Vec<Instant> {
    let angles = scenario.shaft_angle();
    let mut angle = 0;
    let mut event = 0;
    let supply_v = scenario.supply_v();
    let motor = Instant::of(&model.motor);
    (0..scenario.samples())
        .map(|sample| {
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
            Instant {
                time_s: mid_s - scenario.begin_s(),
                voltage_v: scenario.events[event].1,
                supply_v,
                current_a: mean(0),
                speed_rad_s: mean(1),
                angle_rad,
                ..motor
            }
        })
        .collect()
}

/// Prior standard deviation of the logarithm of a motor's parameter.
const MOTOR: f64 = 0.3;
/// Error of the stamps of commands and samples beforehand, as a share of the period.
const STAMP: f64 = 0.05;
/// Standard deviation of how much of an effect is there that is there wholly or not at all, for the form that was tried.
const WHOLE: f64 = 0.15;
/// What the form of an effect may differ from its equation by.
const FORM: f64 = 0.1;

/// What the stamps of command, current and speed may be wrong by, for all samples alike.
fn timing(model: &Model, scenario: &Scenario, sources: &mut Vec<Source>, nuisances: &mut Vec<f64>) {
    if scenario.input != Input::Voltage {
        return;
    }
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    for id in ["command_delay", "current_filter", "speed_delay"] {
        let Some(effect) = crate::plant::effect::find(id) else { continue };
        let mut moved = model.clone();
        match moved.effects.iter_mut().find(|active| active.id() == id) {
            Some(active) => {
                let now = active.values_or_guess()[0];
                active.values = vec![Some(now + STAMP * period_s)];
            }
            None => moved.effects.push(ActiveEffect { effect, values: vec![Some(STAMP * period_s)] }),
        }
        sources.push(Source::Fd(moved, 1.0));
        nuisances.push(1.0);
    }
}

/// Step of a difference of two runs with a motor's parameter, relative.
const STEP: f64 = 2e-3;

/// The linear problem of `runs` around one model. Every run must be followed with that same model.
pub fn linearise(model: &Model, runs: &[Around<'_>], unknowns: bool) -> Option<Linear> {
    let training = runs[0].scenario;
    let mut sources: Vec<Source> = Vec::new();
    let mut nuisances = Vec::new();
    for slot in model.free_slots() {
        if let Slot::Motor(key) = slot {
            let mut moved = model.clone();
            let value = model.get(&slot)?;
            moved.set(&slot, value * STEP.exp());
            sources.push(Source::Fd(moved, STEP));
            let _ = key;
            nuisances.push(MOTOR);
        }
    }
    timing(model, training, &mut sources, &mut nuisances);
    let mut candidates = Vec::new();
    for effect in CATALOGUE.iter().copied() {
        let id = effect.card().id;
        let specs = effect.parameters();
        let mut candidate = Candidate { id, in_model: model.has(id), unknown: false, log_odds: (0.1_f64 / 0.9).ln(), variants: vec![], excludes: vec![] };
        if candidate.in_model {
            let active = model.effects.iter().find(|a| a.id() == id)?;
            let values: Vec<f64> = active.values_or_guess();
            let mut variant = Variant { columns: vec![], values: values.clone(), units: vec![], parameters: vec![], present: vec![], mean: 0.0, positive: false, log_prior: 0.0 };
            if !specs.iter().any(|spec| spec.is_coefficient()) {
                let without = model.without_effect(id).ok()?;
                variant.columns.push(sources.len());
                variant.units.push(0.0);
                variant.parameters.push(usize::MAX);
                variant.present.push(1.0 / WHOLE);
                variant.mean = 1.0 / WHOLE;
                sources.push(Source::Fd(without, -1.0 / WHOLE));
            }
            for (index, spec) in specs.iter().enumerate() {
                if matches!(spec.role, ParameterRole::Choice | ParameterRole::EventTime) {
                    continue;
                }
                let (unit, present, step) = if spec.is_coefficient() {
                    let unit = SLAB * typical_size(effect, index, model, training);
                    (unit, values[index] / unit, 0.02 * unit)
                } else {
                    // A shape's logarithm, known to a factor of two beforehand.
                    let unit = if spec.logarithmic { 0.7 * values[index] } else { spec.scale };
                    (unit, 0.0, 0.01 * unit)
                };
                let mut moved = model.clone();
                let mut there = values.clone();
                there[index] += step;
                for a in &mut moved.effects {
                    if a.id() == id {
                        *a = ActiveEffect { effect, values: there.iter().copied().map(Some).collect() };
                    }
                }
                variant.columns.push(sources.len());
                variant.units.push(unit);
                variant.parameters.push(index);
                variant.present.push(present);
                variant.positive |= spec.is_coefficient() && (spec.min >= 0.0 || takes_power(id));
                sources.push(Source::Fd(moved, step / unit));
            }
            let terms = effect.terms(&values);
            let path = terms.path();
            if effect.card().needs_angle {
                let amplitude = specs.iter().zip(&values).filter(|(s, _)| s.is_coefficient()).map(|(_, v)| v * v).sum::<f64>().sqrt();
                let order = specs.iter().position(|s| s.key == "order").map_or(1.0, |k| values[k]);
                let gain = if id == "torque_ripple" { model.motor.torque_constant().unwrap_or(1.0) * 2.0 } else { 1.0 };
                for harmonic in [2.0, 3.0] {
                    for sine in [true, false] {
                        variant.columns.push(sources.len());
                        variant.units.push(0.0);
                        variant.parameters.push(usize::MAX);
                        variant.present.push(0.0);
                        sources.push(Source::Curve(Curve::TorqueOverAngle { order: harmonic * order, sine, size: FORM * amplitude * gain }));
                    }
                }
            } else if terms.states() == 0 && terms.coupling().is_none() && path.measures_directly() && !path.delays_command() {
                for power in [1, 2] {
                    variant.columns.push(sources.len());
                    variant.units.push(0.0);
                    variant.parameters.push(usize::MAX);
                    variant.present.push(0.0);
                    sources.push(Source::Form { terms: effect.terms(&values), power });
                }
            }
            candidate.variants.push(variant);
        } else {
            let grid = shape_grid(effect, training);
            let count = grid.len() as f64;
            for shape in grid {
                let ones: Vec<usize> = (0..specs.len()).filter(|k| specs[*k].is_coefficient()).collect();
                let mut variant = Variant { columns: vec![], values: shape.clone(), units: vec![], parameters: vec![], present: vec![], mean: 0.0, positive: false, log_prior: -count.ln() };
                if id == "discontinuous_conduction" && shape[1] < 0.9 {
                    continue;
                }
                if specs.iter().any(|s| s.role == ParameterRole::EventTime) {
                    continue;
                }
                if ones.is_empty() {
                    let mut with = model.clone();
                    with.effects.push(ActiveEffect { effect, values: shape.iter().copied().map(Some).collect() });
                    variant.columns.push(sources.len());
                    variant.units.push(0.0);
                    variant.parameters.push(usize::MAX);
                    variant.present.push(0.0);
                    variant.mean = 1.0 / WHOLE;
                    sources.push(Source::Fd(with, 1.0 / WHOLE));
                    candidate.variants.push(variant);
                    continue;
                }
                for &index in &ones {
                    let slab = SLAB * typical_size(effect, index, model, training);
                    let mut values = shape.clone();
                    for &other in &ones {
                        values[other] = 0.0;
                    }
                    values[index] = slab;
                    variant.values[index] = slab;
                    let terms = effect.terms(&values);
                    let path = terms.path();
                    let direct = path.measures_directly() && !path.delays_command();
                    variant.columns.push(sources.len());
                    variant.units.push(slab);
                    variant.parameters.push(index);
                    variant.present.push(0.0);
                    variant.positive |= specs[index].min >= 0.0 || takes_power(id);
                    if direct && terms.coupling().is_none() {
                        sources.push(Source::Terms { terms, scale: 1.0 });
                    } else {
                        let mut with = model.clone();
                        let probe = 0.25;
                        values[index] = slab * probe;
                        with.effects.push(ActiveEffect { effect, values: values.iter().copied().map(Some).collect() });
                        sources.push(Source::Fd(with, probe));
                    }
                }
                candidate.variants.push(variant);
            }
        }
        if !candidate.variants.is_empty() {
            candidates.push(candidate);
        }
    }
    if !model.has("load_step") {
        events(model, runs, &mut sources, &mut candidates);
    }
    if unknowns {
        unknown_curves(&mut sources, &mut candidates, runs);
    }
    exclusions(&mut candidates);
    let p = sources.len();
    let mut gram = DMatrix::zeros(p, p);
    let mut right = DVector::zeros(p);
    let (mut squares, mut rows, mut log_variance) = (0.0, 0, 0.0);
    let mut kept = Vec::new();
    for (number, run) in runs.iter().enumerate() {
        let columns: Vec<Vec<f64>> = sources
            .par_iter()
            .map(|source| run.column(source, number).unwrap_or_else(|| vec![0.0; 2 * run.scenario.samples()]))
            .collect();
        let residual: Vec<f64> = run.followed.white.iter().flatten().copied().collect();
        let n = residual.len();
        let mut w = DMatrix::zeros(n, p);
        for (c, column) in columns.iter().enumerate() {
            w.column_mut(c).copy_from_slice(column);
        }
        let r = DVector::from_vec(residual);
        gram += product(&w);
        right += w.tr_mul(&r);
        squares += r.norm_squared();
        rows += run.follower.rows;
        log_variance += run.follower.log_variance;
        kept.push(w);
    }
    // Effects that are in the model are taken out linearly.
    let mut present = DVector::zeros(p);
    for candidate in &candidates {
        for variant in &candidate.variants {
            for (column, value) in variant.columns.iter().zip(&variant.present) {
                present[*column] = *value;
            }
        }
    }
    let shift = &gram * &present;
    squares += 2.0 * right.dot(&present) + present.dot(&shift);
    right += shift;
    Some(Linear { nuisances, candidates, gram, right, squares, rows, log_variance, columns: kept, present })
}

/// A step of the load in one run, at any of many times.
fn events(model: &Model, runs: &[Around<'_>], sources: &mut Vec<Source>, candidates: &mut Vec<Candidate>) {
    const PLACES: usize = 24;
    let Some(effect) = crate::plant::effect::find("load_step") else { return };
    for (number, run) in runs.iter().enumerate() {
        let length_s = run.scenario.sample_time_s[run.scenario.samples() - 1] - run.scenario.begin_s();
        let slab = SLAB * typical_size(effect, 0, model, run.scenario);
        let variants = (1..PLACES)
            .map(|place| {
                let values = vec![slab, length_s * place as f64 / PLACES as f64];
                sources.push(Source::In(number, Box::new(Source::Terms { terms: effect.terms(&values), scale: 1.0 })));
                Variant {
                    columns: vec![sources.len() - 1],
                    values,
                    units: vec![slab],
                    parameters: vec![0],
                    present: vec![0.0],
                    mean: 0.0,
                    positive: false,
                    log_prior: -(PLACES as f64).ln(),
                }
            })
            .collect();
        candidates.push(Candidate { id: "load_step", in_model: false, unknown: false, log_odds: (0.05_f64).ln(), variants, excludes: vec![] });
    }
}

fn exclusions(candidates: &mut [Candidate]) {
    let curve = |c: &Candidate| match c.id {
        "torque over speed" => Some(("torque", "speed_rad_s")),
        "torque over angle" => Some(("torque", "angle_rad")),
        "voltage over current" => Some(("voltage", "current_a")),
        id => curve_of(id),
    };
    let says_the_same = |a: &Candidate, b: &Candidate| {
        related(a.id, b.id) || (a.unknown != b.unknown && curve(a).is_some() && curve(a) == curve(b))
    };
    for k in 0..candidates.len() {
        let excludes = (0..candidates.len()).filter(|o| *o != k && says_the_same(&candidates[k], &candidates[*o])).collect();
        candidates[k].excludes = excludes;
    }
}

/// `w' w`, by blocks of rows in parallel.
pub fn product(w: &DMatrix<f64>) -> DMatrix<f64> {
    const ROWS: usize = 2048;
    let p = w.ncols();
    let blocks = w.nrows().div_ceil(ROWS);
    (0..blocks)
        .into_par_iter()
        .fold(
            || DMatrix::zeros(p, p),
            |mut sum, block| {
                let from = block * ROWS;
                let part = w.rows(from, ROWS.min(w.nrows() - from));
                let turned = part.transpose();
                sum.gemm(1.0, &turned, &part, 1.0);
                sum
            },
        )
        .reduce(|| DMatrix::zeros(p, p), |a, b| a + b)
}

fn unknown_curves(sources: &mut Vec<Source>, candidates: &mut Vec<Candidate>, runs: &[Around<'_>]) {
    let run = &runs[0];
    if run.scenario.input != Input::Voltage {
        return;
    }
    let most = |k: usize| run.followed.after.iter().fold(0.0_f64, |m, s| m.max(s[k].abs()));
    let (current, speed) = (most(0), most(1));
    let torque = 0.06 * run.model.motor.torque_constant().unwrap_or(1.0) * current;
    let volts = 0.06 * run.scenario.events.iter().fold(0.0_f64, |m, e| m.max(e.1.abs()));
    let mut add = |id: &'static str, curves: Vec<Curve>| {
        let columns: Vec<usize> = (0..curves.len()).map(|k| sources.len() + k).collect();
        sources.extend(curves.into_iter().map(Source::Curve));
        let k = columns.len();
        candidates.push(Candidate {
            id,
            in_model: false,
            unknown: true,
            log_odds: (0.01_f64).ln(),
            variants: vec![Variant { columns, values: vec![], units: vec![1.0; k], parameters: vec![], present: vec![0.0; k], mean: 0.0, positive: false, log_prior: 0.0 }],
            excludes: vec![],
        });
    };
    let hats = |count: i32, from: f64, to: f64| -> Vec<(f64, f64)> {
        let width = (to - from) / f64::from(count - 1);
        (0..count).map(|k| (from + width * f64::from(k), width)).collect()
    };
    add("torque over speed", hats(11, -speed, speed).into_iter().map(|(centre, width)| Curve::TorqueOverSpeed { centre, width, size: torque }).collect());
    add("torque over angle", (1..=6).flat_map(|n| [true, false].map(|sine| Curve::TorqueOverAngle { order: f64::from(n), sine, size: torque })).collect());
    add("voltage over current", hats(7, -current, current).into_iter().map(|(centre, width)| Curve::VoltageOverCurrent { centre, width, size: volts }).collect());
}

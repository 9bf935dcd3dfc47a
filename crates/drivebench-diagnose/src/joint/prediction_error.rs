//! Prediction-error fit (Ljung, System Identification, 1999, chapter 7) with priors: every free parameter of a model, and of its
//! effects, from the whitened innovations of the runs, by Gauss-Newton steps damped after Levenberg and Marquardt.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::columns::columns_of;
use super::eligible::why_not;
use super::events::{Event, Hypothesis};
use super::free_run::excess;
use super::kalman::{Noise, innovations_with};
use super::noise::initial_noise;
use super::nuisances::{ErrorOf, MotorPrior, left_beyond_ohm, motor_prior, of_equations};
use super::regression::{SLAB, Source};
use super::run::LinearisedRun;
use super::tangent::{self, Tangent};
use super::whitened::Whitened;
use crate::score::{Fitted, Score};
use crate::work::{Work, iterations_of};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::verdict::judge;
use drivebench_model::numerics::least_squares::inverse_of_normal;
use drivebench_model::numerics::levenberg_marquardt::{self, Minimum, Options, Problem};
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{
    ActiveEffect, Model, Motor, MotorKey, ParameterRole, Scenario, Slot, State, motor_range,
    typical_size,
};
use drivebench_model::sample::Reason;

/// Coordinate `x` of a parameter: `p = unit x`, or `p = exp(x)` without a unit; with a normal prior of mean `at` and deviation `sd`.
#[derive(Clone, Copy)]
struct Coordinate {
    unit: Option<f64>,
    range: (f64, f64),
    sd: f64,
    at: f64,
}

impl Coordinate {
    const fn linear(unit: f64, range: (f64, f64), at: f64) -> Self {
        Self { unit: Some(unit), range, sd: 1.0, at }
    }

    fn logarithm(sd: f64, range: (f64, f64), value: f64) -> Self {
        Self { unit: None, range, sd, at: value.ln() }
    }

    /// `None` for what is not fitted: the number of cogs, the time of an event, and what the run leaves undetermined.
    fn of(slot: &Slot, value: f64, model: &Model, scenario: &Scenario) -> Option<Self> {
        let (index, parameter, spec) = match *slot {
            Slot::Motor(key) => {
                return Some(match motor_prior(key, model, scenario)? {
                    MotorPrior::Logarithm(sd) => {
                        Self::logarithm(sd, motor_range(key, model, scenario), value)
                    }
                    MotorPrior::Linear(unit) => Self::linear(unit, (0.0, 1e9), value / unit),
                });
            }
            Slot::Effect { index, parameter, spec, .. } => (index, parameter, spec),
        };
        let effect = model.effects[index].effect;
        let is_chosen = matches!(spec.role, ParameterRole::Choice | ParameterRole::EventTime);
        if is_chosen || why_not(effect, scenario).is_some() {
            return None;
        }
        let range = spec.in_run(&scenario.scales);
        Some(if spec.is_coefficient() {
            let takes_power = effect.card().takes_power;
            let least = if takes_power { 0.0 } else { range.min };
            let unit = SLAB * typical_size(effect, parameter, model, scenario);
            Self::linear(unit, (least, range.max), 0.0)
        } else if spec.logarithmic {
            let limit = effect.card().limit.filter(|limit| limit.parameter == parameter);
            let least = limit.map_or(range.min, |limit| limit.least_in(effect, scenario));
            // The prior of a shape: a factor of e; three scales where it may be zero.
            Self::logarithm(1.0, (least, range.max), value)
        } else {
            let unit = 3.0 * range.scale;
            Self::linear(unit, (range.min, range.max), value / unit)
        })
    }

    fn to_x(self, value: f64) -> f64 {
        let logarithm = || value.clamp(self.range.0, self.range.1).ln();
        self.unit.map_or_else(logarithm, |unit| value / unit)
    }

    fn to_value(self, x: f64) -> f64 {
        self.unit.map_or_else(|| x.exp(), |unit| x * unit)
    }

    /// Derivative of the value by the coordinate.
    fn slope(self, value: f64) -> f64 {
        self.unit.unwrap_or(value)
    }

    /// Distance from the prior mean, in standard deviations.
    fn standardised(self, x: f64) -> f64 {
        (x - self.at) / self.sd
    }

    fn clamp(self, x: f64) -> f64 {
        let (least, most) = self.range;
        match self.unit {
            None => x.clamp(least.ln(), most.ln()),
            Some(unit) => x.clamp(least / unit, most / unit),
        }
    }
}

/// Whitened innovations of the runs, behind them the priors and the root of the log determinant of the errors of the equations,
/// as a function of the coordinates: those that all runs share, then the sizes of the events.
struct Innovations<'a> {
    hypothesis: Hypothesis,
    free: Vec<(Slot, Coordinate)>,
    sizes: Vec<Coordinate>,
    runs: &'a [LinearisedRun<'a>],
    len: usize,
    /// Whether its derivatives are tangents; else differences of simulations.
    has_tangents: bool,
    /// Errors of the equations that are integrated out.
    equation_errors: Option<EquationErrors>,
    /// Sub-steps of this fit alone: the count of the whole search depends on the order of the threads.
    own: Work,
}

/// Errors of the time stamps and of the forms of the effects, integrated out of whitened innovations `r`. With their columns `F` at
/// one standard deviation, `r'(I + F F')^-1 r` is the square of `(I + F F')^(-1/2) r = r - F A F' r`. The error of a form is in
/// proportion to the size of its effect.
struct EquationErrors {
    columns: Vec<Vec<f32>>,
    /// The effect of each column.
    effects: Vec<Option<usize>>,
    gram: DMatrix<f64>,
    /// Of the effects as the columns have them.
    sizes: Vec<f64>,
}

/// The size of each effect: of several coefficients the root of the sum of their squares.
fn sizes(model: &Model) -> Vec<f64> {
    let size = |active: &ActiveEffect| {
        let specs = active.effect.parameters().iter();
        let pairs = specs.zip(active.values_or_guess());
        let squares = pairs.filter(|(spec, _)| spec.is_coefficient());
        squares.map(|(_, value)| value * value).sum::<f64>().sqrt()
    };
    model.effects.iter().map(size).collect()
}

impl EquationErrors {
    /// Of runs filtered with the model; their events follow its effects.
    fn of(model: &Model, runs: &[LinearisedRun<'_>]) -> Self {
        let mut columns: Vec<Vec<f32>> = Vec::new();
        let mut errors: Vec<ErrorOf> = Vec::new();
        let mut rows = 0;
        let equations = runs.par_iter().with_max_len(1).map(of_equations);
        for (run, own) in runs.iter().zip(equations.collect::<Vec<_>>()) {
            let is_shared = |error: &ErrorOf| {
                let effect = error.effect;
                effect.is_none_or(|number| number < model.effects.len())
            };
            for (error, own) in own.into_iter().filter(|(error, _)| is_shared(error)) {
                let known = errors.iter().position(|known| *known == error);
                let at = known.unwrap_or(errors.len());
                if known.is_none() {
                    errors.push(error);
                    columns.push(Vec::new());
                }
                // Zero in earlier runs without this form.
                columns[at].resize(rows, 0.0);
                columns[at].extend(own);
            }
            rows += run.rows();
        }
        let k = columns.len();
        let whitened = Whitened::new(columns, rows);
        let gram = whitened.gram(&vec![[0.0; 2]; rows / 2]);
        Self {
            columns: whitened.columns,
            effects: errors.into_iter().map(|error| error.effect).collect(),
            gram: gram.view((0, 0), (k, k)).into_owned(),
            sizes: sizes(model),
        }
    }

    /// The projection for innovations of `model`.
    fn at(&self, model: &Model) -> Marginalisation<'_> {
        let now = sizes(model);
        let share = |effect: &Option<usize>| match effect {
            Some(effect) if self.sizes[*effect] > 0.0 => now[*effect] / self.sizes[*effect],
            _ => 1.0,
        };
        let shares = DVector::from_iterator(self.effects.len(), self.effects.iter().map(share));
        let scale = DMatrix::from_diagonal(&shares);
        let eigen = (&scale * &self.gram * &scale).symmetric_eigen();
        let of_one = |s: f64| {
            if s > 1e-9 { (1.0 - 1.0 / (1.0 + s).sqrt()) / s } else { 0.0 }
        };
        let middle = DMatrix::from_diagonal(&eigen.eigenvalues.map(of_one));
        let turn = scale * &eigen.eigenvectors;
        Marginalisation {
            columns: &self.columns,
            weights: &turn * middle * turn.transpose(),
            log_det: eigen.eigenvalues.iter().map(|s| s.max(0.0).ln_1p()).sum(),
        }
    }
}

/// `F A F'` of a model, and the log determinant of `I + F F'`.
struct Marginalisation<'a> {
    columns: &'a [Vec<f32>],
    weights: DMatrix<f64>,
    log_det: f64,
}

impl Marginalisation<'_> {
    fn remove(&self, white: &mut [f64]) {
        let products = self.columns.iter().map(|column| {
            let pairs = column.iter().zip(white.iter());
            pairs.map(|(a, b)| f64::from(*a) * b).sum::<f64>()
        });
        let products = DVector::from_iterator(self.columns.len(), products);
        let weights = &self.weights * products;
        for (column, weight) in self.columns.iter().zip(weights.iter()) {
            for (white, value) in white.iter_mut().zip(column) {
                *white -= weight * f64::from(*value);
            }
        }
    }
}

impl<'a> Innovations<'a> {
    fn new(hypothesis: &Hypothesis, runs: &'a [LinearisedRun<'a>]) -> Self {
        let model = &hypothesis.model;
        let size = |event: &Event| {
            let index = event.effect.size_index();
            let spec = &event.effect.parameters()[index];
            let run = &runs[event.run.min(runs.len() - 1)];
            let unit = SLAB * typical_size(event.effect, index, model, run.scenario);
            Coordinate::linear(unit, (spec.min, spec.max), 0.0)
        };
        let sizes: Vec<Coordinate> = hypothesis.events.iter().map(size).collect();
        let free: Vec<(Slot, Coordinate)> = model
            .free_slots()
            .into_iter()
            .filter_map(|slot| {
                let unit = Coordinate::of(&slot, model.get(&slot)?, model, runs[0].scenario)?;
                Some((slot, unit))
            })
            .collect();
        let samples: usize = runs.iter().map(|run| run.scenario.samples()).sum();
        Self {
            hypothesis: hypothesis.clone(),
            len: 2 * samples + free.len() + sizes.len() + 1,
            free,
            sizes,
            runs,
            has_tangents: tangent::are_tangents(model, runs[0].scenario),
            equation_errors: None,
            own: Work::default(),
        }
    }

    /// Options with the iterations that the budget of the search allows.
    fn quick(&self) -> Options {
        let each: u64 = self.runs.iter().map(|run| run.gains.work).sum();
        let simulations = if self.has_tangents { 2 } else { self.free.len() + 1 };
        Options {
            most_iterations: iterations_of(each * simulations as u64, QUICK.most_iterations),
            ..QUICK
        }
    }

    fn minimum(&self, options: Options) -> Option<Minimum> {
        levenberg_marquardt::minimise(self, &self.start(), options)
    }

    fn units(&self) -> impl Iterator<Item = Coordinate> {
        let free = self.free.iter().map(|(_, unit)| *unit);
        free.chain(self.sizes.iter().copied())
    }

    /// Derivative of the innovations by one coordinate as a tangent; `None` where there is none.
    fn slope(&self, there: &Hypothesis, x: &[f64], parameter: usize) -> Option<Source> {
        if !self.has_tangents {
            return None;
        }
        let Some((slot, unit)) = self.free.get(parameter) else {
            let number = parameter - self.free.len();
            let event = &there.events[number];
            let onset_s = self.runs[event.run].scenario.scales.onset_s();
            let slope = event.slope(self.sizes[number].slope(0.0), onset_s);
            return slope.map(|slope| Source::In(event.run, slope));
        };
        let value = unit.to_value(x[parameter]);
        match slot {
            Slot::Motor(key) => Some(Source::Tangent(Tangent::Motor(*key, unit.slope(value)))),
            Slot::Effect { index, parameter: place, .. } => {
                let own = &there.model.effects[*index];
                let over = self.difference_step(parameter);
                let step = unit.to_value(x[parameter] + over) - value;
                let unit = unit.slope(value);
                let values = own.values_or_guess();
                let tangent =
                    tangent::parameter_tangent(own.effect, &values, *place, unit, (step, over));
                tangent.map(Source::Tangent)
            }
        }
    }

    fn start(&self) -> Vec<f64> {
        let Hypothesis { model, events } = &self.hypothesis;
        let free = self.free.iter();
        let shared = free.map(|(slot, _)| model.get(slot).unwrap_or(f64::NAN));
        let size = |event: &Event| event.values[event.effect.size_index()];
        let sizes = events.iter().map(size);
        let values = shared.chain(sizes).zip(self.units());
        values.map(|(value, unit)| unit.to_x(value)).collect()
    }

    fn hypothesis_at(&self, x: &[f64]) -> Hypothesis {
        let mut there = self.hypothesis.clone();
        for ((slot, unit), x) in self.free.iter().zip(x) {
            there.model.set(slot, unit.to_value(*x));
        }
        let sizes = self.sizes.iter().zip(&x[self.free.len()..]);
        for (event, (unit, x)) in there.events.iter_mut().zip(sizes) {
            let index = event.effect.size_index();
            event.values[index] = unit.to_value(*x);
        }
        there
    }
}

impl Problem for Innovations<'_> {
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
        let there = self.hypothesis_at(x);
        let (out, priors) = out.split_at_mut(self.len - x.len() - 1);
        let of_run = |(number, run): (usize, &LinearisedRun<'_>)| {
            let (model, scenario) = (there.in_run(number), run.scenario);
            let mut white = Vec::with_capacity(scenario.samples());
            let gains = &run.gains;
            let steps =
                innovations_with(gains, &model, scenario, run.start, &run.noise, &mut white)?;
            run.count(steps);
            self.own.add(steps);
            Some(white)
        };
        let each = self.runs.par_iter().enumerate().with_max_len(1);
        let Some(white) = each.map(of_run).collect::<Option<Vec<_>>>() else {
            return false;
        };
        for (cell, value) in out.iter_mut().zip(white.iter().flatten().flatten()) {
            *cell = *value;
        }
        for ((unit, x), cell) in self.units().zip(x).zip(&mut *priors) {
            *cell = unit.standardised(*x);
        }
        priors[x.len()] = 0.0;
        if let Some(equation_errors) = &self.equation_errors {
            let marginalisation = equation_errors.at(&there.model);
            marginalisation.remove(out);
            priors[x.len()] = marginalisation.log_det.sqrt();
        }
        true
    }

    fn residual_len(&self) -> usize {
        self.len
    }

    fn is_spent(&self) -> bool {
        self.own.is_spent_by_a_refit()
    }

    fn difference_step(&self, index: usize) -> f64 {
        let unit = self.units().nth(index);
        let is_logarithm = unit.is_some_and(|unit| unit.unit.is_none());
        if is_logarithm { 2e-3 } else { 5e-3 }
    }

    fn slopes(&self, x: &[f64]) -> Vec<Option<Vec<f64>>> {
        let there = self.hypothesis_at(x);
        let sources: Vec<Option<Source>> = (0..x.len()).map(|k| self.slope(&there, x, k)).collect();
        let known: Vec<&Source> = sources.iter().flatten().collect();
        let columns = columns_of(&known, self.runs);
        let log_det = |x: &[f64]| {
            let equation_errors = self.equation_errors.as_ref();
            equation_errors.map_or(0.0, |equation_errors| {
                equation_errors.at(&self.hypothesis_at(x).model).log_det.sqrt()
            })
        };
        let marginalisation =
            self.equation_errors.as_ref().map(|equation_errors| equation_errors.at(&there.model));
        let own = self.len - x.len() - 1;
        let mut next = 0..;
        let mut column = |parameter: usize| {
            let number = next.next()?;
            let mut slope = vec![0.0; self.len];
            let mut from = 0;
            for (whitened, run) in columns.iter().zip(self.runs) {
                // An event of one run has a zero column in the others.
                let cells = slope[from..].iter_mut().zip(&whitened.columns[number]);
                cells.for_each(|(cell, value)| *cell = f64::from(*value));
                from += 2 * run.scenario.samples();
            }
            if let Some(marginalisation) = &marginalisation {
                marginalisation.remove(&mut slope[..own]);
            }
            // A column is the negative change of the innovations.
            slope[..own].iter_mut().for_each(|cell| *cell = -*cell);
            slope[own + parameter] = 1.0 / self.units().nth(parameter)?.sd;
            let step = self.difference_step(parameter);
            let mut moved = x.to_vec();
            moved[parameter] += step;
            slope[own + x.len()] = (log_det(&moved) - log_det(x)) / step;
            Some(slope)
        };
        let each = sources.iter().enumerate();
        each.map(|(parameter, source)| source.as_ref().and_then(|_| column(parameter))).collect()
    }

    fn clamp(&self, x: &mut [f64]) {
        for (x, unit) in x.iter_mut().zip(self.units()) {
            *x = unit.clamp(*x);
        }
    }
}

/// Options of a refit, which needs the likelihood and no deviations.
const QUICK: Options = Options {
    most_iterations: 25,
    relative_cost: 1e-4,
    longest_step: 1.5,
    carry_jacobian: true,
    one_of_many: false,
};

/// A hypothesis that was refitted.
pub(super) struct Refit {
    pub(super) hypothesis: Hypothesis,
    /// Sum of the squares of the whitened innovations, priors included.
    pub(super) squares: f64,
    /// Minus twice the log likelihood, without the constant that all models share.
    pub(super) deviance: f64,
}

/// Fits all free parameters except event times with the gains of `runs`, also of another model. Returns the fit and the sum of
/// squares of its innovations; `None` where it cannot be simulated.
pub(super) fn fit_as_followed(
    start: &Hypothesis,
    runs: &[LinearisedRun<'_>],
) -> Option<(Hypothesis, f64)> {
    let mut problem = Innovations::new(start, runs);
    // Tangents are those along the runs as they were followed, which another model may be far from: a fit that began at a start
    // delay of 0.64 s, of 0.4 s in truth, did not move.
    problem.has_tangents &= !runs.iter().any(|run| run.grid.is_refined());
    let minimum = problem.minimum(problem.quick())?;
    Some((problem.hypothesis_at(&minimum.x), minimum.cost))
}

/// Fits all free parameters except event times, with the gains of the start itself and errors of forms and stamps integrated out.
/// `None` where it cannot be simulated.
pub(super) fn fit<'a>(start: &Hypothesis, runs: &[LinearisedRun<'a>]) -> Option<Refit> {
    let around = |(number, run): (usize, &LinearisedRun<'a>)| {
        run.relinearised(&start.model, start.events_of(number), run.scenario)
    };
    let each = runs.par_iter().with_max_len(1).enumerate();
    let own: Vec<LinearisedRun<'_>> = each.map(around).collect::<Option<_>>()?;
    let mut problem = Innovations::new(start, &own);
    problem.equation_errors = Some(EquationErrors::of(&start.model, &own));
    let minimum = problem.minimum(problem.quick())?;
    let over_sd = own
        .iter()
        .flat_map(|run| &run.gains.updates)
        .flat_map(|update| [update.current[4], update.speed[4]]);
    let logs: f64 = over_sd.filter(|over_sd| *over_sd > 0.0).map(f64::ln).sum();
    Some(Refit {
        hypothesis: problem.hypothesis_at(&minimum.x),
        squares: minimum.cost,
        deviance: minimum.cost - 2.0 * logs,
    })
}

/// Estimate of a model's parameters on one run.
struct Estimated {
    model: Model,
    /// Each free parameter with its standard deviation; none where the run leaves it undetermined.
    deviations: Vec<(Slot, Option<f64>)>,
    /// Their factor for the excess of the residual over white noise.
    factor: f64,
    converged: bool,
}

/// Fits all free parameters of the model of `run`. Standard deviations: errors of stamps and forms integrated out, times the excess of
/// the residual over white noise, without priors.
fn estimate(run: &LinearisedRun<'_>) -> Option<Estimated> {
    let runs = std::slice::from_ref(run);
    let mut problem = Innovations::new(&Hypothesis::whole(&run.model), runs);
    // Without them the parameters would absorb the misfit that the forms of the effects make.
    problem.equation_errors = Some(EquationErrors::of(&run.model, runs));
    let minimum = problem.minimum(Options {
        most_iterations: problem.quick().most_iterations,
        ..Options::default()
    })?;
    let rows = problem.len - problem.free.len() - 1;
    let slopes = minimum.jacobian.rows(0, rows);
    let (covariance, determined) = inverse_of_normal(&slopes.tr_mul(&slopes));
    let left = minimum.residual[..rows].chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
    let factor = excess(&[(run, left)]).sqrt();
    let fitted = problem.hypothesis_at(&minimum.x).model;
    let left_ohm = left_beyond_ohm(&fitted, run.scenario);
    let deviation = |(index, (slot, unit)): (usize, &(Slot, Coordinate))| {
        let slope = unit.slope(unit.to_value(minimum.x[index]));
        let variance = covariance[(index, index)].max(0.0);
        let is_resistance = matches!(slot, Slot::Motor(MotorKey::Resistance));
        let beside = if is_resistance { left_ohm } else { 0.0 };
        let deviation = (factor * slope * variance.sqrt()).hypot(beside);
        (*slot, determined[index].then_some(deviation))
    };
    Some(Estimated {
        deviations: problem.free.iter().enumerate().map(deviation).collect(),
        model: fitted,
        factor,
        converged: minimum.converged,
    })
}

/// Resistance, inductance and back-EMF constant of a motor with their deviations, where the run determines them; its torques are a
/// random disturbance as large as that of the largest current. `None` where the run cannot be followed.
pub(crate) fn motor_constants(motor: &Motor, run: &Scenario) -> Option<Vec<(MotorKey, f64, f64)>> {
    let mut motor = motor.clone();
    let torque_n_m = motor.torque_constant()? * largest(&run.current_a);
    let scales = &run.scales;
    // Any inertia with which that torque reaches the run's speed.
    if motor.get(MotorKey::Inertia).is_none() {
        motor.set(MotorKey::Inertia, torque_n_m * scales.response_s / scales.speed_rad_s);
    }
    motor.set(MotorKey::LoadTorque, 0.0);
    let mut model = Model::baseline(motor);
    model.fixed = [MotorKey::Inertia, MotorKey::LoadTorque].map(|key| key.key().to_owned()).into();
    let floor = NoiseFloor::from_standstill(run).unwrap_or_else(|| NoiseFloor::from_spread(run));
    let noise = Noise { disturbance_n_m: torque_n_m, ..initial_noise(&floor, &model, run) };
    let first = |values: &[f64]| values.iter().copied().find(|value| value.is_finite());
    let start = State::at(first(&run.current_a)?, first(&run.speed_rad_s)?);
    let found = estimate(&LinearisedRun::new(&model, run, start, noise)?)?;
    let known = found.deviations.iter().filter_map(|(slot, deviation)| {
        let Slot::Motor(key) = slot else {
            return None;
        };
        Some((*key, found.model.motor.get(*key)?, (*deviation)?))
    });
    Some(known.collect())
}

/// Growth of the free-run error from which on values by prediction errors are not used for simulation: the form of an effect differs.
const LED_ONLY_RATIO: f64 = 1.1;

/// A fit with values and deviations by prediction errors, which separate a disturbance of the load from the motor's parameters.
/// Where those values do not predict a free run (the form of an effect differs from its equation), the values of the fit stay, and
/// their distance is added to the deviation. Unchanged where the model cannot be simulated on the run; event times stay.
pub(crate) fn refined(fit: Fitted, run: &Scenario, noise: Noise) -> Fitted {
    led(fit, run, noise, true).0
}

/// [`refined`] with the values of the fit in any case.
pub(crate) fn with_deviations(fit: Fitted, run: &Scenario, noise: Noise) -> Fitted {
    led(fit, run, noise, false).0
}

/// Which figures of a fit are by prediction errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Led {
    Values,
    /// The deviations of values that stayed.
    Deviations,
    Neither,
}

/// [`refined`] if it `may_move`, else [`with_deviations`]; and which figures were replaced.
pub(crate) fn led(mut fit: Fitted, run: &Scenario, noise: Noise, may_move: bool) -> (Fitted, Led) {
    let start = State::at(fit.start.current_a, fit.start.speed_rad_s);
    let linearised = LinearisedRun::new(&fit.model, run, start, noise);
    let Some(estimated) = linearised.and_then(|run| estimate(&run)) else {
        return (fit, Led::Neither);
    };
    let score = may_move.then(|| Score::of(&estimated.model, run, &fit.noise));
    let led = score.and_then(Result::ok).filter(|score| score.nrms < LED_ONLY_RATIO * fit.nrms);
    let kept = led.as_ref().map_or(&fit.model, |_| &estimated.model).clone();
    let period_s = run.mean_period_s();
    let mut is_known = false;
    for (slot, deviation) in &estimated.deviations {
        let key = slot.key();
        let value = kept.get(slot).unwrap_or(f64::NAN);
        let apart = estimated.model.get(slot).unwrap_or(f64::NAN) - value;
        let deviation = deviation.map(|deviation| deviation.hypot(apart));
        let mut judged = judge(slot, value, deviation, period_s);
        if !estimated.converged {
            judged.unsettle(Reason::NotConverged, "the fit had not converged");
        }
        let mut parameters = fit.parameters.iter_mut();
        if let Some(parameter) = parameters.find(|own| own.key == key) {
            is_known |= judged.std.is_some();
            *parameter = judged;
        }
    }
    let of = match &led {
        // Without any slope there are no deviations.
        _ if !is_known => Led::Neither,
        Some(_) => Led::Values,
        None => Led::Deviations,
    };
    let led = Fitted {
        model: kept,
        interval_factor: estimated.factor,
        nrms: led.map_or(fit.nrms, |score| score.nrms),
        ..fit
    };
    (led, of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::kalman::QUIET;
    use crate::kit::{nameplate, record, truth, with};
    use drivebench_identify::output_error;
    use drivebench_model::plant::{effect, testing};

    fn linearised<'a>(model: &Model, run: &'a Scenario, disturbance_n_m: f64) -> LinearisedRun<'a> {
        let noise = Noise { disturbance_n_m, input: 1e-3, ..QUIET };
        LinearisedRun::new(model, run, State::default(), noise).unwrap()
    }

    #[test]
    fn motor_and_effect_are_found_together_beside_any_disturbance() {
        // A nameplate that is off, with the effect to be found, on two runs of the truth.
        let fan = truth("quadratic_load", &[2e-6]);
        let scenarios = [0, 1].map(|shift| record(&fan, shift, 7 + shift as u64));
        let mut start = truth("quadratic_load", &[5e-7]);
        for (key, factor) in [(MotorKey::Resistance, 1.2), (MotorKey::Inertia, 0.8)] {
            let value = start.motor.get(key).unwrap();
            start.motor.set(key, factor * value);
        }
        for disturbance_n_m in [1e-4, 1e-2] {
            let runs = [0, 1].map(|k| linearised(&start, &scenarios[k], disturbance_n_m));
            let found = fit(&Hypothesis::of(&start), &runs).unwrap().hypothesis.model;
            for key in [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia] {
                let ratio = found.motor.get(key).unwrap() / fan.motor.get(key).unwrap();
                assert!((ratio - 1.0).abs() < 0.03, "{disturbance_n_m} {key:?} {ratio}");
            }
            let size = found.effects[0].values[0].unwrap();
            assert!((size / 2e-6 - 1.0).abs() < 0.1, "{disturbance_n_m} {size}");
        }
    }

    #[test]
    fn slopes_are_differences_of_two_simulations() {
        let effects: [(&str, &[f64]); 6] = [
            ("viscous_friction", &[2e-4]),
            ("cogging", &[0.02, 0.01, 3.0]),
            ("stribeck_friction", &[0.05, 5.0]),
            ("supply_sag", &[0.02]),
            ("command_delay", &[4e-4]),
            ("current_offset", &[0.02]),
        ];
        let model = with(nameplate(), &effects);
        // Moves one way only: where a shaft breaks away differences are no slopes.
        let levels = vec![(0.0, 30.0), (0.6, 60.0), (1.2, 25.0), (1.8, 70.0)];
        let run = testing::record(&model, levels, 1e-3, 2.5, 11);
        let runs = [linearised(&model, &run, 1e-3)];
        let mut problem = Innovations::new(&Hypothesis::whole(&model), &runs);
        let x = problem.start();
        assert!(problem.slopes(&x).iter().all(Option::is_some));
        let mut residual = vec![0.0; problem.residual_len()];
        assert!(problem.residual(&x, &mut residual));
        let along = levenberg_marquardt::jacobian_at(&problem, &x, &residual);
        problem.has_tangents = false;
        let differences = levenberg_marquardt::jacobian_at(&problem, &x, &residual);
        for (parameter, (slot, _)) in problem.free.iter().enumerate() {
            let [a, b] = [&along, &differences].map(|all| all.column(parameter).into_owned());
            let apart = (&a - &b).norm() / b.norm();
            assert!(apart < 0.05, "{}: {apart}", slot.key());
        }
    }

    #[test]
    fn a_drop_of_brushes_may_build_up_slowly() {
        // Below the currents of a converter's gaps these are brushes.
        let run = record(&truth("discontinuous_conduction", &[2.4, 0.5]), 0, 7);
        let start = truth("voltage_drop", &[1.0]);
        let runs = [linearised(&start, &run, 1e-4)];
        let found = fit(&Hypothesis::of(&start), &runs).unwrap();
        let drop_v = found.hypothesis.model.effects[0].values[0].unwrap();
        assert!((drop_v / 1.2 - 1.0).abs() < 0.1, "{drop_v}");
        let mean = found.squares / runs[0].gains.rows as f64;
        assert!(mean < 1.5, "{mean}");
    }

    #[test]
    fn forms_of_one_run_alone_are_kept_apart() {
        let model = truth("voltage_drop", &[1.0]);
        let large = record(&model, 0, 7);
        let mut small = large.clone();
        // Where no current reaches the level of the drop.
        small.current_a.iter_mut().for_each(|a| *a *= 1e-3);
        let runs = [&large, &small].map(|run| linearised(&model, run, 1e-4));
        // Three stamps; either how slowly the level is reached, or powers.
        let each = [&runs[..1], &runs[1..], &runs].map(|runs| EquationErrors::of(&model, runs));
        assert_eq!(each.each_ref().map(|of| of.effects.len()), [6, 5, 8]);
        let gram = &each[2].gram;
        assert!(gram.view((3, 6), (3, 2)).amax() <= 0.0, "{gram}");
        assert!((3..8).all(|form| gram[(form, form)] > 0.0));
    }

    #[test]
    fn an_error_of_the_stamps_is_none_of_the_inertia() {
        let mut run = record(&truth("speed_delay", &[2e-4]), 0, 7);
        run.time_half_width_s = vec![2e-4; run.samples()];
        let model = nameplate();
        let run = linearised(&model, &run, 1e-4);
        let inertia = |model: &Model| model.motor.get(MotorKey::Inertia).unwrap();
        let off = |found: &Model| (inertia(found) - inertia(&model)).abs();
        let found = estimate(&run).unwrap();
        let is_inertia = |slot: &Slot| matches!(slot, Slot::Motor(MotorKey::Inertia));
        let own = found.deviations.iter().find(|(slot, _)| is_inertia(slot));
        let deviation = own.unwrap().1.unwrap();
        assert!(off(&found.model) < 2.0 * deviation);
        let whole = Hypothesis::whole(&model);
        let (exact, _) = fit_as_followed(&whole, std::slice::from_ref(&run)).unwrap();
        assert!(off(&exact.model) > 4.0 * deviation);
    }

    #[test]
    fn under_another_form_of_gaps_the_interval_holds_the_resistance() {
        // The load line bends over where the catalogue's has a corner.
        let bent = "equation = \"voltage\"\nparameters = [\"r\"]\nexpression = \"2*r*tanh(i/2)\"";
        let (bent, _) = effect::define("custom", &bent.parse().unwrap()).unwrap();
        let mut machine = nameplate();
        machine.effects.push(ActiveEffect::with(bent, &[1.4]));
        // Ramps of 150 V/s between levels that hold: currents of some amperes.
        let volts = |at_s: f64| {
            let phase_s = at_s % 2.0;
            let rising = 150.0 * phase_s.min(0.5) - 150.0 * (phase_s - 1.0).clamp(0.0, 0.5);
            if at_s % 4.0 < 2.0 { rising } else { -rising }
        };
        let times = (0..700_u16).map(|step| 0.01 * f64::from(step));
        let events = times.map(|at_s| (at_s, volts((at_s - 0.5).max(0.0))));
        let run = testing::record(&machine, events.collect(), 0.01, 7.0, 7);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let start = truth("discontinuous_conduction", &[1.4, 2.0]);
        let free = Fitted::from(output_error::fit(&[start], &run, &noise).unwrap());
        let along = initial_noise(&noise, &free.model, &run);
        let (found, of) = led(free.clone(), &run, along, true);
        // The values stay, since the form is another.
        assert_eq!(of, Led::Deviations);
        let mut empty = free.clone();
        empty.model.motor = Motor::new("none");
        assert_eq!(led(empty, &run, along, true).1, Led::Neither);
        let own = testing::record(&nameplate(), run.events.clone(), 0.01, 7.0, 8);
        let right = output_error::fit(&[nameplate()], &own, &noise).unwrap();
        assert_eq!(led(Fitted::from(right), &own, along, true).1, Led::Values);
        let off = |fit: &Fitted| {
            let key = MotorKey::Resistance;
            let own = fit.parameters.iter().find(|p| p.key == key.key()).unwrap();
            let off_ohm = own.value.unwrap() - machine.motor.get(key).unwrap();
            off_ohm.abs() / own.std.unwrap()
        };
        let offs = [off(&found), off(&free)];
        assert!(offs[0] < 2.0 && offs[1] > 4.0, "{offs:?} standard deviations");
        // The prediction of a free run is no worse.
        assert!(found.nrms < LED_ONLY_RATIO * free.nrms, "{} {}", found.nrms, free.nrms);
    }
}

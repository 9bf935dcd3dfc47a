//! Torque or current in, speed or angle out: the balance of torques as rows of a regression.
//!
//! ```text
//! Evidence --(torque balance in rows: weak form, and the reference processing beside it)--> Balance
//!    |-> fit      every free parameter by least squares, forms of effects by search: baseline, and each rung of the ladder
//!    '-> score    a model on held-out rows, in units of what noise leaves in one
//! ```
//!
//! The free run is no criterion here: an axis in a closed loop is an integrator, on which the smallest offset drifts. The torque
//! balance is linear in every coefficient, has one row per window, and no initial value. The weak form decides; the
//! reference processing of the literature is reported too, because the two weigh frequencies differently.
//!
//! Terms that depend on the driving torque, as friction in a gear does, are evaluated at the torque that the model itself
//! transmits, by fixed-point iteration. At the measured torque their column would be the left side of the balance wherever
//! power flows forward, and would explain it for every machine.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};

use super::evidence::{Evidence, HoldoutFrom};
use super::score::{Fitted, Score};
use drivebench_identify::balance::{Method, TorqueRows};
use drivebench_identify::misfit::{widen_by_forms_of_torque, widen_by_sampled_current};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_identify::output_error::FitError;
use drivebench_identify::verdict::judge;
use drivebench_identify::{inverse_dynamics, weak_form, winding_balance};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::{least_squares, statistics};
use drivebench_model::plant::{
    Balance as Equation, Effect, Input, Instant, Model, ModelError, MotorKey, ParameterRole,
    ParameterSpec, RunScales, Scenario, ShaftAngle, Slot, State,
};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Verdict};
use drivebench_model::signal;

/// Settings of the fit of a balance of torques.
pub(super) struct Settings {
    /// Rows below which a balance is not fitted.
    fewest_rows: usize,
    /// Fewest such blocks.
    fewest_blocks: f64,
    /// Intervals of a fit whose residual is not white are this much wider.
    widened: f64,
    /// Autocorrelation of neighbouring rows beyond what overlapping windows give.
    not_white_correlation: f64,
    /// Rows below which no correlation time is estimated.
    fewest_correlated_rows: usize,
    /// First relative step of the search over a form.
    first_step: f64,
    /// For the time of an event the first step is this part of the span of the rows.
    parts_of_span: f64,
    /// Halvings that follow.
    halvings: usize,
    /// The same of a time.
    halvings_of_a_time: usize,
    /// Passes for coefficients that are only nearly proportional.
    passes: usize,
    /// Passes where terms depend on the transmitted torque: each leaves a share of the error as large as the ratio of friction to
    /// load, 0.5^24 of which is below `proportional`.
    pub(super) passes_of_transmission: usize,
    /// Relative change at which passes end.
    pub(super) proportional: f64,
}

pub(super) const SETTINGS: Settings = Settings {
    fewest_rows: 30,
    fewest_blocks: 20.0,
    widened: 2.0,
    not_white_correlation: 0.4,
    fewest_correlated_rows: 8,
    first_step: 0.35,
    parts_of_span: 24.0,
    halvings: 7,
    halvings_of_a_time: 8,
    passes: 4,
    passes_of_transmission: 24,
    proportional: 1e-6,
};

/// One processing of all runs.
pub(super) struct Sides {
    pub(super) training: TorqueRows,
    pub(super) holdout: TorqueRows,
    pub(super) confirm: Option<TorqueRows>,
    /// The whole run where it was split, for comparison with the literature.
    pub(super) whole: Option<TorqueRows>,
}

impl Sides {
    fn each(&self) -> impl Iterator<Item = &TorqueRows> {
        let others = self.confirm.iter().chain(&self.whole);
        [&self.training, &self.holdout].into_iter().chain(others)
    }

    /// The weak form, which decides.
    pub(super) fn weak_form(model: &Model, evidence: &Evidence) -> Result<Self, FitError> {
        let by_current = evidence.training.input != Input::Torque;
        if by_current && model.motor.torque_constant().is_none() {
            let key = MotorKey::TorqueConstant.key().to_owned();
            return Err(ModelError::Unset { key }.into());
        }
        Self::new(Method::WeakForm, model, evidence)
    }

    pub(super) fn new(
        method: Method,
        model: &Model,
        evidence: &Evidence,
    ) -> Result<Self, FitError> {
        let rows = |scenario: &Scenario, between_steps: Option<bool>| {
            let rows = match method {
                Method::WeakForm => weak_form::torque_rows(model, scenario, between_steps),
                Method::InverseDynamics => inverse_dynamics::torque_rows(model, scenario),
            };
            let found = rows.as_ref().map_or(0, TorqueRows::rows);
            let rows = rows.filter(|_| found >= SETTINGS.fewest_rows);
            rows.ok_or_else(|| FitError::NoTorqueBalance {
                run: scenario.name.clone(),
                rows: found,
                needed: SETTINGS.fewest_rows,
            })
        };
        let whole = (evidence.holdout_from == HoldoutFrom::Split).then(|| Scenario {
            scored: 0..evidence.holdout.samples(),
            ..evidence.holdout.clone()
        });
        let sides = |between_steps: Option<bool>| -> Result<Self, FitError> {
            let rows = |scenario: &Scenario| rows(scenario, between_steps);
            Ok(Self {
                whole: whole.as_ref().map(rows).transpose()?,
                training: rows(&evidence.training)?,
                holdout: rows(&evidence.holdout)?,
                confirm: evidence.confirm.as_ref().map(rows).transpose()?,
            })
        };
        let sides_alone = sides(None)?;
        // The unit of the errors is that of the fitted rows: windows of one kind in all runs.
        let between_steps = sides_alone.each().filter(|rows| !rows.spans.is_empty()).count();
        let is_mixed = between_steps > 0 && between_steps < sides_alone.each().count();
        if is_mixed { sides(Some(true)) } else { Ok(sides_alone) }
    }
}

/// The balance of torques of all runs, and the unit of its errors in newton metres.
pub(super) struct Balance {
    pub(super) sides: Sides,
    pub(super) unit_n_m: f64,
    pub(super) source: FloorSource,
}

impl Balance {
    /// With the fitted baseline, if there is one. The unit of the errors is the deviation by the noise of the leading standstill
    /// in a row, else in the error of the baseline.
    pub(super) fn new(
        model: &Model,
        evidence: &Evidence,
    ) -> Result<(Self, Option<BalanceFit>), FitError> {
        let (model, _) = winding_balance::with_constants(model, &evidence.training);
        let model = &model;
        let sides = Sides::weak_form(model, evidence)?;
        let baseline = fit(model, &sides.training);
        let (unit_n_m, source) = baseline.as_ref().map_or((f64::NAN, FloorSource::None), |fit| {
            let floor = standstill_floor(model, &evidence.training, &sides.training, fit);
            let own = || (fit.rms_n_m.max(f64::MIN_POSITIVE), FloorSource::None);
            floor.map_or_else(own, |floor| (floor, FloorSource::Standstill))
        });
        Ok((Self { sides, unit_n_m, source }, baseline))
    }

    /// A complete model on these rows; only times of events are estimated anew.
    pub(super) fn score(&self, model: &Model, rows: &TorqueRows) -> Score {
        let predicted = predicted(&with_events_of(model, rows), rows);
        Score::of_balance(rows, &predicted, self.unit_n_m)
    }

    pub(super) fn fitted(&self, fit: BalanceFit, evidence: &Evidence) -> Fitted {
        Fitted {
            model: fit.model,
            parameters: fit.parameters,
            nrms: fit.rms_n_m / self.unit_n_m,
            noise: NoiseFloor { source: self.source, ..evidence.noise },
            interval_factor: 1.0,
            start: start_of(&evidence.training),
        }
    }
}

/// Initial state of a run that no voltage drives.
pub(super) fn start_of(run: &Scenario) -> State {
    let first = run.speed_rad_s.iter().copied().find(|speed| speed.is_finite());
    State::at(0.0, first.unwrap_or(0.0))
}

/// Noise of torque (or current) and of speed over the standstill, through the weights of a window.
fn standstill_floor(
    model: &Model,
    scenario: &Scenario,
    rows: &TorqueRows,
    baseline: &BalanceFit,
) -> Option<f64> {
    let still = NoiseFloor::from_standstill(scenario)?;
    let rest = scenario.leading_standstill();
    let driving: Vec<f64> = if scenario.input == Input::Torque {
        let end_s = *scenario.sample_time_s.get(rest.end.checked_sub(1)?)?;
        scenario.events.iter().take_while(|event| event.0 <= end_s).map(|event| event.1).collect()
    } else {
        let kt = model.motor.torque_constant()?;
        // The mean of a commanded current at the last sample of the rest contains a part of the first step.
        let is_commanded = scenario.input_channel == Channel::CurrentCmd;
        let end = if is_commanded { rest.end.saturating_sub(2).max(rest.start) } else { rest.end };
        let currents = &scenario.current_a[rest.start..end];
        currents.iter().map(|current| kt * current).collect()
    };
    let torque = statistics::variance(&statistics::finite(&driving)).max(0.0).sqrt();
    let torque = if torque.is_finite() { torque } else { 0.0 };
    let inertia = baseline.model.motor.get(MotorKey::Inertia)?;
    let floor = (torque * rows.gain).hypot(inertia * still.speed_rad_s * rows.rate_gain);
    (floor.is_finite() && floor > 0.0).then_some(floor)
}

/// The fitted balance.
pub(super) struct BalanceFit {
    pub(super) model: Model,
    /// Every parameter of the model, in the order of its slots.
    parameters: Vec<ParameterEstimate>,
    rms_n_m: f64,
}

/// The effect of a slot; none of a slot of the motor.
fn effect_of(model: &Model, slot: &Slot) -> Option<&'static dyn Effect> {
    let Slot::Effect { index, .. } = slot else { return None };
    Some(model.effects[*index].effect)
}

/// Whether a slot is of an effect that acts in the balance of torques.
fn acts(model: &Model, slot: &Slot) -> bool {
    effect_of(model, slot).is_some_and(|effect| effect.card().enters.includes(Equation::Torque))
}

fn is_coefficient(slot: &Slot) -> bool {
    matches!(slot, Slot::Effect { spec, .. } if spec.is_coefficient())
}

/// The linear unknowns of the torque balance: motor slots are there even where the model leaves them out.
fn unknowns(model: &Model) -> Vec<Slot> {
    let is_unknown = |slot: &Slot| is_coefficient(slot) && acts(model, slot);
    let effects = model.slots().into_iter().filter(is_unknown);
    [MotorKey::Inertia, MotorKey::LoadTorque].map(Slot::Motor).into_iter().chain(effects).collect()
}

fn is_fixed(model: &Model, slot: &Slot) -> bool {
    model.fixed.contains(&slot.key()) && model.get(slot).is_some()
}

/// Contribution of one unit of the unknown to each row, with the state `at` each sample; of a coefficient at a size
/// that it may have, because some effects are only nearly proportional.
fn column(model: &Model, slot: &Slot, rows: &TorqueRows, at: &[Instant]) -> Vec<f64> {
    match *slot {
        Slot::Motor(MotorKey::Inertia) => rows.inertia.clone(),
        Slot::Motor(_) => {
            let signs: Vec<f64> = at.iter().map(|at| at.speed_rad_s.signum()).collect();
            rows.column(&signs)
        }
        Slot::Effect { index, parameter, spec, .. } => {
            let active = &model.effects[index];
            let known = active.values[parameter].filter(|value| *value != 0.0);
            let probe = known.unwrap_or(spec.scale);
            let values = alone(active.effect, &active.values_or_guess(), parameter, probe);
            let mut column = rows.column(&torque(active.effect, &values, at));
            let gains = inertia_gains(active.effect, &values, rows);
            let inertia = model.motor.get(MotorKey::Inertia).unwrap_or(0.0);
            for ((cell, gain), rate) in column.iter_mut().zip(gains).zip(&rows.inertia) {
                *cell = (*cell + gain * inertia * rate) / probe;
            }
            column
        }
    }
}

/// Whether the effect's torque or friction depends on the torque that drives the machine.
pub(super) fn depends_on_drive(effect: &dyn Effect) -> bool {
    let specs = effect.parameters().iter();
    let terms = effect.terms(&specs.map(ParameterSpec::guess).collect::<Vec<_>>());
    let own = vec![0.0; terms.states()];
    let driven = |current_a: f64| {
        let at = Instant {
            current_a,
            speed_rad_s: 1.0,
            torque_n_m_per_a: 1.0,
            // No multiple of a quarter turn: a sine of the angle is not zero there.
            angle: ShaftAngle::at(0.3),
            ..Instant::default()
        };
        [terms.torque_n_m(&at, &own), terms.friction_n_m(&at)]
    };
    driven(1.0).into_iter().zip(driven(2.0)).any(|(once, twice)| (once - twice).abs() > 0.0)
}

/// Whether an effect of the model depends on the transmitted torque.
fn transmits(model: &Model) -> bool {
    model.effects.iter().any(|active| depends_on_drive(active.effect))
}

/// State of the machine at each sample, with the torque that the model transmits as the driving torque.
fn instants<'a>(model: &Model, rows: &'a TorqueRows) -> Cow<'a, [Instant]> {
    if !transmits(model) {
        return Cow::Borrowed(&rows.at);
    }
    let mut torque = vec![0.0; rows.rows()];
    let mut at = transmitting(rows, &torque);
    for _ in 0..SETTINGS.passes_of_transmission {
        let next = sum_of_terms(model, rows, &at);
        let change: f64 = next.iter().zip(&torque).map(|(a, b)| (a - b).powi(2)).sum();
        let whole: f64 = next.iter().map(|value| value * value).sum();
        torque = next;
        at = transmitting(rows, &torque);
        if change <= SETTINGS.proportional * SETTINGS.proportional * whole {
            break;
        }
    }
    Cow::Owned(at)
}

/// The instants of the samples under this torque, N.m in each row: between rows on the line from one to the next. It steps with a
/// commanded current, and is that of its own row there.
fn transmitting(rows: &TorqueRows, torque_n_m: &[f64]) -> Vec<Instant> {
    if !rows.spans.is_empty() {
        let mut at = rows.at.clone();
        for (row, (begin, end)) in rows.spans.iter().enumerate() {
            for at in &mut at[*begin..=*end] {
                at.current_a = torque_n_m[row] / rows.share(row) / at.torque_n_m_per_a;
            }
        }
        return at;
    }
    let points: Vec<(f64, f64)> =
        rows.time_s.iter().copied().zip(torque_n_m.iter().copied()).collect();
    let driven = |at: &Instant| Instant {
        current_a: signal::line_with_ends(&points, at.time_s + rows.begin_s) / at.torque_n_m_per_a,
        ..*at
    };
    rows.at.iter().map(driven).collect()
}

/// Torque of the effect with these parameter values at every sample, N.m; states begin at rest.
fn torque(effect: &dyn Effect, values: &[f64], at: &[Instant]) -> Vec<f64> {
    let terms = effect.terms(values);
    let mut own = vec![0.0; terms.states()];
    let mut before_s = at.first().map_or(0.0, |at| at.time_s);
    let torque = |at: &Instant| {
        terms.advance(at, &mut own, at.time_s - before_s);
        before_s = at.time_s;
        terms.torque_n_m(at, &own) + at.speed_rad_s.signum() * terms.friction_n_m(at)
    };
    at.iter().map(torque).collect()
}

/// What the effect adds to the inertia in each row, as a share of it.
fn inertia_gains(effect: &dyn Effect, values: &[f64], rows: &TorqueRows) -> Vec<f64> {
    let terms = effect.terms(values);
    let at = |time_s: &f64| Instant { time_s: time_s - rows.begin_s, ..Instant::default() };
    rows.time_s.iter().map(|time_s| terms.inertia_gain(&at(time_s))).collect()
}

/// The values with one coefficient at `size` and every other coefficient at zero.
fn alone(effect: &dyn Effect, values: &[f64], coefficient: usize, size: f64) -> Vec<f64> {
    let mut alone = values.to_vec();
    for (value, spec) in alone.iter_mut().zip(effect.parameters()) {
        if spec.is_coefficient() {
            *value = 0.0;
        }
    }
    alone[coefficient] = size;
    alone
}

/// Whether a coefficient is dissipative, hence not negative.
fn takes_power_only(model: &Model, slot: &Slot) -> bool {
    let is_load = matches!(slot, Slot::Motor(MotorKey::LoadTorque));
    effect_of(model, slot).map_or(is_load, |effect| effect.card().takes_power)
}

/// The torque that the model predicts in each row.
pub(super) fn predicted(model: &Model, rows: &TorqueRows) -> Vec<f64> {
    sum_of_terms(model, rows, &instants(model, rows))
}

fn sum_of_terms(model: &Model, rows: &TorqueRows, at: &[Instant]) -> Vec<f64> {
    let mut sum = vec![0.0; rows.rows()];
    for slot in unknowns(model) {
        let value = model.get(&slot).unwrap_or(0.0);
        for (sum, cell) in sum.iter_mut().zip(column(model, &slot, rows, at)) {
            *sum += value * cell;
        }
    }
    sum
}

/// Time from the first row to the last, s.
fn span_s(rows: &TorqueRows) -> f64 {
    rows.time_s.last().unwrap_or(&0.0) - rows.time_s.first().unwrap_or(&0.0)
}

/// Shares of the rows' span as times since the run's first command.
fn event_times(spec: &ParameterSpec, rows: &TorqueRows) -> impl Iterator<Item = f64> + use<> {
    let first_s = rows.time_s.first().map_or(0.0, |first_s| first_s - rows.begin_s);
    let of_rows = RunScales { length_s: span_s(rows), ..rows.scales };
    spec.in_run(&of_rows).shapes().map(move |time_s| first_s + time_s)
}

/// The model with every time of an event estimated anew from these rows.
pub(super) fn with_events_of(model: &Model, rows: &TorqueRows) -> Model {
    let mut model = model.clone();
    for slot in model.slots().into_iter().filter(|slot| slot.has_role(ParameterRole::EventTime)) {
        let Slot::Effect { spec, .. } = slot else { continue };
        let given = model.get(&slot);
        let mut cost_at = |time_s: f64| -> f64 {
            model.set(&slot, time_s);
            let residual = rows.residual(&predicted(&model, rows));
            residual.iter().map(|own| own * own).sum()
        };
        let tried = event_times(spec, rows).chain(given);
        let tried: Vec<(f64, f64)> = tried.map(|time_s| (cost_at(time_s), time_s)).collect();
        let best = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((mut least, mut best_s)) = best else { continue };
        let mut step_s = span_s(rows) / SETTINGS.parts_of_span;
        for _ in 0..SETTINGS.halvings_of_a_time {
            for there_s in [best_s - step_s, best_s + step_s] {
                let found = cost_at(there_s.max(0.0));
                if found < least {
                    (least, best_s) = (found, there_s.max(0.0));
                }
            }
            step_s *= 0.5;
        }
        model.set(&slot, best_s);
    }
    model
}

/// Fits every free parameter of the model to the rows; forms of effects, which are no coefficients, start where the model
/// has them. Dissipative coefficients are not negative. `None` where a term is not known in these rows,
/// or there are too few of them.
pub(super) fn fit(model: &Model, rows: &TorqueRows) -> Option<BalanceFit> {
    let mut model = model.clone();
    if transmits(&model) {
        start_of_transmission(&mut model, rows)?;
    }
    let is_form = |slot: &Slot| {
        let is_free = !is_coefficient(slot) && !model.fixed.contains(&slot.key());
        is_free && acts(&model, slot) && !slot.has_role(ParameterRole::Choice)
    };
    let forms: Vec<Slot> = model.slots().into_iter().filter(is_form).collect();
    if !forms.is_empty() {
        search(&mut model, &forms, rows);
    }
    finish(model, rows)
}

/// The fit with its deviations widened by the forms that the model may lack, and by the samples of a current that drives `run`.
pub(super) fn averaged_over_forms(fit: &Fitted, rows: &TorqueRows, run: &Scenario) -> Fitted {
    let mut wide = fit.clone();
    // Friction at its bound of zero stays there: else a form with an offset of the torque would make it negative.
    let held = fit.parameters.iter().filter(|own| own.value == Some(0.0) && own.std.is_none());
    let held: Vec<String> = held.map(|own| own.key.clone()).collect();
    widen_by_forms_of_torque(&mut wide.parameters, rows.rows(), |form| {
        let mut with = fit.model.with_effect(form).ok()?;
        with.fixed.extend(held.iter().cloned());
        finish(with, rows).map(|with| with.parameters)
    });
    widen_by_sampled_current(&mut wide.parameters, &fit.model.motor, run);
    with_winding(&mut wide.parameters, &fit.model, run);
    wide
}

/// Puts the constants of the voltage balance in, and widens what is in proportion to their torque constant.
fn with_winding(parameters: &mut [ParameterEstimate], model: &Model, run: &Scenario) {
    let (_, deviation) = winding_balance::with_constants(model, run);
    for own in parameters.iter_mut() {
        let is_torque = own.unit.starts_with("N.m") || own.unit.starts_with("kg.m2");
        if let (Some(value), Some(std)) = (own.value.filter(|_| is_torque), own.std.as_mut()) {
            *std = std.hypot(deviation * value);
        }
    }
    let winding = winding_balance::fit(model, run).map_or_else(Vec::new, |found| found.parameters);
    for found in winding {
        if let Some(own) = parameters.iter_mut().find(|own| own.key == found.key) {
            *own = found;
        }
    }
}

/// Gives the model the values of a fit without the effects of the transmitted torque, which follows from them.
fn start_of_transmission(model: &mut Model, rows: &TorqueRows) -> Option<()> {
    let mut plain = model.clone();
    plain.effects.retain(|active| !depends_on_drive(active.effect));
    let plain = fit(&plain, rows)?.model;
    for slot in plain.slots() {
        let own = model.slots().into_iter().find(|own| own.key() == slot.key());
        if let Some((own, value)) = own.zip(plain.get(&slot)) {
            model.set(&own, value);
        }
    }
    for slot in model.slots().into_iter().filter(is_coefficient) {
        let is_of_drive = effect_of(model, &slot).is_some_and(depends_on_drive);
        if is_of_drive && !is_fixed(model, &slot) {
            model.set(&slot, 0.0);
        }
    }
    Some(())
}

/// Sum of squares of the model with its forms fixed.
fn cost(model: &Model, rows: &TorqueRows) -> f64 {
    let squares = |system: System| Some(system.residual(&system.solve_bounded()?).norm_squared());
    System::new(model, rows).and_then(squares).unwrap_or(f64::INFINITY)
}

/// Coordinate search with halving steps.
fn search(model: &mut Model, forms: &[Slot], rows: &TorqueRows) {
    for slot in forms {
        if let (Slot::Effect { spec, .. }, None) = (slot, model.get(slot)) {
            let is_time = spec.role == ParameterRole::EventTime;
            let middle = || event_times(spec, rows).nth(spec.shapes.len() / 2);
            let start = is_time.then(middle).flatten();
            model.set(slot, start.unwrap_or(spec.in_run(&rows.scales).guess));
        }
    }
    let mut best = cost(model, rows);
    let mut step = 1.0;
    for _ in 0..SETTINGS.halvings {
        for slot in forms {
            let Slot::Effect { spec, .. } = slot else { continue };
            for direction in [1.0, -1.0] {
                let range = spec.in_run(&rows.scales);
                let here = model.get(slot).unwrap_or(range.guess);
                let there = if spec.role == ParameterRole::EventTime {
                    here + direction * step * span_s(rows) / SETTINGS.parts_of_span
                } else if spec.logarithmic {
                    here * (direction * step * SETTINGS.first_step).exp()
                } else {
                    here + direction * step * range.scale
                };
                model.set(slot, there.clamp(range.min, range.max));
                let found = cost(model, rows);
                if found < best {
                    best = found;
                    break;
                }
                model.set(slot, here);
            }
        }
        step *= 0.5;
    }
}

fn finish(mut model: Model, rows: &TorqueRows) -> Option<BalanceFit> {
    let mut system = System::new(&model, rows)?;
    let mut x = system.solve_bounded()?;
    let passes = if transmits(&model) { SETTINGS.passes_of_transmission } else { SETTINGS.passes };
    for _ in 0..passes {
        let before = system.matrix.clone();
        system.put(&mut model, &x);
        system = System::new(&model, rows)?;
        if (&system.matrix - &before).norm() <= SETTINGS.proportional * before.norm() {
            break;
        }
        x = system.solve_bounded()?;
    }
    system.put(&mut model, &x);
    let residual = system.residual(&x);
    // Intervals of the coefficients that are not at their bound.
    let at_bound = |place: &usize| system.takes_power[*place] && x[*place] == 0.0;
    let inside: Vec<usize> = (0..x.len()).filter(|place| !at_bound(place)).collect();
    let matrix = system.matrix.select_columns(&inside);
    let blocks = blocks(rows, residual.as_slice());
    let solution = least_squares::solve(&matrix, &system.right, &blocks)?;
    let next = statistics::autocorrelation(residual.as_slice(), 2);
    let is_white = next.get(1).is_none_or(|rho| *rho <= SETTINGS.not_white_correlation);
    let widened = if is_white { 1.0 } else { SETTINGS.widened };
    let estimate = |slot: &Slot| {
        let own = system.free.iter().position(|free| free.key() == slot.key());
        let Some(place) = own else { return not_in_the_balance(&model, slot) };
        let Some(at) = inside.iter().position(|inside| *inside == place) else {
            let reason = "held at zero: its estimate is negative, and friction cannot drive";
            return searching(slot, Some(0.0), Reason::Impossible, reason);
        };
        let variance = solution.covariance[(at, at)];
        let std = variance.is_finite().then(|| variance.max(0.0).sqrt());
        judge(slot, x[place], std.map(|std| widened * std), rows.span_s)
    };
    let squares: f64 = residual.iter().map(|r| r * r).sum();
    Some(BalanceFit {
        parameters: model.slots().iter().map(estimate).collect(),
        rms_n_m: (squares / residual.len().max(1) as f64).sqrt(),
        model,
    })
}

fn searching(slot: &Slot, value: Option<f64>, code: Reason, reason: &str) -> ParameterEstimate {
    ParameterEstimate {
        key: slot.key(),
        value,
        std: None,
        unit: slot.unit(),
        verdict: Verdict::Searching,
        reason: Some(reason.to_owned()),
        code: Some(code),
    }
}

fn not_in_the_balance(model: &Model, slot: &Slot) -> ParameterEstimate {
    if is_fixed(model, slot) {
        let fixed = ParameterEstimate::fixed(slot.key(), slot.unit(), f64::NAN);
        return ParameterEstimate { value: model.get(slot), ..fixed };
    }
    if acts(model, slot) {
        let reason = "found by search; its uncertainty is not known";
        return searching(slot, model.get(slot), Reason::Uncertain, reason);
    }
    let reason = "it is not in the torque balance, and the run has no voltage";
    ParameterEstimate::not_observable(&slot.key(), slot.unit(), Reason::SignalMissing, reason)
}

/// Blocks of at least five correlation times of the residual, but never fewer than twenty.
fn blocks(rows: &TorqueRows, residual: &[f64]) -> Vec<usize> {
    let five_s = 5.0 * correlation_time_s(&rows.time_s, residual);
    let block_s = rows.scales.block_s().max(five_s).min(span_s(rows) / SETTINGS.fewest_blocks);
    let block_s = block_s.max(f64::MIN_POSITIVE);
    rows.time_s.iter().map(|time_s| whole((time_s - rows.time_s[0]) / block_s)).collect()
}

/// Integrated correlation time: half of `1 + 2 sum rho`, in seconds; the sum stops where the correlation
/// is within chance.
fn correlation_time_s(time_s: &[f64], values: &[f64]) -> f64 {
    let n = values.len();
    if n < SETTINGS.fewest_correlated_rows {
        return 0.0;
    }
    let chance = 2.0 / (n as f64).sqrt();
    let rho = statistics::autocorrelation(values, n / 4).into_iter();
    let sum: f64 = rho.take_while(|rho| *rho > chance).sum();
    0.5 * statistics::mean_step(time_s) * (1.0 + 2.0 * sum)
}

/// The linear system for given forms.
struct System {
    free: Vec<Slot>,
    /// Whether the column's coefficient may not be negative.
    takes_power: Vec<bool>,
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl System {
    fn new(model: &Model, rows: &TorqueRows) -> Option<Self> {
        let mut right = DVector::from_vec(rows.weighted(rows.left.iter().copied()));
        let (mut free, mut cells, mut takes_power) = (Vec::new(), Vec::new(), Vec::new());
        let at = instants(model, rows);
        for slot in unknowns(model) {
            let column = rows.weighted(column(model, &slot, rows, &at));
            if is_fixed(model, &slot) {
                let value = model.get(&slot).unwrap_or(0.0);
                right.axpy(-value, &DVector::from_vec(column), 1.0);
            } else {
                takes_power.push(takes_power_only(model, &slot));
                cells.extend(column);
                free.push(slot);
            }
        }
        let known = right.iter().chain(&cells).all(|cell| cell.is_finite());
        let columns = cells.len() / rows.rows().max(1);
        (known && rows.rows() > columns).then(|| Self {
            free,
            takes_power,
            matrix: DMatrix::from_vec(rows.rows(), columns, cells),
            right,
        })
    }

    /// Least squares with the dissipative coefficients not negative: the most negative is held at zero until none is left.
    fn solve_bounded(&self) -> Option<DVector<f64>> {
        let columns = self.matrix.ncols();
        let mut inside: Vec<usize> = (0..columns).collect();
        loop {
            let matrix = self.matrix.select_columns(&inside);
            let (bread, _) = least_squares::inverse_where_determined(&matrix);
            let found = bread * matrix.tr_mul(&self.right);
            let share = |place: usize| found[place] * matrix.column(place).norm();
            let most_negative = (0..inside.len())
                .filter(|place| self.takes_power[inside[*place]] && found[*place] < 0.0)
                .min_by(|a, b| share(*a).total_cmp(&share(*b)));
            if let Some(place) = most_negative {
                inside.remove(place);
                continue;
            }
            let mut x = DVector::zeros(columns);
            for (place, column) in inside.iter().enumerate() {
                x[*column] = found[place];
            }
            return x.iter().all(|value| value.is_finite()).then_some(x);
        }
    }

    fn residual(&self, x: &DVector<f64>) -> DVector<f64> {
        &self.right - &self.matrix * x
    }

    fn put(&self, model: &mut Model, x: &DVector<f64>) {
        for (slot, value) in self.free.iter().zip(x.iter()) {
            model.set(slot, *value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint::eligible::why_not;
    use drivebench_identify::weak_form;
    use drivebench_model::plant::{Motor, effect};

    const FRICTION_N_M: f64 = 0.01;

    /// A shaft that never reverses under `w = 30 + 20 sin 3t`, driven by the torque `X / (1 - m q)`: `X` of inertia, Coulomb
    /// and viscous friction, `q` the direction of the power.
    fn geared(inertia_kg_m2: f64, viscous: f64, ratio: f64) -> Scenario {
        let times: Vec<f64> = (0..6000).map(|k| 1e-3 * f64::from(k)).collect();
        let speed = |time_s: f64| 30.0 + 20.0 * (3.0 * time_s).sin();
        let torque = |time_s: f64| {
            // Held from one stamp to the next: the mean of the interval.
            let middle_s = time_s + 5e-4;
            let rate = 60.0 * (3.0 * middle_s).cos();
            let sum = inertia_kg_m2 * rate + FRICTION_N_M + viscous * speed(middle_s);
            sum / (1.0 - ratio * sum.signum())
        };
        let events = times.iter().map(|time_s| (*time_s, torque(*time_s))).collect();
        let speed_rad_s = times.iter().map(|time_s| speed(*time_s)).collect();
        let current_a = vec![f64::NAN; times.len()];
        let run = Scenario::planned("geared", Input::Torque, Channel::Torque, events, times);
        Scenario { current_a, speed_rad_s, ..run }
    }

    fn fitted(run: &Scenario) -> BalanceFit {
        let plain = Model::baseline(Motor::new("geared"));
        let model = plain.with_effect("load_dependent_friction").unwrap();
        fit(&model, &weak_form::torque_rows(&model, run, None).unwrap()).unwrap()
    }

    #[test]
    fn load_dependent_friction_is_found_from_driving_and_braking() {
        for ratio in [0.0, 0.1, 0.3] {
            let run = geared(1e-3, 0.0, ratio);
            let found = fitted(&run);
            let value =
                |key: &str| ParameterEstimate::find(&found.parameters, key).unwrap().value.unwrap();
            let off = value("load_dependent_friction.ratio") - ratio;
            assert!(off.abs() < 0.01, "{ratio}: {off}");
            let inertia = value("inertia_kg_m2");
            assert!((inertia / 1e-3 - 1.0).abs() < 0.02, "{inertia}");
            assert_eq!(why_not(effect::find("load_dependent_friction").unwrap(), &run), None);
        }
    }

    /// A shaft at 20 Hz under torques that step: driven up for .7 s, then braked, which stops it within a few rows.
    fn stepped(ratio: f64) -> Scenario {
        let inertia = 2.7e-4;
        let rate = |torque: f64, way: f64| {
            // The torque `X / (1 - m q)` as above.
            let power = (torque * way).signum();
            (torque * (1.0 - ratio * power) - 0.017 * way) / inertia
        };
        let (mut events, mut times, mut speeds) = (Vec::new(), Vec::new(), Vec::new());
        let (mut speed, mut way, mut stands) = (0.0_f64, 1.0, true);
        for step in 0..40_000_u32 {
            let time_s = 5e-4 * f64::from(step);
            let (period, in_period) = (step / 2000, step % 2000);
            let drive = if period % 4 < 2 { 0.029 } else { 0.045 };
            if in_period == 0 {
                (way, stands) = (-way, true);
                events.push((time_s, way * drive));
            } else if in_period == 1400 {
                events.push((time_s, -way * drive));
            }
            if step % 100 == 3 {
                times.push(time_s);
                speeds.push(speed);
            }
            let driving = if in_period < 1400 { way * drive } else { -way * drive };
            let next = speed + 5e-4 * rate(driving, if stands { way } else { speed.signum() });
            // It rests from the end of the braking to the next step.
            let stops = !stands && next * speed <= 0.0;
            speed = if stops || (in_period >= 1400 && speed == 0.0) { 0.0 } else { next };
            stands = speed == 0.0;
        }
        let steps_s = events.iter().skip(1).map(|event| event.0).collect();
        let current_a = vec![f64::NAN; times.len()];
        let run = Scenario::planned("stepped", Input::Torque, Channel::Torque, events, times);
        let mut run = Scenario { current_a, speed_rad_s: speeds, current_steps_s: steps_s, ..run };
        run.find_scales();
        run
    }

    #[test]
    fn the_few_rows_in_which_a_shaft_is_braked_count() {
        for ratio in [0.0, 0.05, 0.2] {
            let found = fitted(&stepped(ratio));
            let value =
                |key: &str| ParameterEstimate::find(&found.parameters, key).unwrap().value.unwrap();
            let off = value("load_dependent_friction.ratio") - ratio;
            assert!(off.abs() < 0.005, "{ratio}: {off}");
            assert!((value("inertia_kg_m2") / 2.7e-4 - 1.0).abs() < 0.01);
        }
    }

    #[test]
    fn all_runs_have_windows_of_one_kind() {
        let (braked, turning) = (stepped(0.05), geared(2.7e-4, 0.0, 0.05));
        let kinds = |runs: [&Scenario; 2]| {
            let [fitted, holdout] = runs.map(Clone::clone);
            let evidence = Evidence::new(fitted, Some(holdout), None);
            let model = Model::baseline(Motor::new("geared"));
            let sides = Sides::weak_form(&model, &evidence).unwrap();
            [sides.training, sides.holdout].map(|rows| rows.spans.is_empty())
        };
        assert_eq!(kinds([&braked, &turning]), [false; 2]);
        assert_eq!(kinds([&turning, &braked]), [false; 2]);
        assert_eq!(kinds([&turning, &turning]), [true; 2]);
    }

    #[test]
    fn one_direction_of_power_does_not_determine_load_dependent_friction() {
        // The inertia is too small to drive the shaft against its friction.
        let run = geared(1e-5, 4e-4, 0.0);
        assert!(why_not(effect::find("load_dependent_friction").unwrap(), &run).is_some());
        // Its column is not the measured torque: the viscous part stays unexplained.
        let found = fitted(&run);
        assert!(found.rms_n_m > 1e-3, "{}", found.rms_n_m);
    }

    #[test]
    fn only_effects_of_the_current_depend_on_the_drive() {
        let of_drive = |id: &str| depends_on_drive(effect::find(id).unwrap());
        for id in ["load_dependent_friction", "torque_ripple"] {
            assert!(of_drive(id), "{id}");
        }
        for id in ["viscous_friction", "quadratic_load", "cogging", "stribeck_friction"] {
            assert!(!of_drive(id), "{id}");
        }
    }
}

//! The weighted residual of a free run as a function of the scaled free parameters.

use std::sync::{Mutex, PoisonError};

use super::{FitError, cannot_simulate};
use crate::noise::NoiseFloor;
use crate::stamps;
use drivebench_model::numerics::levenberg_marquardt::Problem;
use drivebench_model::numerics::statistics;
use drivebench_model::plant::{
    Input, Model, ModelError, MotorKey, Plant, Scenario, Slot, State, Trajectory, motor_range,
    typical_size,
};

/// Transformation between a parameter and its scaled coordinate.
#[derive(Clone, Copy, Debug)]
enum Scaling {
    /// `p = exp(x)`, between two bounds on `p`.
    Logarithm { min: f64, max: f64 },
    /// `p = scale * x`.
    Linear { scale: f64, min: f64, max: f64 },
}

impl Scaling {
    fn of(slot: &Slot, model: &Model, scenario: &Scenario) -> Self {
        match slot {
            Slot::Motor(key) => {
                let (min, max) = motor_range(*key, model, scenario);
                Self::Logarithm { min, max }
            }
            Slot::Effect { spec, index, parameter, .. } => {
                let range = spec.in_run(&scenario.scales);
                let (min, max, effect) = (range.min, range.max, model.effects[*index].effect);
                let scale = match (spec.logarithmic, spec.is_coefficient()) {
                    (true, _) => return Self::Logarithm { min, max },
                    (false, true) => typical_size(effect, *parameter, model, scenario),
                    (false, false) => range.scale,
                };
                Self::Linear { scale, min, max }
            }
        }
    }

    fn to_x(self, value: f64) -> f64 {
        match self {
            Self::Logarithm { min, max } => value.clamp(min, max).ln(),
            Self::Linear { scale, .. } => value / scale,
        }
    }

    fn to_value(self, x: f64) -> f64 {
        match self {
            Self::Logarithm { .. } => x.exp(),
            Self::Linear { scale, .. } => x * scale,
        }
    }

    fn clamp(self, x: f64) -> f64 {
        match self {
            Self::Logarithm { min, max } => x.clamp(min.ln(), max.ln()),
            Self::Linear { scale, min, max } => x.clamp(min / scale, max / scale),
        }
    }
}

/// Free run of a model over a scenario, as a least-squares problem.
pub struct FreeRun<'a> {
    model: Model,
    scenario: &'a Scenario,
    noise: NoiseFloor,
    free: Vec<Slot>,
    scaling: Vec<Scaling>,
    /// Whether initial current and speed are two more unknowns.
    start_is_free: bool,
    measured_start: State,
    /// States of effects whose initial values are unknowns too; none while fitting, because a fit defines the state
    /// at its own start as zero (the resistance is that of the winding as it was then).
    effect_states: usize,
    /// Which scored samples enter: `(sample, is_speed)`, in the order of time.
    rows: Vec<(usize, bool)>,
    /// Sub-steps of the simulation are at least this long, s; zero: as short as its effects ask for.
    coarse_s: f64,
    /// Memory of simulations that are over, for the next ones: as much as there are threads at work on this problem.
    spare: Mutex<Vec<Trajectory>>,
}

impl<'a> FreeRun<'a> {
    pub fn new(model: &Model, scenario: &'a Scenario, noise: NoiseFloor) -> Result<Self, FitError> {
        let mut model = model.clone();
        for slot in model.slots() {
            match (&slot, model.get(&slot)) {
                (Slot::Effect { index, parameter, .. }, None) => {
                    let effect = model.effects[*index].effect;
                    model.set(&slot, typical_size(effect, *parameter, &model, scenario));
                }
                (Slot::Motor(MotorKey::LoadTorque), Some(value))
                    if !model.fixed.contains(&slot.key()) =>
                {
                    model.set(&slot, value.max(smallest_load_n_m(&model, scenario)));
                }
                _ => {}
            }
        }
        model.require_complete()?;
        let is_measured = |(sample, is_speed): &(usize, bool)| {
            let (values, level) = measured(scenario, &noise, *is_speed);
            values[*sample].is_finite() && level.is_finite()
        };
        let rows = (scenario.scored.clone()).flat_map(|sample| [(sample, false), (sample, true)]);
        let rows: Vec<(usize, bool)> = rows.filter(is_measured).collect();
        if rows.is_empty() {
            return Err(FitError::NothingMeasured { run: scenario.name.clone() });
        }
        let free = model.free_slots();
        let measured_start =
            State::at(first_finite(&scenario.current_a), first_finite(&scenario.speed_rad_s));
        Ok(Self {
            scaling: free.iter().map(|slot| Scaling::of(slot, &model, scenario)).collect(),
            start_is_free: !starts_at_rest(scenario, &noise),
            measured_start,
            effect_states: 0,
            model,
            scenario,
            noise,
            free,
            rows,
            coarse_s: 0.0,
            spare: Mutex::default(),
        })
    }

    /// In coarse sub-steps, see [`Plant::coarse`].
    #[must_use]
    pub const fn coarse(mut self, step_s: f64) -> Self {
        self.coarse_s = step_s;
        self
    }

    /// Lets the states of effects start anywhere: in another run than the fitted one the winding may be warm already.
    pub fn with_free_effect_states(mut self) -> Result<Self, FitError> {
        self.effect_states = Plant::new(&self.model, self.scenario.input)?.effect_states();
        Ok(self)
    }

    pub fn free_slots(&self) -> &[Slot] {
        &self.free
    }

    /// `(sample, is_speed)` of every residual, in order.
    pub fn rows(&self) -> &[(usize, bool)] {
        &self.rows
    }

    /// All residuals at `x`.
    pub fn residuals(&self, x: &[f64]) -> Result<Vec<f64>, FitError> {
        let mut out = vec![0.0; self.residual_len()];
        self.residual(x, &mut out).then_some(out).ok_or_else(|| cannot_simulate(self.scenario))
    }

    /// Coordinates of the model as it is.
    pub fn start(&self) -> Vec<f64> {
        let value = |slot: &Slot| self.model.get(slot).unwrap_or(f64::NAN);
        let free = self.free.iter().zip(&self.scaling);
        let mut x: Vec<f64> = free.map(|(slot, scaling)| scaling.to_x(value(slot))).collect();
        if self.start_is_free {
            let (start, scale) = (&self.measured_start, self.start_scale());
            x.extend([start.current_a / scale.0, start.speed_rad_s / scale.1]);
        }
        x.extend(std::iter::repeat_n(0.0, self.effect_states));
        x
    }

    pub fn model_at(&self, x: &[f64]) -> Model {
        let mut model = self.model.clone();
        for ((slot, scaling), x) in self.free.iter().zip(&self.scaling).zip(x) {
            model.set(slot, scaling.to_value(*x));
        }
        model
    }

    /// d(parameter)/dx of the free parameters at `x`.
    pub fn slopes(&self, x: &[f64]) -> Vec<f64> {
        let free = self.scaling.iter().zip(x);
        free.map(|(scaling, x)| match scaling {
            Scaling::Logarithm { .. } => x.exp(),
            Scaling::Linear { scale, .. } => *scale,
        })
        .collect()
    }

    pub fn initial_state(&self, x: &[f64]) -> State {
        let mut own = &x[self.free.len()..];
        let mut state = State::default();
        if self.start_is_free {
            let scale = self.start_scale();
            state = State::at(own[0] * scale.0, own[1] * scale.1);
            own = &own[2..];
        }
        // Heat in a winding, A2.s: some per cent of what the largest current would give it in the whole run.
        let scales = &self.scenario.scales;
        let heat = 0.04 * scales.current_a.powi(2) * scales.length_s;
        let effects: Vec<f64> = own.iter().map(|x| x * heat).collect();
        state.with_effects(&effects)
    }

    /// Reason for which no parameter is observable: the residual is as large as every signal, at constant speed, or with a model that
    /// does not describe the signals.
    pub(crate) fn why_still(&self, residual: &[f64]) -> Option<String> {
        let share = |speed: bool| -> Option<(f64, bool)> {
            let (values, level) = measured(self.scenario, &self.noise, speed);
            let rows = self.rows.iter().zip(residual);
            let (signal, left): (Vec<f64>, Vec<f64>) = rows
                .filter(|((_, is_speed), _)| *is_speed == speed)
                .map(|((sample, _), residual)| (values[*sample], residual * level))
                .unzip();
            let spread = statistics::variance(&signal);
            let changes = statistics::is_coloured(&signal)
                && spread.sqrt() > 0.1 * statistics::mean(&signal).abs();
            (signal.len() > 2).then(|| (statistics::variance(&left) / spread, changes))
        };
        let shares: Vec<(f64, bool)> = [false, true].into_iter().filter_map(share).collect();
        let least = (shares.iter()).fold(f64::INFINITY, |least, share| least.min(share.0));
        let explained = 100.0 * (1.0 - least).max(0.0);
        let why = if shares.iter().any(|share| share.1) {
            ": its free run does not follow them; check columns, units and the input"
        } else {
            ", the rest is noise: the run is a steady state"
        };
        (least > 0.8).then(|| {
            format!("the model explains {explained:.0} % of the variation of the signals{why}")
        })
    }

    pub fn trajectory(&self, x: &[f64]) -> Result<Trajectory, FitError> {
        let start = self.initial_state(x);
        Ok(self.plant(x)?.simulate(self.scenario, start))
    }

    fn plant(&self, x: &[f64]) -> Result<Plant, ModelError> {
        Ok(Plant::new(&self.model_at(x), self.scenario.input)?.coarse(self.coarse_s))
    }

    /// Units in which the initial state is fitted; the scales of the run without a measurement.
    fn start_scale(&self) -> (f64, f64) {
        let unit = |noise: f64, scale: f64| {
            if noise.is_finite() { 10.0 * noise } else { scale }
        };
        let scales = &self.scenario.scales;
        let speed = unit(self.noise.speed_rad_s, 0.1 * scales.speed_rad_s);
        (unit(self.noise.current_a, scales.current_a), speed)
    }
}

/// A signal with its noise.
fn measured<'a>(scenario: &'a Scenario, noise: &NoiseFloor, is_speed: bool) -> (&'a [f64], f64) {
    if is_speed {
        (&scenario.speed_rad_s, noise.speed_rad_s)
    } else {
        (&scenario.current_a, noise.current_a)
    }
}

/// Error of a simulation at a measurement over the noise; the row is `(sample, is_speed)`. The noise is that of the sensor and that
/// of the stamp.
pub fn weighted_residual(
    (sample, is_speed): (usize, bool),
    simulated: &Trajectory,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> f64 {
    let (measured, level) = measured(scenario, noise, is_speed);
    let simulated = if is_speed { &simulated.speed_rad_s } else { &simulated.current_a };
    let error = simulated[sample] - measured[sample];
    error / level.hypot(stamps::spread(scenario, measured, sample))
}

impl Problem for FreeRun<'_> {
    fn residual(&self, x: &[f64], out: &mut [f64]) -> bool {
        let start = self.initial_state(x);
        let Ok(mut plant) = self.plant(x) else { return false };
        let spare = || self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let mut simulated = spare().pop().unwrap_or_default();
        plant.simulate_into(self.scenario, start, &mut simulated);
        for (cell, row) in out.iter_mut().zip(&self.rows) {
            *cell = weighted_residual(*row, &simulated, self.scenario, &self.noise);
        }
        spare().push(simulated);
        out.iter().all(|value| value.is_finite())
    }

    fn residual_len(&self) -> usize {
        self.rows.len()
    }

    fn difference_step(&self, index: usize) -> f64 {
        match self.scaling.get(index) {
            Some(Scaling::Logarithm { .. }) => 2e-3,
            _ => 1e-2,
        }
    }

    fn clamp(&self, x: &mut [f64]) {
        for (x, scaling) in x.iter_mut().zip(&self.scaling) {
            *x = scaling.clamp(*x);
        }
    }
}

/// Start of a Coulomb torque that was given as zero, whose logarithm does not exist: a millionth of the torque of the largest
/// input, which no sensor resolves.
fn smallest_load_n_m(model: &Model, scenario: &Scenario) -> f64 {
    let inputs: Vec<f64> = scenario.events.iter().map(|event| event.1).collect();
    let kt = model.motor.torque_constant().unwrap_or(1.0);
    let per_unit = match scenario.input {
        Input::Voltage => kt / model.motor.get(MotorKey::Resistance).unwrap_or(1.0),
        Input::Current => kt,
        Input::Torque => 1.0,
    };
    let driven = 1e-6 * per_unit.abs() * statistics::largest(&inputs);
    driven.max(f64::MIN_POSITIVE)
}

fn first_finite(values: &[f64]) -> f64 {
    values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0)
}

/// At rest: the first speeds are zero within their noise while the input is still zero, or the run begins with both
/// signals within the noise of zero.
fn starts_at_rest(scenario: &Scenario, noise: &NoiseFloor) -> bool {
    let leading = scenario.leading_standstill();
    let begin = leading.start.min(scenario.samples());
    let end = leading.end.clamp(begin + 1, begin + 20);
    let first = begin..end.min(scenario.samples());
    let quiet = |values: &[f64], level: f64| {
        // A missing value is not above.
        !level.is_finite() || !values[first.clone()].iter().any(|value| value.abs() > 6.0 * level)
    };
    quiet(&scenario.speed_rad_s, noise.speed_rad_s)
        && (!leading.is_empty() || quiet(&scenario.current_a, noise.current_a))
}

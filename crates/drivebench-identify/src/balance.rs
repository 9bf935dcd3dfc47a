//! Both balances as linear regressions: their unknowns, what each contributes at a sample, and rows open to any term.
//!
//! ```text
//! Model, Balance --unknowns--> Slot by Slot --Signals::column--> values or rates at the samples --> weak_form: means
//!                                                                                  inverse_dynamics: both sides filtered
//! Scenario --(weak_form | inverse_dynamics: torque_rows)--> TorqueRows: left side, inertia's column, where the machine was
//!                                  any term at the samples --column--> its column beside them
//! ```
//!
//! Torque: `T = J <w'> + sum of coefficient x <term>`. Which terms stand on the right of [`TorqueRows`] is the caller's:
//! the diagnosis puts one candidate effect after the other beside the same rows, so what costs time is done once.

use drivebench_model::plant::effect::Sums;
use drivebench_model::plant::{
    ActiveEffect, Balance, Input, Instant, Model, Motor, MotorKey, Scenario, Slot,
};
use drivebench_model::sample::ParameterEstimate;
use drivebench_model::text::number::with_std;

/// Why an effect is no term of a balance that is linear in its coefficients, or `None` where it is one. `electrical`: there
/// is a voltage balance.
pub(super) fn why_no_regressor(
    active: &ActiveEffect,
    motor: &Motor,
    electrical: bool,
) -> Option<&'static str> {
    let of_size = |size: f64| {
        let mut values = active.values_or_guess();
        for (value, spec) in values.iter_mut().zip(active.effect.parameters()) {
            if spec.is_coefficient() {
                *value = size;
            }
        }
        active.effect.terms(&values)
    };
    let terms = of_size(1.0);
    if let Some(why) = terms.why_no_term() {
        return Some(why);
    }
    if !electrical && !active.effect.card().enters.includes(Balance::Torque) {
        return Some("it enters the voltage balance, and there is no voltage");
    }
    let somewhere = Instant {
        voltage_v: 1.0,
        supply_v: 1.0,
        current_a: 1.0,
        speed_rad_s: 1.0,
        ..Instant::of(motor)
    };
    let mut later = somewhere;
    later.time_s = f64::MAX;
    if terms.inertia_gain(&later) != 0.0 {
        return Some("it changes the inertia, which the balance takes as constant");
    }
    let sums = terms.sums(&somewhere, &[]);
    if sums.current_rate_gain != 0.0 {
        return Some("it changes the inductance, which the balance takes as constant");
    }
    let parts = |sums: &Sums| {
        let voltage_v = if electrical { sums.voltage_v } else { 0.0 };
        [voltage_v, sums.torque_n_m, sums.friction_n_m]
    };
    let (once, twice) = (parts(&sums), parts(&of_size(2.0).sums(&somewhere, &[])));
    if once.iter().any(|term| !term.is_finite()) {
        return Some("its terms need motor constants that the model does not give");
    }
    let proportional = |(one, two): (&f64, &f64)| (two - 2.0 * one).abs() <= 1e-9 * one.abs();
    (!once.iter().zip(&twice).all(proportional))
        .then_some("it is not proportional to its coefficient")
}

/// A parameter that enters a balance linearly, with its value where that is fixed.
pub(super) struct Unknown {
    pub(super) slot: Slot,
    pub(super) fixed: Option<f64>,
}

impl Unknown {
    /// The estimate of one that is fixed, else why there is none.
    pub(super) fn unsolved(&self, reason: &str) -> ParameterEstimate {
        let (key, unit) = (self.slot.key(), self.slot.unit());
        match self.fixed {
            Some(value) => ParameterEstimate::fixed(key, unit, value),
            None => ParameterEstimate::not_observable(&key, unit, reason),
        }
    }
}

/// The motor's parameters in a balance, and the coefficients of every effect in it that is `carried`.
pub(super) fn unknowns(
    model: &Model,
    scenario: &Scenario,
    equation: Balance,
    carried: impl Fn(&ActiveEffect) -> bool,
) -> Vec<Unknown> {
    let keys: &[MotorKey] = match equation {
        Balance::Voltage => &[MotorKey::Resistance, MotorKey::Inductance, MotorKey::BackEmf],
        Balance::Torque => &[MotorKey::Inertia, MotorKey::LoadTorque],
    };
    let driven = equation == Balance::Torque || scenario.input == Input::Voltage;
    let enters = |slot: &Slot| match slot {
        Slot::Effect { index, spec, .. } => {
            let active = &model.effects[*index];
            let enters = active.effect.card().enters.includes(equation);
            enters && spec.is_coefficient() && driven && carried(active)
        }
        Slot::Motor(_) => false,
    };
    let motor = keys.iter().map(|key| Slot::Motor(*key));
    motor
        .chain(model.slots().into_iter().filter(enters))
        .map(|slot| {
            let is_fixed = model.fixed.contains(&slot.key());
            let fixed = model.get(&slot).filter(|_| is_fixed);
            Unknown { slot, fixed }
        })
        .collect()
}

/// Signals of one balance at the samples.
pub(super) struct Signals<'a> {
    pub(super) model: &'a Model,
    pub(super) equation: Balance,
    pub(super) current_a: &'a [f64],
    pub(super) speed_rad_s: &'a [f64],
    /// Where the machine was at a sample, for the terms of effects.
    pub(super) at: &'a dyn Fn(usize) -> Instant,
}

/// What one unit of an unknown contributes at each sample.
pub(super) enum Column {
    Values(Vec<f64>),
    /// The signal of which the rate counts.
    Rate(Vec<f64>),
}

impl Signals<'_> {
    pub(super) fn column(&self, slot: &Slot) -> Column {
        let speeds = self.speed_rad_s;
        match *slot {
            Slot::Motor(MotorKey::Resistance) => Column::Values(self.current_a.to_vec()),
            Slot::Motor(MotorKey::Inductance) => Column::Rate(self.current_a.to_vec()),
            Slot::Motor(MotorKey::BackEmf) => Column::Values(speeds.to_vec()),
            Slot::Motor(MotorKey::Inertia) => Column::Rate(speeds.to_vec()),
            Slot::Motor(MotorKey::LoadTorque) => {
                Column::Values(speeds.iter().map(|speed| speed.signum()).collect())
            }
            Slot::Motor(MotorKey::TorqueConstant) => Column::Values(vec![f64::NAN; speeds.len()]),
            Slot::Effect { index, parameter, .. } => {
                Column::Values(self.effect(&self.model.effects[index], parameter))
            }
        }
    }

    /// What the effect's coefficient adds per unit, of a size so small that the effect is proportional to it; its shape
    /// parameters stay as they are given.
    fn effect(&self, active: &ActiveEffect, parameter: usize) -> Vec<f64> {
        let specs = active.effect.parameters();
        let mut values = active.values_or_guess();
        let size = 1e-4 * specs[parameter].scale;
        for (other, spec) in specs.iter().enumerate() {
            if spec.is_coefficient() {
                values[other] = if other == parameter { size } else { 0.0 };
            }
        }
        let terms = active.effect.terms(&values);
        let own = vec![0.0; terms.states()];
        let added = |(sample, speed): (usize, &f64)| {
            let at = (self.at)(sample);
            match self.equation {
                Balance::Voltage => terms.voltage_v(&at, &own),
                Balance::Torque => {
                    terms.torque_n_m(&at, &own) + speed.signum() * terms.friction_n_m(&at)
                }
            }
        };
        let speeds = self.speed_rad_s.iter().enumerate();
        speeds.map(|at| added(at) / size).collect()
    }
}

/// Puts the values of one balance into the model of the next; the relative standard deviation of its torque constant.
pub(super) fn hand_on(model: &mut Model, found: &[ParameterEstimate]) -> f64 {
    let given = model.motor.get(MotorKey::TorqueConstant).is_some();
    let mut doubt_of_torque = 0.0;
    for estimate in found {
        if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), estimate.value) {
            model.motor.set(key, value);
            if key == MotorKey::BackEmf && !given {
                doubt_of_torque = estimate.std.unwrap_or(0.0) / value.abs();
            }
        }
    }
    doubt_of_torque
}

/// Whether current is all that drives this run, with nothing to turn it into torque: everything is a ratio to it.
pub(super) fn lacks_torque_constant(model: &Model, scenario: &Scenario) -> bool {
    scenario.input == Input::Current && model.motor.torque_constant().is_none()
}

/// A value in units of the unknown torque constant: the ratio stands in the reason, but it is not the parameter.
pub(super) fn as_ratio(found: ParameterEstimate) -> ParameterEstimate {
    let (Some(value), Some(std)) = (found.value, found.std) else {
        return found;
    };
    let reason = format!(
        "known only relative to the torque constant: {} {} per N.m/A; give torque_n_m_per_a or \
         back_emf_v_s_per_rad, or run once more with a known added inertia",
        with_std(value, std),
        found.unit
    );
    ParameterEstimate::not_observable(&found.key, found.unit, reason)
}

/// How the rows of a torque balance came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Averaged over windows with a smooth test function, nothing differentiated.
    WeakForm,
    /// Differentiated and low-passed on both sides: the field's reference (Janot, Gautier and Brunot 2019).
    InverseDynamics,
}

/// Turns the values of a term at the samples into its column.
pub(super) type Averaging = Box<dyn Fn(&[f64]) -> Vec<f64> + Send + Sync>;

/// Rows of the torque balance over the scored part of one run.
pub struct TorqueRows {
    pub method: Method,
    /// What was done, for the reader.
    pub sentence: String,
    /// Where the machine was at each sample: terms are evaluated there. Under a given torque the current is that torque
    /// and the torque constant one, as in the simulation.
    pub at: Vec<Instant>,
    /// The run's first command, on the run's clock: times of events count from there.
    pub begin_s: f64,
    /// Middle of each row, on the run's clock.
    pub time_s: Vec<f64>,
    /// Motor torque, N.m.
    pub left: Vec<f64>,
    /// What one unit of inertia contributes.
    pub inertia: Vec<f64>,
    /// Norms of a row's weights and of its weights for a rate: what white noise makes of a mean and of a rate; not a
    /// number where they are not known.
    pub gain: f64,
    pub rate_gain: f64,
    /// Length of one row's window (or of the filter's memory), s.
    pub span_s: f64,
    pub(super) averaging: Averaging,
}

impl TorqueRows {
    pub fn rows(&self) -> usize {
        self.left.len()
    }

    /// The column of a term with these values at the samples; not a number in rows that touch a missing value.
    pub fn column(&self, at_samples: &[f64]) -> Vec<f64> {
        (self.averaging)(at_samples)
    }
}

/// First and last instant of the scored samples.
pub(super) fn scored_s(scenario: &Scenario) -> Option<(f64, f64)> {
    let times = &scenario.sample_time_s;
    let last = scenario.scored.end.checked_sub(1)?;
    Some((*times.get(scenario.scored.start)?, *times.get(last)?))
}

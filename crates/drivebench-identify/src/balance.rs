//! Voltage and torque balance as linear regressions (Ljung 1999, section 4.2): unknowns, regressors, and rows to which the
//! column of any term can be added.
//!
//! ```text
//! Model, Balance --unknowns--> Slot by Slot --Signals::column--> values or rates at the samples --> weak_form: means
//!                                                                                  inverse_dynamics: both sides filtered
//! Scenario --(weak_form | inverse_dynamics: torque_rows)--> TorqueRows: left side, inertia's column, instants of the samples
//!                                  any term at the samples --column--> its column
//! ```
//!
//! Torque: `T = J <w'> + sum of coefficient x <term>`. The caller of [`TorqueRows`] chooses the terms: the diagnosis tries one
//! candidate effect after the other with the same rows.

use super::inverse_dynamics::Processing;
use drivebench_model::findings;
use drivebench_model::plant::effect::Sums;
use drivebench_model::plant::{
    ActiveEffect, Balance, Input, Instant, Model, Motor, MotorKey, RunScales, Scenario, Slot,
};
use drivebench_model::sample::{ParameterEstimate, Reason};
use drivebench_model::text::number::with_std;

/// The reason why an effect is not a term of a balance that is linear in its coefficients; `None` where it is one.
/// `electrical`: there is a voltage balance.
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
    if let Some(reason) = terms.why_no_term() {
        return Some(reason);
    }
    if !electrical && !active.effect.card().enters.includes(Balance::Torque) {
        return Some("it enters the voltage balance, and there is no voltage");
    }
    let ones = Instant {
        voltage_v: 1.0,
        supply_v: 1.0,
        current_a: 1.0,
        speed_rad_s: 1.0,
        ..Instant::of(motor)
    };
    let after_events = Instant { time_s: f64::MAX, ..ones };
    if terms.inertia_gain(&after_events) != 0.0 {
        return Some("it changes the inertia, which the balance takes as constant");
    }
    let sums = terms.sums(&ones, &[]);
    if sums.current_rate_gain != 0.0 {
        return Some("it changes the inductance, which the balance takes as constant");
    }
    let parts = |sums: &Sums| {
        let voltage_v = if electrical { sums.voltage_v } else { 0.0 };
        [voltage_v, sums.torque_n_m, sums.friction_n_m]
    };
    let (once, twice) = (parts(&sums), parts(&of_size(2.0).sums(&ones, &[])));
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
            None => ParameterEstimate::not_observable(&key, unit, Reason::NotExcited, reason),
        }
    }
}

/// The motor's parameters in a balance, and the coefficients of the effects in it that satisfy `is_regressor`.
pub(super) fn unknowns(
    model: &Model,
    scenario: &Scenario,
    equation: Balance,
    is_regressor: impl Fn(&ActiveEffect) -> bool,
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
            enters && spec.is_coefficient() && driven && is_regressor(active)
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

pub(super) struct Signals<'a> {
    pub(super) model: &'a Model,
    pub(super) equation: Balance,
    pub(super) current_a: &'a [f64],
    pub(super) speed_rad_s: &'a [f64],
    /// Instant at a sample, for the terms of effects.
    pub(super) at: &'a dyn Fn(usize) -> Instant,
}

/// Regressor of an unknown at the samples.
pub(super) enum Column {
    Values(Vec<f64>),
    /// The signal whose time derivative is the regressor.
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

    /// The effect per unit of its coefficient, at a small size at which it is proportional to it, with the given shape
    /// parameters.
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
        self.speed_rad_s.iter().enumerate().map(|at| added(at) / size).collect()
    }
}

/// Sets the motor of the model to the values of one balance for the next; returns the relative standard deviation of its torque
/// constant.
pub(super) fn set_motor(model: &mut Model, found: &[ParameterEstimate]) -> f64 {
    let is_given = model.motor.get(MotorKey::TorqueConstant).is_some();
    let mut torque_deviation = 0.0;
    for estimate in found {
        if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), estimate.value) {
            model.motor.set(key, value);
            if key == MotorKey::BackEmf && !is_given {
                torque_deviation = estimate.std.unwrap_or(0.0) / value.abs();
            }
        }
    }
    torque_deviation
}

/// Whether the input is a current without a torque constant, so that only ratios to that are observable.
pub(super) fn lacks_torque_constant(model: &Model, scenario: &Scenario) -> bool {
    scenario.input == Input::Current && model.motor.torque_constant().is_none()
}

/// Not observable, with the ratio to the unknown torque constant in the reason.
pub(super) fn as_ratio(found: ParameterEstimate) -> ParameterEstimate {
    let (Some(value), Some(std)) = (found.value, found.std) else { return found };
    let reason = format!(
        "known only relative to the torque constant: {} {} per N.m/A; give torque_n_m_per_a or \
         back_emf_v_s_per_rad, or run once more with a known added inertia",
        with_std(value, std),
        found.unit
    );
    let code = Reason::DependsOnAnother;
    ParameterEstimate::not_observable(&found.key, found.unit, code, reason)
}

/// Whether the motor both drives its load and is driven by it, from the energy of each interval, J. With friction `m |T| sgn(w)` the
/// balance is `T = X / (1 - m)` while it drives and `T = X / (1 + m)` while it brakes, `X` being all other torques: one of the two
/// alone does not determine m.
pub fn has_both_power_flows(energies_j: impl Iterator<Item = f64>) -> bool {
    let known = energies_j.filter(|energy_j| energy_j.is_finite());
    let (driving, braking) = known.fold((0.0, 0.0), |(driving, braking), energy_j| {
        (driving + energy_j.max(0.0), braking - energy_j.min(0.0))
    });
    // Less is the noise about a reversal.
    braking > 0.03 * (driving + braking)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Averaged over windows with a smooth test function, without differentiation.
    WeakForm,
    /// Differentiated and low-passed on both sides: the reference method for robots (Janot, Gautier and Brunot 2019).
    InverseDynamics,
}

findings! {
    /// How the rows of a torque balance came about, with its settings.
    #[derive(Clone, Debug, PartialEq)]
    pub enum Derivation {
        WeakForm { window_s: f64, dead_zone_rad_s: f64 } = "weak_form",
        /// Integrals over at most `most_s` between the steps of a commanded current.
        BetweenSteps { most_s: f64, dead_zone_rad_s: f64 } = "integrals_between_steps",
        /// With a second low pass, as for one row in `one_in`.
        InverseDynamics { processing: Box<Processing>, then_hz: f64, one_in: usize } = "inverse_dynamics",
    }
}

/// Turns the values of a term at the samples into its column.
pub(super) type Averaging = Box<dyn Fn(&[f64]) -> Vec<f64> + Send + Sync>;

/// Rows of the torque balance over the scored part of one run.
pub struct TorqueRows {
    pub method: Method,
    pub derivation: Derivation,
    /// Instants of the samples, for the terms. Under a given torque the current is that torque and the torque constant one, as in
    /// the simulation.
    pub at: Vec<Instant>,
    /// The run's first command, on the run's clock: times of events count from there.
    pub begin_s: f64,
    pub scales: RunScales,
    /// Middle of each row, on the run's clock.
    pub time_s: Vec<f64>,
    /// Motor torque, N.m.
    pub left: Vec<f64>,
    /// First and last sample of each row that is an integral over a window of its own length, divided by `span_s`; else empty.
    pub spans: Vec<(usize, usize)>,
    /// Regressor of the inertia.
    pub inertia: Vec<f64>,
    /// Standard deviations of a mean and of a mean rate under white noise of unit variance: the norms of the weights of a row; NaN
    /// where they are not known.
    pub gain: f64,
    pub rate_gain: f64,
    /// Length of one row's window (or of the filter's memory), s.
    pub span_s: f64,
    /// Weights of the rows, 1 at most; empty where all are 1.
    pub(super) weights: Vec<f64>,
    pub(super) averaging: Averaging,
}

impl TorqueRows {
    pub fn rows(&self) -> usize {
        self.left.len()
    }

    /// Length of the window of a row over the usual one.
    pub fn share(&self, row: usize) -> f64 {
        let length_s =
            |(begin, end): &(usize, usize)| self.at[*end].time_s - self.at[*begin].time_s;
        self.spans.get(row).map_or(1.0, |span| length_s(span) / self.span_s)
    }

    /// Values of the rows, each times its weight.
    pub fn weighted(&self, values: impl IntoIterator<Item = f64>) -> Vec<f64> {
        let weights = self.weights.iter().copied().chain(std::iter::repeat(1.0));
        values.into_iter().zip(weights).map(|(value, weight)| value * weight).collect()
    }

    /// What the predicted torque leaves in each row, N.m, times its weight.
    pub fn residual(&self, predicted: &[f64]) -> Vec<f64> {
        self.weighted(self.left.iter().zip(predicted).map(|(left, predicted)| left - predicted))
    }

    /// The column of a term with these values at the samples; NaN in rows with a missing value.
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

//! State-space model from actuator to speed near a working point: two states on a rigid shaft, four behind a coupling.
//!
//! ```text
//! u -> current or lag -> motor's speed <--[ coupling: twist ]--> load's speed
//! ```
//!
//! Rules tune on the rigid plant, which has all of the inertia on the motor's shaft; margins are those of all states.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use thiserror::Error;

use super::Actuator;
use drivebench_model::plant::effect::{TermKind, VISCOUS_SLOPE as VISCOUS};
use drivebench_model::plant::{Coupling, Model, MotorKey};

/// Most states of a plant.
pub(super) const STATES: usize = 4;

/// `dx/dt = A x + b u`, speed = `x[1]`.
///
/// Voltage drive: `x` is current and speed. Current drive: the drive's current loop is a lag.
/// Speed drive: the drive's own speed loop is two lags. Behind a coupling the load's speed follows, and the twist.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearPlant {
    pub actuator: Actuator,
    a: Matrix2<f64>,
    b: Vector2<f64>,
    coupling: Option<Coupling>,
}

/// Two real time constants: `gain / ((1 + large s)(1 + small s))`, or an integrator where nothing brakes the shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Dominant {
    /// Slope of the unit step response after the small time constant, rad/s^2 per unit.
    pub(super) rate: f64,
    /// Large time constant, s; `None`: an integrator.
    pub(super) large_s: Option<f64>,
    pub(super) small_s: f64,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum PlantError {
    #[error("{key} is missing in the model (needed for a speed loop over {actuator})")]
    Missing { key: &'static str, actuator: &'static str },
    #[error("{key} = {value} is not physical (allowed: a finite value above 0)")]
    NotPhysical { key: &'static str, value: f64 },
    #[error("{VISCOUS} = {0} is not physical: it drives the shaft (allowed: 0 or more)")]
    Drives(f64),
    #[error("{effect}.{key} = {value} is not physical (allowed: {allowed})")]
    Outside { effect: &'static str, key: &'static str, value: f64, allowed: String },
}

impl PlantError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Missing { .. } => {
                "identify the motor first (drivebench identify) or give the value in the model file"
            }
            Self::NotPhysical { .. } | Self::Outside { .. } => {
                "identify the motor again: a loop tuned on this model would not be stable"
            }
            Self::Drives(_) => "identify the motor again, or take the effect out of the model",
        }
    }
}

/// The slope of a model's friction; 0 without viscous friction.
pub fn viscous_n_m_s_per_rad(model: &Model, actuator: Actuator) -> Result<f64, PlantError> {
    let Some(effect) = model.effects.iter().find(|effect| effect.id() == TermKind::Drag.id())
    else {
        return Ok(0.0);
    };
    let missing = PlantError::Missing { key: VISCOUS, actuator: actuator.name() };
    let slope = effect.values.first().copied().flatten().ok_or(missing)?;
    if !slope.is_finite() {
        return Err(PlantError::NotPhysical { key: VISCOUS, value: slope });
    }
    if slope < 0.0 { Err(PlantError::Drives(slope)) } else { Ok(slope) }
}

impl LinearPlant {
    /// The plant of a model with the slope of its own friction; `lag_s` is that of the drive behind a current or a speed
    /// command.
    pub fn of(model: &Model, actuator: Actuator, lag_s: f64) -> Result<Self, PlantError> {
        let viscous = viscous_n_m_s_per_rad(model, actuator)?;
        match actuator {
            Actuator::Voltage => Self::voltage(model, viscous),
            Actuator::Current => Self::current(model, viscous, lag_s),
            Actuator::Speed => Self::speed(lag_s),
        }
    }

    /// The plant of a model behind a voltage command; `viscous_n_m_s_per_rad` is the slope of its friction.
    pub fn voltage(model: &Model, viscous_n_m_s_per_rad: f64) -> Result<Self, PlantError> {
        let value = |key| positive(model, key, Actuator::Voltage);
        let (r, l) = (value(MotorKey::Resistance)?, value(MotorKey::Inductance)?);
        let (ke, j) = (value(MotorKey::BackEmf)?, value(MotorKey::Inertia)?);
        let kt = torque_constant(model, Actuator::Voltage)?;
        Ok(Self {
            actuator: Actuator::Voltage,
            a: Matrix2::new(-r / l, -ke / l, kt / j, -viscous_n_m_s_per_rad.max(0.0) / j),
            b: Vector2::new(1.0 / l, 0.0),
            coupling: coupling(model, Actuator::Voltage)?,
        })
    }

    /// The plant behind a current (torque) command that the drive follows with a lag, s.
    pub fn current(
        model: &Model,
        viscous_n_m_s_per_rad: f64,
        current_lag_s: f64,
    ) -> Result<Self, PlantError> {
        let j = positive(model, MotorKey::Inertia, Actuator::Current)?;
        let kt = torque_constant(model, Actuator::Current)?;
        let lag_s = checked("current_lag_s", current_lag_s)?;
        let braking = -viscous_n_m_s_per_rad.max(0.0) / j;
        Ok(Self {
            actuator: Actuator::Current,
            a: Matrix2::new(-1.0 / lag_s, 0.0, kt / j, braking),
            b: Vector2::new(1.0 / lag_s, 0.0),
            coupling: coupling(model, Actuator::Current)?,
        })
    }

    /// The plant behind a speed command: the drive's speed loop, which includes the shaft's load, as two equal lags of `lag_s`
    /// together.
    pub fn speed(lag_s: f64) -> Result<Self, PlantError> {
        let half_s = 0.5 * checked("speed_lag_s", lag_s)?;
        Ok(Self {
            actuator: Actuator::Speed,
            a: Matrix2::new(-1.0 / half_s, 0.0, 1.0 / half_s, -1.0 / half_s),
            b: Vector2::new(1.0 / half_s, 0.0),
            coupling: None,
        })
    }

    /// The same with the inertia `ratio` times as large: behind a coupling it is the load that changes.
    #[must_use]
    pub fn with_inertia_ratio(&self, ratio: f64) -> Self {
        let mut plant = *self;
        if self.actuator != Actuator::Speed {
            plant.a[(1, 0)] /= ratio;
            plant.a[(1, 1)] /= ratio;
        }
        if let Some(coupling) = &mut plant.coupling {
            let before = coupling.inertia_ratio;
            // The least share of the catalogue remains behind the coupling.
            let share = (1.0 - (1.0 - before) / ratio).max(0.02);
            // Stiffness (2 pi f)^2 J r (1 - r) and damping 2 zeta 2 pi f J r (1 - r) are those of the coupling.
            let reduced = ratio * share * (1.0 - share) / (before * (1.0 - before));
            coupling.inertia_ratio = share;
            coupling.frequency_hz /= reduced.sqrt();
            coupling.damping_ratio /= reduced.sqrt();
        }
        plant
    }

    /// The same with the inductance `ratio` times as large; without effect for another actuator than the voltage.
    #[must_use]
    pub(super) fn with_inductance_ratio(&self, ratio: f64) -> Self {
        let mut plant = *self;
        if self.actuator == Actuator::Voltage {
            plant.a[(0, 0)] /= ratio;
            plant.a[(0, 1)] /= ratio;
            plant.b[0] /= ratio;
        }
        plant
    }

    pub const fn coupling(&self) -> Option<&Coupling> {
        self.coupling.as_ref()
    }

    /// The motor alone, within the backlash of its coupling; `None` without backlash.
    #[must_use]
    pub(super) fn uncoupled(&self) -> Option<Self> {
        let coupling = self.coupling.filter(|coupling| coupling.gap_rad > 0.0)?;
        Some(self.rigid().with_inertia_ratio(1.0 - coupling.inertia_ratio))
    }

    #[must_use]
    pub const fn rigid(&self) -> Self {
        Self { coupling: None, ..*self }
    }

    /// `A` and `b` of the rigid shaft.
    pub const fn matrices(&self) -> (&Matrix2<f64>, &Vector2<f64>) {
        (&self.a, &self.b)
    }

    /// How many of the [`STATES`] it has; the others are zero.
    pub(super) const fn states(&self) -> usize {
        if self.coupling.is_some() { STATES } else { 2 }
    }

    /// `A` and `b` of all states. The twist is counted in rad/s, times the natural frequency: one unit for all that turns.
    fn whole(&self) -> (SMatrix<f64, STATES, STATES>, SVector<f64, STATES>) {
        let mut a = SMatrix::<f64, STATES, STATES>::zeros();
        let mut b = SVector::<f64, STATES>::zeros();
        a.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.a);
        b.fixed_rows_mut::<2>(0).copy_from(&self.b);
        if let Some(coupling) = &self.coupling {
            // f, r, zeta as in `Coupling`: k/(J1 w0) = w0 r, d/J1 = 2 zeta w0 r, and with 1 - r for the load.
            let w0 = std::f64::consts::TAU * coupling.frequency_hz;
            let (r, damping) = (coupling.inertia_ratio, 2.0 * w0 * coupling.damping_ratio);
            for column in 0..2 {
                a[(1, column)] /= 1.0 - r;
            }
            a[(1, 1)] -= damping * r;
            (a[(1, 2)], a[(1, 3)]) = (damping * r, -w0 * r);
            let load = [damping, -damping, w0].map(|rate| (1.0 - r) * rate);
            (a[(2, 1)], a[(2, 2)], a[(2, 3)]) = (load[0], load[1], load[2]);
            (a[(3, 1)], a[(3, 2)]) = (w0, -w0);
        }
        (a, b)
    }

    /// Static gain, speed per unit; `None`: an integrator.
    pub fn gain(&self) -> Option<f64> {
        let determinant = self.a.determinant();
        (determinant.abs() > 1e-12 * self.a.norm_squared())
            .then(|| self.a[(1, 0)] * self.b[0] / determinant)
    }

    /// As two real time constants; `None` where the poles are a complex pair.
    pub(super) fn dominant(&self) -> Option<Dominant> {
        let (trace, determinant) = (self.a.trace(), self.a.determinant());
        let square = 0.25 * trace * trace - determinant;
        if square < -1e-9 * trace * trace {
            return None;
        }
        let fast = -0.5 * trace + square.max(0.0).sqrt();
        // From the product: no cancellation of nearly equal numbers.
        let slow = determinant / fast;
        let rate = self.a[(1, 0)] * self.b[0] / fast;
        Some(Dominant {
            rate,
            large_s: (slow > 1e-9 * fast).then(|| 1.0 / slow),
            small_s: 1.0 / fast,
        })
    }

    /// Sum of the time constants of the denominator and their product: `1 + sum s + product s^2` over the gain.
    pub(super) fn denominator(&self) -> Option<(f64, f64)> {
        let determinant = self.a.determinant();
        self.gain().map(|_| (-self.a.trace() / determinant, 1.0 / determinant))
    }

    /// `(Phi, Gamma)` over `time_s` with the input held: `x(t) = Phi x(0) + Gamma u`.
    pub fn held_over(&self, time_s: f64) -> (SMatrix<f64, STATES, STATES>, SVector<f64, STATES>) {
        let (a, b) = self.whole();
        // exp([[A, b], [0, 0]] t) holds both (Van Loan 1978).
        let mut joint = SMatrix::<f64, { STATES + 1 }, { STATES + 1 }>::zeros();
        joint.fixed_view_mut::<STATES, STATES>(0, 0).copy_from(&(a * time_s));
        joint.fixed_view_mut::<STATES, 1>(0, STATES).copy_from(&(b * time_s));
        let exponential = joint.exp();
        let phi = exponential.fixed_view::<STATES, STATES>(0, 0).into_owned();
        (phi, exponential.fixed_view::<STATES, 1>(0, STATES).into_owned())
    }
}

/// The coupling of a model, all of its values known.
fn coupling(model: &Model, actuator: Actuator) -> Result<Option<Coupling>, PlantError> {
    for active in &model.effects {
        let guessed = active.effect.terms(&active.values_or_guess()).coupling();
        let Some(coupling) = guessed else { continue };
        for (spec, value) in active.effect.parameters().iter().zip(&active.values) {
            let missing = PlantError::Missing { key: spec.key, actuator: actuator.name() };
            let value = value.ok_or(missing)?;
            if !spec.admits(value) {
                return Err(PlantError::Outside {
                    effect: active.id(),
                    key: spec.key,
                    value,
                    allowed: spec.allowed(),
                });
            }
        }
        return Ok(Some(coupling));
    }
    Ok(None)
}

fn torque_constant(model: &Model, actuator: Actuator) -> Result<f64, PlantError> {
    given(MotorKey::TorqueConstant, model.motor.torque_constant(), actuator)
}

fn positive(model: &Model, key: MotorKey, actuator: Actuator) -> Result<f64, PlantError> {
    given(key, model.motor.get(key), actuator)
}

fn given(key: MotorKey, value: Option<f64>, actuator: Actuator) -> Result<f64, PlantError> {
    let key = key.key();
    checked(key, value.ok_or(PlantError::Missing { key, actuator: actuator.name() })?)
}

fn checked(key: &'static str, value: f64) -> Result<f64, PlantError> {
    let physical = value.is_finite() && value > 0.0;
    physical.then_some(value).ok_or(PlantError::NotPhysical { key, value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{self, assert_close};
    use drivebench_model::plant::{Input, Motor, Plant, Scenario, State};
    use drivebench_model::sample::Channel;

    #[test]
    fn time_constants_are_those_of_the_textbook() {
        let motor = Motor::zk_22fc().with(MotorKey::Inertia, 0.0228);
        let plant = LinearPlant::voltage(&Model::baseline(motor.clone()), 0.0).unwrap();
        let found = plant.dominant().unwrap();
        let tm = motor.mechanical_time_constant_s().unwrap();
        let ta = motor.electrical_time_constant_s().unwrap();
        let large_s = found.large_s.unwrap();
        assert_close(large_s * found.small_s, tm * ta, 1e-12);
        assert_close(large_s + found.small_s, tm, 1e-12);
        assert_close(plant.gain().unwrap(), 1.0 / 0.3538, 1e-12);
        assert_close(found.rate * large_s, 1.0 / 0.3538, 1e-12);
        // A light machine has complex poles, and a current drive integrates.
        let model = testing::model(0.001);
        assert_eq!(LinearPlant::voltage(&model, 0.0).unwrap().dominant(), None);
        let current = LinearPlant::current(&model, 0.0, 0.002).unwrap();
        assert_eq!(current.gain(), None);
        let found = current.dominant().unwrap();
        assert_eq!(found.large_s, None);
        assert_close(found.rate, 353.8, 1e-9);
        assert_close(found.small_s, 0.002, 1e-9);
    }

    #[test]
    fn the_slope_of_a_friction_has_a_value_that_brakes() {
        let slope = |model: &Model| viscous_n_m_s_per_rad(model, Actuator::Voltage);
        let mut model = Model::baseline(Motor::zk_22fc());
        assert_eq!(slope(&model), Ok(0.0));
        model = model.with_effect("viscous_friction").unwrap();
        let missing = PlantError::Missing { key: VISCOUS, actuator: Actuator::Voltage.name() };
        assert_eq!(slope(&model), Err(missing));
        for (value, expected) in
            [(2e-4, Ok(2e-4)), (0.0, Ok(0.0)), (-1e-6, Err(PlantError::Drives(-1e-6)))]
        {
            model.effects[0].values[0] = Some(value);
            assert_eq!(slope(&model), expected);
        }
    }

    #[test]
    fn the_held_step_agrees_with_many_small_ones() {
        let plant = LinearPlant::voltage(&Model::baseline(Motor::zk_22fc()), 1e-3).unwrap();
        let (phi, gamma) = plant.held_over(0.01);
        let (small, push) = plant.held_over(0.01 / 512.0);
        let mut x = SVector::from([2.0, -3.0, 0.0, 0.0]);
        let whole = phi * x + gamma * 24.0;
        for _ in 0..512 {
            x = small * x + push * 24.0;
        }
        assert_close(x[0], whole[0], 1e-10);
        assert_close(x[1], whole[1], 1e-10);
        assert!(x[2] == 0.0 && x[3] == 0.0);
    }

    #[test]
    fn the_whole_plant_moves_as_the_models_own_simulation() {
        // An independent solution: the free run with its friction events, of which there is none here.
        let mut model = testing::elastic(0.5, 0.02);
        model.motor.set(MotorKey::LoadTorque, 0.0);
        let plant = LinearPlant::voltage(&model, 0.0).unwrap();
        let times: Vec<f64> = (0..300).map(|n| 0.002 * f64::from(n)).collect();
        let steps = vec![(0.0, 10.0)];
        let scenario =
            Scenario::planned("steps", Input::Voltage, Channel::VoltageCmd, steps, times);
        let mut free = Plant::new(&model, Input::Voltage).unwrap();
        let free = free.simulate(&scenario, State::default());
        let (phi, gamma) = plant.held_over(0.002);
        let mut x = SVector::from([0.0; STATES]);
        for (speed, current) in free.speed_rad_s.iter().zip(&free.current_a) {
            assert_close(x[1], *speed, 1e-6);
            assert_close(x[0], *current, 1e-6);
            x = phi * x + gamma * 10.0;
        }
        assert!(x[1] > 20.0);
    }

    #[test]
    fn a_heavier_load_changes_neither_motor_nor_coupling() {
        let plant = LinearPlant::voltage(&testing::elastic(0.5, 0.02), 0.0).unwrap();
        let heavier = plant.with_inertia_ratio(3.0);
        let [(before, _), (after, _)] = [plant, heavier].map(|plant| plant.whole());
        // Torque of motor and damping on the motor's own inertia.
        for column in 0..3 {
            assert_close(before[(1, column)], after[(1, column)], 1e-9);
        }
        // Five times the load: the stiffness over the load's inertia, in angles, is a fifth.
        let per_angle = |a: &SMatrix<f64, 4, 4>, row: usize| a[(row, 3)] * a[(3, 1)];
        assert_close(per_angle(&before, 1), per_angle(&after, 1), 1e-9);
        assert_close(per_angle(&before, 2), 5.0 * per_angle(&after, 2), 1e-9);
        // Both together turn as one with three times the inertia.
        assert_close(heavier.gain().unwrap(), plant.gain().unwrap(), 1e-12);
        assert_close(heavier.matrices().0[(1, 0)] * 3.0, plant.a[(1, 0)], 1e-12);
    }

    #[test]
    fn a_coupling_needs_its_values_and_backlash_frees_the_motor() {
        for (damping, message) in [
            (None, "damping_ratio is missing"),
            (Some(-0.1), "elastic_coupling.damping_ratio = -0.1 is not physical (allowed: 0 to 1)"),
        ] {
            let mut model = testing::elastic(0.5, 0.02);
            model.effects[0].values[2] = damping;
            let error = LinearPlant::voltage(&model, 0.0).unwrap_err();
            assert!(error.to_string().starts_with(message), "{error}");
        }
        let elastic = LinearPlant::voltage(&testing::elastic(0.4, 0.02), 0.0).unwrap();
        assert_eq!(elastic.uncoupled(), None);
        let values = [0.02, 40.0, 0.4, 0.05, 0.5];
        let loose = testing::with(&testing::model(0.0045), "backlash", &values);
        let alone = LinearPlant::voltage(&loose, 0.0).unwrap().uncoupled().unwrap();
        assert_close(alone.a[(1, 0)], testing::plant(0.6 * 0.0045).a[(1, 0)], 1e-12);
        assert_eq!(alone.states(), 2);
    }

    #[test]
    fn unphysical_values_are_refused_by_name() {
        let motor = Motor::zk_22fc().with(MotorKey::Inertia, -1.0);
        let error = LinearPlant::voltage(&Model::baseline(motor), 0.0).unwrap_err();
        let text = "inertia_kg_m2 = -1 is not physical (allowed: a finite value above 0)";
        assert_eq!(error.to_string(), text);
        let mut motor = Motor::zk_22fc();
        motor.clear(MotorKey::Inductance);
        assert!(matches!(
            LinearPlant::voltage(&Model::baseline(motor), 0.0),
            Err(PlantError::Missing { key: "inductance_h", .. })
        ));
    }
}

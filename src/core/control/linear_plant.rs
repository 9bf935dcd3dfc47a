//! The speed's answer to the actuator near a working point: two states, the second is the speed.

use nalgebra::{Matrix2, Matrix3, Vector2};
use thiserror::Error;

use super::Actuator;
use crate::plant::{Model, MotorKey};

/// `dx/dt = A x + b u`, speed = `x[1]`.
///
/// Voltage drive: `x` is current and speed. Current drive: the drive's current loop is a lag.
/// Speed drive: the drive's own speed loop is two lags.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearPlant {
    pub actuator: Actuator,
    a: Matrix2<f64>,
    b: Vector2<f64>,
}

/// Two real time constants: `gain / ((1 + large s)(1 + small s))`, or an integrator where nothing brakes the shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dominant {
    /// Slope of the speed's answer to a unit step after the small time constant, rad/s^2 per unit.
    pub rate: f64,
    /// Large time constant, s; `None`: an integrator.
    pub large_s: Option<f64>,
    pub small_s: f64,
}

/// Why a model makes no plant to control.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PlantError {
    #[error("{key} is missing in the model (needed for a speed loop over {actuator})")]
    Missing {
        key: &'static str,
        actuator: &'static str,
    },
    #[error("{key} = {value} is not physical (allowed: a finite value above 0)")]
    NotPhysical { key: &'static str, value: f64 },
    #[error("{VISCOUS} = {0} is not physical: it drives the shaft (allowed: 0 or more)")]
    Drives(f64),
}

impl PlantError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Missing { .. } => {
                "identify the motor first (drivebench identify) or give the value in the model file"
            }
            Self::NotPhysical { .. } => {
                "identify the motor again: a loop tuned on this model would not be stable"
            }
            Self::Drives(_) => "identify the motor again, or take the effect out of the model",
        }
    }
}

/// The value of a model that [`viscous_n_m_s_per_rad`] reads.
const VISCOUS: &str = "viscous_friction.viscous_n_m_s_per_rad";

/// The slope of a model's friction; 0 without viscous friction.
///
/// # Errors
/// Viscous friction without a value, or one that is not finite or below 0.
pub fn viscous_n_m_s_per_rad(model: &Model, actuator: Actuator) -> Result<f64, PlantError> {
    let mut effects = model.effects.iter();
    let Some(effect) = effects.find(|effect| effect.id() == "viscous_friction") else {
        return Ok(0.0);
    };
    let missing = PlantError::Missing {
        key: VISCOUS,
        actuator: actuator.name(),
    };
    let slope = effect.values.first().copied().flatten().ok_or(missing)?;
    if !slope.is_finite() {
        return Err(PlantError::NotPhysical {
            key: VISCOUS,
            value: slope,
        });
    }
    if slope < 0.0 {
        return Err(PlantError::Drives(slope));
    }
    Ok(slope)
}

impl LinearPlant {
    /// The plant of a model behind a voltage command; `viscous_n_m_s_per_rad` is the slope of its friction.
    ///
    /// # Errors
    /// A value that is missing, not finite or not positive.
    pub fn voltage(model: &Model, viscous_n_m_s_per_rad: f64) -> Result<Self, PlantError> {
        let value = |key| positive(model, key, Actuator::Voltage);
        let (r, l) = (value(MotorKey::Resistance)?, value(MotorKey::Inductance)?);
        let (ke, j) = (value(MotorKey::BackEmf)?, value(MotorKey::Inertia)?);
        let kt = torque_constant(model, Actuator::Voltage)?;
        Ok(Self {
            actuator: Actuator::Voltage,
            a: Matrix2::new(-r / l, -ke / l, kt / j, -viscous_n_m_s_per_rad.max(0.0) / j),
            b: Vector2::new(1.0 / l, 0.0),
        })
    }

    /// The plant behind a current (torque) command that the drive follows with a lag, s.
    ///
    /// # Errors
    /// As [`Self::voltage`].
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
        })
    }

    /// The plant behind a speed command: the drive's speed loop as two equal lags, s together.
    ///
    /// # Errors
    /// A lag that is not finite or not positive.
    pub fn speed(lag_s: f64) -> Result<Self, PlantError> {
        let half_s = 0.5 * checked("speed_lag_s", lag_s)?;
        Ok(Self {
            actuator: Actuator::Speed,
            a: Matrix2::new(-1.0 / half_s, 0.0, 1.0 / half_s, -1.0 / half_s),
            b: Vector2::new(1.0 / half_s, 0.0),
        })
    }

    /// The same with the inertia `ratio` times as large.
    #[must_use]
    pub fn with_inertia_ratio(&self, ratio: f64) -> Self {
        let mut plant = *self;
        if self.actuator != Actuator::Speed {
            plant.a[(1, 0)] /= ratio;
            plant.a[(1, 1)] /= ratio;
        }
        plant
    }

    pub const fn matrices(&self) -> (&Matrix2<f64>, &Vector2<f64>) {
        (&self.a, &self.b)
    }

    /// Speed per unit at standstill of all change; `None`: an integrator.
    pub fn gain(&self) -> Option<f64> {
        let determinant = self.a.determinant();
        (determinant.abs() > 1e-12 * self.a.norm_squared())
            .then(|| self.a[(1, 0)] * self.b[0] / determinant)
    }

    /// As two real time constants; `None` where the poles are a complex pair.
    pub fn dominant(&self) -> Option<Dominant> {
        let (trace, determinant) = (self.a.trace(), self.a.determinant());
        let square = 0.25 * trace * trace - determinant;
        if square < -1e-9 * trace * trace {
            return None;
        }
        let root = square.max(0.0).sqrt();
        let fast = -0.5 * trace + root;
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
    pub fn denominator(&self) -> Option<(f64, f64)> {
        let determinant = self.a.determinant();
        self.gain()
            .map(|_| (-self.a.trace() / determinant, 1.0 / determinant))
    }

    /// `(Phi, Gamma)` over `time_s` with the input held: `x(t) = Phi x(0) + Gamma u`.
    pub fn held_over(&self, time_s: f64) -> (Matrix2<f64>, Vector2<f64>) {
        // exp([[A, b], [0, 0]] t) holds both (Van Loan 1978).
        let mut joint = Matrix3::zeros();
        (joint.fixed_view_mut::<2, 2>(0, 0)).copy_from(&(self.a * time_s));
        (joint.fixed_view_mut::<2, 1>(0, 2)).copy_from(&(self.b * time_s));
        let grown = joint.exp();
        (
            grown.fixed_view::<2, 2>(0, 0).into_owned(),
            grown.fixed_view::<2, 1>(0, 2).into_owned(),
        )
    }
}

fn torque_constant(model: &Model, actuator: Actuator) -> Result<f64, PlantError> {
    let value = model.motor.torque_constant();
    given(MotorKey::TorqueConstant, value, actuator)
}

fn positive(model: &Model, key: MotorKey, actuator: Actuator) -> Result<f64, PlantError> {
    given(key, model.motor.get(key), actuator)
}

fn given(key: MotorKey, value: Option<f64>, actuator: Actuator) -> Result<f64, PlantError> {
    let key = key.key();
    let missing = PlantError::Missing {
        key,
        actuator: actuator.name(),
    };
    checked(key, value.ok_or(missing)?)
}

fn checked(key: &'static str, value: f64) -> Result<f64, PlantError> {
    let physical = value.is_finite() && value > 0.0;
    physical
        .then_some(value)
        .ok_or(PlantError::NotPhysical { key, value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::testing::assert_close;
    use crate::plant::Motor;

    #[test]
    fn time_constants_of_a_slow_machine_are_those_of_the_textbook() {
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
    }

    #[test]
    fn a_light_machine_swings_and_a_current_drive_integrates() {
        let motor = Motor::zk_22fc().with(MotorKey::Inertia, 0.001);
        let model = Model::baseline(motor);
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
        let missing = PlantError::Missing {
            key: VISCOUS,
            actuator: Actuator::Voltage.name(),
        };
        assert_eq!(slope(&model), Err(missing));
        for (value, expected) in [
            (2e-4, Ok(2e-4)),
            (0.0, Ok(0.0)),
            (-1e-6, Err(PlantError::Drives(-1e-6))),
        ] {
            model.effects[0].values[0] = Some(value);
            assert_eq!(slope(&model), expected);
        }
    }

    #[test]
    fn the_held_step_agrees_with_many_small_ones() {
        let plant = LinearPlant::voltage(&Model::baseline(Motor::zk_22fc()), 1e-3).unwrap();
        let (phi, gamma) = plant.held_over(0.01);
        let (small, push) = plant.held_over(0.01 / 512.0);
        let mut x = Vector2::new(2.0, -3.0);
        let whole = phi * x + gamma * 24.0;
        for _ in 0..512 {
            x = small * x + push * 24.0;
        }
        assert_close(x[0], whole[0], 1e-10);
        assert_close(x[1], whole[1], 1e-10);
    }

    #[test]
    fn what_is_not_physical_is_refused_by_name() {
        let motor = Motor::zk_22fc().with(MotorKey::Inertia, -1.0);
        let error = LinearPlant::voltage(&Model::baseline(motor), 0.0).unwrap_err();
        assert_eq!(
            error.to_string(),
            "inertia_kg_m2 = -1 is not physical (allowed: a finite value above 0)"
        );
        let mut motor = Motor::zk_22fc();
        motor.clear(MotorKey::Inductance);
        assert!(matches!(
            LinearPlant::voltage(&Model::baseline(motor), 0.0),
            Err(PlantError::Missing {
                key: "inductance_h",
                ..
            })
        ));
    }
}

//! Steady-state output of a speed, by the model.

use serde::Serialize;

use super::Actuator;
use drivebench_model::plant::{Model, MotorKey};

/// `output = per_speed w + against sgn(w)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Holding {
    /// Actuator's unit per rad/s: the back-EMF and viscous friction.
    pub per_speed: f64,
    /// Against the motion, actuator's unit: Coulomb friction.
    pub against: f64,
}

impl Holding {
    /// Of a model; what it leaves out counts as nothing. `viscous_n_m_s_per_rad` is the slope of its friction.
    pub fn of(model: &Model, actuator: Actuator, viscous_n_m_s_per_rad: f64) -> Self {
        let value = |key| model.motor.get(key).unwrap_or(0.0);
        let per_torque = match (actuator, model.motor.torque_constant()) {
            (Actuator::Voltage, Some(kt)) => value(MotorKey::Resistance) / kt,
            (Actuator::Current, Some(kt)) => 1.0 / kt,
            _ => 0.0,
        };
        let without_friction = match actuator {
            Actuator::Voltage => value(MotorKey::BackEmf),
            Actuator::Current => 0.0,
            Actuator::Speed => 1.0,
        };
        Self {
            per_speed: without_friction + per_torque * viscous_n_m_s_per_rad,
            against: per_torque * value(MotorKey::LoadTorque),
        }
    }

    /// Below 2 rad/s the sign of the speed is noise: friction rises to its full size there.
    pub fn output(&self, speed_rad_s: f64) -> f64 {
        self.per_speed * speed_rad_s + self.against * (speed_rad_s / 2.0).clamp(-1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_close;
    use drivebench_model::plant::Motor;

    #[test]
    fn the_paper_motor_is_held_by_back_emf_and_friction() {
        let holding = Holding::of(&Model::baseline(Motor::zk_22fc()), Actuator::Voltage, 0.0);
        assert_close(holding.output(100.0), 35.38 + 1.1 * 0.455 / 0.3538, 1e-12);
        assert_close(holding.output(-100.0), -holding.output(100.0), 1e-12);
        assert_close(holding.output(0.0), 0.0, 1e-12);
    }
}

//! The linear part of the baseline by itself: how a small deviation goes on.

use super::model::Model;
use super::motor::MotorKey;
use super::propagator::{LinearPart, Propagator};

/// `d/dt [i, w] = A [i, w] - [0, T/J]` of an electrical model.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    part: LinearPart,
    inverse_inertia: f64,
}

/// One interval of it.
#[derive(Clone, Copy, Debug)]
pub struct LinearStep {
    propagator: Propagator,
    inverse_inertia: f64,
}

impl Linear {
    /// `None` where the model lacks an electrical or mechanical value.
    pub fn of(model: &Model) -> Option<Self> {
        let value = |key| model.motor.get(key);
        let (r, l) = (value(MotorKey::Resistance)?, value(MotorKey::Inductance)?);
        let (ke, inertia) = (value(MotorKey::BackEmf)?, value(MotorKey::Inertia)?);
        let kt = model.motor.torque_constant()?;
        Some(Self {
            part: LinearPart::new(&[[-r / l, -ke / l], [kt / inertia, 0.0]]),
            inverse_inertia: 1.0 / inertia,
        })
    }

    /// The step over `interval_s`.
    pub fn over(&self, interval_s: f64) -> LinearStep {
        LinearStep {
            propagator: self.part.over(interval_s),
            inverse_inertia: self.inverse_inertia,
        }
    }
}

impl LinearStep {
    /// Deviation of current and speed at the end of the interval, under a torque against positive motion.
    #[must_use]
    pub fn after(&self, deviation: [f64; 2], torque_n_m: f64) -> [f64; 2] {
        let forcing = [0.0, -torque_n_m * self.inverse_inertia];
        self.propagator.apply(deviation, forcing)
    }
}

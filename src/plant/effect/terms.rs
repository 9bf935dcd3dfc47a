//! What an effect adds to the equations of the baseline.

use super::{Coupling, Path, ShaftAngle};
use crate::plant::motor::{Motor, MotorKey};

/// The instant at which terms are evaluated, and the motor that they act on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Instant {
    /// Since the run's first command.
    pub time_s: f64,
    pub voltage_v: f64,
    /// Full voltage of the supply in this run, see [`Scenario::supply_v`](crate::plant::Scenario::supply_v).
    pub supply_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle: ShaftAngle,
    /// Of the cold winding.
    pub resistance_ohm: f64,
    pub back_emf_v_s_per_rad: f64,
    pub torque_n_m_per_a: f64,
}

impl Instant {
    /// An instant at rest with the constants of `motor`; what the motor leaves out is not a number.
    pub fn of(motor: &Motor) -> Self {
        let value = |key| motor.get(key).unwrap_or(f64::NAN);
        Self {
            resistance_ohm: value(MotorKey::Resistance),
            back_emf_v_s_per_rad: value(MotorKey::BackEmf),
            torque_n_m_per_a: motor.torque_constant().unwrap_or(f64::NAN),
            ..Self::default()
        }
    }
}

/// What effects add to the balances at one instant, as [`Terms`] defines the signs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    pub voltage_v: f64,
    pub torque_n_m: f64,
    pub friction_n_m: f64,
    pub current_rate_gain: f64,
    pub inertia_gain: f64,
}

/// What an effect adds to the baseline's equations. `own` are the effect's states.
pub trait Terms: Send + Sync {
    /// Voltage drop, V: subtracted in the voltage balance.
    fn voltage_v(&self, _at: &Instant, _own: &[f64]) -> f64 {
        0.0
    }

    /// Torque against positive motion whatever the direction, N.m: subtracted in the torque balance.
    fn torque_n_m(&self, _at: &Instant, _own: &[f64]) -> f64 {
        0.0
    }

    /// Addition to the Coulomb level, N.m: always against the motion, and it holds at rest.
    fn friction_n_m(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// Relative addition to the rate of the current: `g` makes `di/dt` `1 + g` times what `L` alone gives.
    fn current_rate_gain(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// Relative addition to the inertia: `g` makes `dw/dt` what all torques give over `(1 + g) J`.
    fn inertia_gain(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// Adds the five above: one call through the table of methods where a simulation would need five.
    fn add_to(&self, sums: &mut Sums, at: &Instant, own: &[f64]) {
        sums.voltage_v += self.voltage_v(at, own);
        sums.torque_n_m += self.torque_n_m(at, own);
        sums.friction_n_m += self.friction_n_m(at);
        sums.current_rate_gain += self.current_rate_gain(at);
        sums.inertia_gain += self.inertia_gain(at);
    }

    /// The five above at once.
    fn sums(&self, at: &Instant, own: &[f64]) -> Sums {
        let mut sums = Sums::default();
        self.add_to(&mut sums, at, own);
        sums
    }

    /// Number of states, all starting at zero.
    fn states(&self) -> usize {
        0
    }

    /// Time derivatives of the effect's states.
    fn derivative(&self, _at: &Instant, _own: &[f64], _out: &mut [f64]) {}

    /// What it does on the way of command and measurement.
    fn path(&self) -> Path {
        Path::default()
    }

    /// The second inertia that it puts behind the shaft.
    fn coupling(&self) -> Option<Coupling> {
        None
    }
}

//! A direct-current motor as two balances, integrated by themselves: what the witness drives, and knows the truth of.

pub(crate) const RESISTANCE_OHM: f64 = 1.1;
pub(crate) const INDUCTANCE_H: f64 = 0.0099;
pub(crate) const BACK_EMF_V_S_PER_RAD: f64 = 0.3538;
pub(crate) const INERTIA_KG_M2: f64 = 0.0052;
pub(crate) const COULOMB_N_M: f64 = 0.455;
/// What a result is held against, by its key.
pub(crate) const TRUTHS: [(&str, f64); 3] = [
    ("resistance_ohm", RESISTANCE_OHM),
    ("back_emf_v_s_per_rad", BACK_EMF_V_S_PER_RAD),
    ("inertia_kg_m2", INERTIA_KG_M2),
];
/// Step of the integration, s: a hundredth of the electrical time constant and less.
const STEP_S: f64 = 5e-5;

/// What the motor has beside its two balances.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Hidden {
    #[default]
    Nothing,
    /// Torque in proportion to the speed, N.m.s/rad.
    Viscous(f64),
    /// Torque in proportion to the square of the speed, N.m.s^2/rad^2.
    Fan(f64),
    /// Drop of the brushes against the current, V.
    Brushes(f64),
    /// Torque above the Coulomb friction at rest, N.m, that falls off within this speed, rad/s.
    Stribeck(f64, f64),
}

impl Hidden {
    fn torque_n_m(self, speed_rad_s: f64) -> f64 {
        let speed = speed_rad_s.abs();
        match self {
            Self::Viscous(by_speed) => by_speed * speed,
            Self::Fan(by_square) => by_square * speed * speed,
            Self::Stribeck(at_rest, within) => at_rest * (-(speed / within).powi(2)).exp(),
            Self::Nothing | Self::Brushes(_) => 0.0,
        }
    }

    /// Without current they drop what is there, and no current flows.
    fn drop_v(self, current_a: f64, driving_v: f64) -> f64 {
        match self {
            Self::Brushes(volts) if current_a.abs() < 1e-3 => driving_v.clamp(-volts, volts),
            Self::Brushes(volts) => volts * (current_a / 0.02).tanh(),
            _ => 0.0,
        }
    }
}

/// Currents and speeds at one instant.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Motor {
    pub(crate) current_a: f64,
    pub(crate) speed_rad_s: f64,
    pub(crate) angle_rad: f64,
    /// What somebody at the shaft does, N.m in the positive direction.
    pub(crate) pushed_n_m: f64,
    /// The shaft cannot turn.
    pub(crate) is_blocked: bool,
    pub(crate) hidden: Hidden,
}

impl Motor {
    /// Lets time pass under this voltage; `None`: the output is open and no current flows.
    pub(crate) fn advance(&mut self, volts: Option<f64>, seconds: f64) {
        let steps = (seconds / STEP_S).ceil().max(1.0);
        let step_s = seconds / steps;
        let mut left = steps;
        while left > 0.5 {
            self.step(volts, step_s);
            left -= 1.0;
        }
    }

    fn step(&mut self, volts: Option<f64>, step_s: f64) {
        // Exact over the step for a speed that stands still meanwhile.
        let before = self.current_a;
        self.current_a = volts.map_or(0.0, |volts| {
            let driving_v = volts - BACK_EMF_V_S_PER_RAD * self.speed_rad_s;
            let end = (driving_v - self.hidden.drop_v(before, driving_v)) / RESISTANCE_OHM;
            end + (before - end) * (-RESISTANCE_OHM * step_s / INDUCTANCE_H).exp()
        });
        let torque = 0.5 * BACK_EMF_V_S_PER_RAD * (before + self.current_a) + self.pushed_n_m;
        let speed = self.speed_rad_s;
        let friction = COULOMB_N_M + self.hidden.torque_n_m(speed);
        if self.is_blocked || (speed == 0.0 && torque.abs() <= friction) {
            self.speed_rad_s = 0.0;
            return;
        }
        let way = if speed == 0.0 { torque } else { speed }.signum();
        let next = speed + step_s * (torque - friction * way) / INERTIA_KG_M2;
        // Friction stops, it never turns round.
        self.speed_rad_s = if speed * next < 0.0 { 0.0 } else { next };
        self.angle_rad += 0.5 * step_s * (speed + self.speed_rad_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_settles_by_both_balances_and_coasts_down() {
        let mut motor = Motor::default();
        motor.advance(Some(60.0), 3.0);
        let current = COULOMB_N_M / BACK_EMF_V_S_PER_RAD;
        let speed = (60.0 - RESISTANCE_OHM * current) / BACK_EMF_V_S_PER_RAD;
        assert!((motor.current_a - current).abs() < 1e-3, "{motor:?}");
        assert!((motor.speed_rad_s - speed).abs() < 1e-2, "{motor:?}");
        motor.advance(None, 0.5);
        let slower = speed - 0.5 * COULOMB_N_M / INERTIA_KG_M2;
        assert!((motor.speed_rad_s - slower).abs() < 0.05, "{motor:?}");
    }
}

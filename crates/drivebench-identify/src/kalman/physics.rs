//! Motor and known effects over one interval of held voltage and unchanged direction.
//!
//! `L di/dt = u - R i - Ke w`, `J dw/dt = Kt i - B w - (s Mc + TL)`: linear, so the step is exact, and nothing is assumed
//! about the interval against L/R. Effects are linearised about the present state.

use std::sync::Arc;

use drivebench_model::numerics::propagator::{LinearPart, Propagator};
use drivebench_model::plant::{Instant, Model, Terms};

/// R, L, Ke, Kt, J and what friction adds per speed, SI units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Physics {
    pub(super) r: f64,
    pub(super) l: f64,
    pub(super) ke: f64,
    pub(super) kt: f64,
    pub(super) j: f64,
    pub(super) b: f64,
}

impl Physics {
    /// The shaft turns: current and speed after `h`.
    pub(super) fn turning(&self, h: f64) -> Propagator {
        let winding = [-self.r / self.l, -self.ke / self.l];
        LinearPart::new(&[winding, [self.kt / self.j, -self.b / self.j]]).over(h)
    }

    /// The shaft stands: only the current moves.
    pub(super) fn at_rest(&self, h: f64) -> Propagator {
        let settled = -(-h * self.r / self.l).exp_m1();
        Propagator {
            phi: [[1.0 - settled, 0.0], [0.0, 0.0]],
            gamma: [[settled * self.l / self.r, 0.0], [0.0, 0.0]],
        }
    }

    /// Right-hand side of the state equation for a voltage and a torque against positive speed.
    pub(super) fn forcing(&self, voltage_v: f64, torque_n_m: f64) -> [f64; 2] {
        [voltage_v / self.l, -torque_n_m / self.j]
    }

    /// The present state for the terms of effects.
    pub(super) fn instant(&self, time_s: f64, voltage_v: f64, state: [f64; 2]) -> Instant {
        Instant {
            time_s,
            voltage_v,
            current_a: state[0],
            speed_rad_s: state[1],
            resistance_ohm: self.r,
            back_emf_v_s_per_rad: self.ke,
            torque_n_m_per_a: self.kt,
            ..Instant::default()
        }
    }
}

/// Effects whose values are known; they are subtracted, not estimated.
#[derive(Clone, Default)]
pub(crate) struct KnownEffects {
    terms: Arc<Vec<Box<dyn Terms>>>,
}

impl std::fmt::Debug for KnownEffects {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "KnownEffects({})", self.terms.len())
    }
}

/// Constant parts of the balances over one interval.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Offsets {
    pub(super) voltage_v: f64,
    pub(super) torque_n_m: f64,
}

impl KnownEffects {
    /// The effects of `model` that can be subtracted, and the identifiers of those that cannot: a value is missing, or
    /// they are more than terms of a balance in voltage, current and speed.
    pub(crate) fn of(model: &Model) -> (Self, Vec<&'static str>) {
        let (mut known, mut not_subtracted) = (Vec::new(), Vec::new());
        for active in &model.effects {
            let terms = active.terms_of_the_instant();
            match terms.filter(|_| !active.effect.card().needs_angle) {
                Some(terms) => known.push(terms),
                None => not_subtracted.push(active.id()),
            }
        }
        let terms = Arc::new(known);
        (Self { terms }, not_subtracted)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// Sets the slope of the friction in `physics` and gives what is left; `direction` is the sign of the motion.
    pub(super) fn linearise(&self, physics: &mut Physics, at: &Instant, direction: f64) -> Offsets {
        if self.terms.is_empty() {
            return Offsets::default();
        }
        let sum = |of: &dyn Fn(&dyn Terms) -> f64| {
            self.terms.iter().map(|terms| of(&**terms)).sum::<f64>()
        };
        let torque = |speed_rad_s: f64| -> f64 {
            let at = Instant { speed_rad_s, ..*at };
            sum(&|terms| terms.torque_n_m(&at, &[]) + direction * terms.friction_n_m(&at))
        };
        let step = 1e-3 * (1.0 + at.speed_rad_s.abs());
        let present = torque(at.speed_rad_s);
        let slope = (torque(at.speed_rad_s + step) - torque(at.speed_rad_s - step)) / (2.0 * step);
        // Friction that falls with speed stays below what would make the motor itself unstable.
        physics.b = slope.max(-0.5 * physics.ke * physics.kt / physics.r);
        Offsets {
            voltage_v: sum(&|terms| terms.voltage_v(at, &[])),
            torque_n_m: present - physics.b * at.speed_rad_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_time_constants_end_in_the_steady_state() {
        let p = Physics { r: 1.1, l: 1e-6, ke: 0.35, kt: 0.35, j: 1e-4, b: 0.0 };
        let x = p.turning(2.0).apply([5.0, 0.0], p.forcing(10.0, 0.35));
        assert!((x[0] - 1.0).abs() < 1e-9, "{x:?}");
        assert!((x[1] - (10.0 - 1.1) / 0.35).abs() < 1e-7, "{x:?}");
        let held = p.at_rest(1.0).apply([5.0, 0.0], p.forcing(10.0, 0.35));
        assert!((held[0] - 10.0 / 1.1).abs() < 1e-9 && held[1].abs() < 1e-300);
    }
}

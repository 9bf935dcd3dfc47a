//! Stribeck friction with memory: a bristle that stretches, slips and relaxes.

use super::{Acts, HiddenKind, Mechanism, Moment, NotNegative, Positive};

/// Shaft angle over which the bristle stretches to its full torque, rad: it sets the memory of the friction. Asperities
/// yield over some micrometres (15 um with the stiffness and level of the paper below), here at a radius of 10 mm.
const STRETCH_RAD: f64 = 1.5e-3;

/// Friction beyond Coulomb that is `stribeck_n_m` at rest and vanishes beyond a few `stribeck_speed_rad_s`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "stribeck_friction",
    names: &["stribeck_friction"],
    parameters: &[
        NotNegative.of("stribeck_n_m", "N.m", 0.16, 0.08..0.16),
        Positive.of("stribeck_speed_rad_s", "rad/s", 10.0, 6.0..18.0),
    ],
    mystery: Some(|dice| vec![dice.torque_n_m, dice.between(5.0, 20.0)]),
    acts: Acts::Inside(|values, _| {
        Box::new(Bristle { torque_n_m: values[0], speed_scale_rad_s: values[1], stretch: 0.0 })
    }),
};

/// `LuGre` bristle (Canudas de Wit et al., IEEE TAC 40:3, 1995, eq. 3 to 5), applied to the part beyond Coulomb, with
/// the stretch z scaled to 1 at full torque:
/// dz/dt = (w - |w| z/g(w))/`STRETCH_RAD`, g = exp(-(w/ws)^2), torque = Ms z.
/// At constant speed it settles on the Stribeck curve; the host's catalogue has only that curve, without the memory.
struct Bristle {
    torque_n_m: f64,
    speed_scale_rad_s: f64,
    stretch: f64,
}

impl Mechanism for Bristle {
    fn drag_torque_n_m(&self, _speed_rad_s: f64) -> f64 {
        self.torque_n_m * self.stretch
    }

    fn breakaway_extra_n_m(&self) -> f64 {
        self.torque_n_m
    }

    fn broke_away(&mut self, direction: f64) {
        self.stretch = direction;
    }

    /// Exact for constant speed over the step: the relaxation is far faster than the step at high speed.
    fn advance(&mut self, step_s: f64, at: &Moment, _put_out_v: f64) {
        let w = at.speed_rad_s;
        if w == 0.0 {
            return;
        }
        // The floor keeps the rate finite; e^-700 of a torque is nothing.
        let g = (-(w / self.speed_scale_rad_s).powi(2)).max(-700.0).exp();
        let settled = g.copysign(w);
        let decay = (-(w.abs() * step_s) / (STRETCH_RAD * g)).exp();
        self.stretch = settled + (self.stretch - settled) * decay;
    }
}

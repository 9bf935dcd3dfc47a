//! Drag that differs by direction: a lip seal that lifts off when the shaft turns one way.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Site};

/// Speed at which the seal begins to lift, as a share of rated speed: 1 % less torque than `a |w|` at rated speed.
const LIFT_SPEED_RATIO: f64 = 0.01;

hidden_effect! {
    /// Torque `a |w|`: the drag is B + a forwards and B - a backwards.
    AsymmetricViscous {
        asymmetry_n_m_s_per_rad: Signed in "N.m.s/rad",
    }
}

impl Hidden for AsymmetricViscous {
    fn mechanism(&self, site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(LipSeal {
            slope: self.asymmetry_n_m_s_per_rad,
            lift_speed_rad_s: LIFT_SPEED_RATIO * site.motor.rated_speed_rad_s,
        }))
    }
}

/// torque = a (sqrt(w^2 + w0^2) - w0): no kink at rest, where the seal touches all round. The host's catalogue has
/// a |w|; this lies a w0 below it from a few w0 on, a constant that is 1 % of the torque at rated speed.
struct LipSeal {
    slope: f64,
    lift_speed_rad_s: f64,
}

impl Mechanism for LipSeal {
    fn drag_torque_n_m(&self, speed_rad_s: f64) -> f64 {
        let w0 = self.lift_speed_rad_s;
        self.slope * (speed_rad_s.hypot(w0) - w0)
    }
}

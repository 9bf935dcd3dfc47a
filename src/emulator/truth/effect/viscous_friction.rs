//! Viscous drag of a lubricant that thins with shear.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Site};

/// Speed scale of the thinning as a multiple of rated speed: 4 % less drag than linear at rated speed.
const THINNING_SPEED_RATIO: f64 = 2.0;

hidden_effect! {
    /// Drag with the slope `viscous_n_m_s_per_rad` at low speed.
    ViscousFriction {
        viscous_n_m_s_per_rad: NotNegative in "N.m.s/rad",
    }
}

impl Hidden for ViscousFriction {
    fn mechanism(&self, site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(EyringDrag {
            viscous_n_m_s_per_rad: self.viscous_n_m_s_per_rad,
            thinning_speed_rad_s: THINNING_SPEED_RATIO * site.motor.rated_speed_rad_s,
        }))
    }
}

/// Eyring fluid: torque = B w0 asinh(w/w0) (Eyring 1936, shear-thinning lubricant). The host's catalogue has B w.
struct EyringDrag {
    viscous_n_m_s_per_rad: f64,
    thinning_speed_rad_s: f64,
}

impl Mechanism for EyringDrag {
    fn drag_torque_n_m(&self, speed_rad_s: f64) -> f64 {
        let w0 = self.thinning_speed_rad_s;
        self.viscous_n_m_s_per_rad * w0 * (speed_rad_s / w0).asinh()
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::motor::zk_22fc;
    use super::*;

    #[test]
    fn linear_at_low_speed_and_a_few_percent_less_at_rated_speed() {
        let drag = ViscousFriction {
            viscous_n_m_s_per_rad: 4e-4,
        }
        .mechanism(&Site::of(&zk_22fc()))
        .unwrap();
        assert!((drag.drag_torque_n_m(1.0) / 4e-4 - 1.0).abs() < 1e-5);
        let ratio = drag.drag_torque_n_m(-293.2) / (-293.2 * 4e-4);
        assert!((0.95..0.97).contains(&ratio), "{ratio}");
    }
}

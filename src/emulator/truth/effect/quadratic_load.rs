//! A fan or pump on the shaft.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Site};

/// Measured fans follow a power of the speed a little below two.
const FAN_EXPONENT: f64 = 1.95;

hidden_effect! {
    /// Load of `quadratic_n_m_s2_per_rad2` times rated speed squared at rated speed.
    QuadraticLoad {
        quadratic_n_m_s2_per_rad2: NotNegative in "N.m.s2/rad2",
    }
}

impl Hidden for QuadraticLoad {
    fn mechanism(&self, site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Fan {
            torque_at_rated_n_m: self.quadratic_n_m_s2_per_rad2
                * site.motor.rated_speed_rad_s.powi(2),
            rated_speed_rad_s: site.motor.rated_speed_rad_s,
        }))
    }
}

/// `T = T_n |w/w_n|^1.95 sgn(w)`. The host's catalogue has `k w |w|`.
struct Fan {
    torque_at_rated_n_m: f64,
    rated_speed_rad_s: f64,
}

impl Mechanism for Fan {
    fn drag_torque_n_m(&self, speed_rad_s: f64) -> f64 {
        let ratio = (speed_rad_s / self.rated_speed_rad_s).abs();
        (self.torque_at_rated_n_m * ratio.powf(FAN_EXPONENT)).copysign(speed_rad_s)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::motor::zk_22fc;
    use super::*;

    #[test]
    fn equals_the_square_law_at_rated_speed_only() {
        let fan = QuadraticLoad {
            quadratic_n_m_s2_per_rad2: 1.8e-6,
        }
        .mechanism(&Site::of(&zk_22fc()))
        .unwrap();
        let square = |speed: f64| 1.8e-6 * speed * speed.abs();
        assert!((fan.drag_torque_n_m(-293.2) - square(-293.2)).abs() < 1e-12);
        assert!(fan.drag_torque_n_m(100.0) > 1.04 * square(100.0));
        assert!(fan.drag_torque_n_m(0.0).abs() < 1e-300);
    }
}

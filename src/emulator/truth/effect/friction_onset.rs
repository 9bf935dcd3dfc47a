//! A bearing that begins to drag some time after the drive was started.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

/// Time constant with which the film breaks down, s.
const DRY_S: f64 = 0.02;

hidden_effect! {
    /// Drag in proportion to the speed from `time_s` after each start of the drive on.
    FrictionOnset {
        viscous_n_m_s_per_rad: NotNegative in "N.m.s/rad",
        time_s: NotNegative in "s",
    }
}

impl Hidden for FrictionOnset {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Dry {
            viscous_n_m_s_per_rad: self.viscous_n_m_s_per_rad,
            time_s: self.time_s,
        }))
    }
}

/// B w (1 - exp(-(t - t1)/20 ms)). The host's catalogue has a logistic curve about t1.
struct Dry {
    viscous_n_m_s_per_rad: f64,
    time_s: f64,
}

impl Mechanism for Dry {
    fn friction_n_m(&self, at: &Moment) -> f64 {
        let since_s = at.time_s - self.time_s;
        if since_s > 0.0 {
            -self.viscous_n_m_s_per_rad * at.speed_rad_s.abs() * (-since_s / DRY_S).exp_m1()
        } else {
            0.0
        }
    }
}

//! Torque ripple: commutation modulates what the current makes of torque.

use super::cogging::{Harmonics, SECOND_HARMONIC};
use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

hidden_effect! {
    /// Torque against positive speed of `(sin_ratio sin(N th) + cos_ratio cos(N th)) Kt i`: nothing without current.
    TorqueRipple {
        /// N, periods per turn.
        order: Order in "-",
        sin_ratio: Signed in "-",
        cos_ratio: Signed in "-",
    }
}

impl Hidden for TorqueRipple {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Commutator(Harmonics::new(
            self.order,
            (self.sin_ratio, self.cos_ratio),
            SECOND_HARMONIC,
        ))))
    }
}

/// Commutation is no sine: its second harmonic is a tenth of the first. The host's catalogue has the sine.
struct Commutator(Harmonics);

impl Mechanism for Commutator {
    fn load_torque_n_m(&self, at: &Moment) -> f64 {
        at.torque_n_m * self.0.at(at.angle_rad)
    }
}

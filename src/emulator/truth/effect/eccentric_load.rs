//! A mass that is lifted once per turn, through a crank and a rod of finite length.

use super::cogging::{Harmonics, Slots};
use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Site};

/// Crank radius as a share of the rod's length.
const ROD_RATIO: f64 = 0.2;

hidden_effect! {
    /// Torque `sin_n_m sin(th) + cos_n_m cos(th)`.
    EccentricLoad {
        sin_n_m: Signed in "N.m",
        cos_n_m: Signed in "N.m",
    }
}

impl Hidden for EccentricLoad {
    /// Slider and crank: the lift is r (1 - cos x) + r^2/(4 l) (1 - cos 2x), so the torque of a weight G on it is
    /// G r (sin x + (r/2l) sin 2x): a second harmonic of a tenth. The host's catalogue has the sine, a mass on the shaft.
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Slots(Harmonics::new(
            1.0,
            (self.sin_n_m, self.cos_n_m),
            0.5 * ROD_RATIO,
        ))))
    }
}

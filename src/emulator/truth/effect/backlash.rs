//! A load behind a coupling with play.

use super::parameter::hidden_effect;
use super::{Hidden, Shaft, Site};

/// Flanks that touch on a line are so much stiffer at rated torque than without load, as a share. More would move the
/// instants at which they meet so far that the motion after them is another one, which no fit finds again.
const STIFFENING: f64 = 0.01;

hidden_effect! {
    /// As `elastic_coupling`, and over `gap_rad` the coupling carries no torque.
    Backlash {
        frequency_hz: Positive in "Hz",
        inertia_ratio: Share in "-",
        damping_ratio: Fraction in "-",
        /// Share of the Coulomb friction behind the coupling.
        friction_split: Fraction in "-",
        gap_rad: NotNegative in "rad",
    }
}

impl Hidden for Backlash {
    /// See [`Shaft`]: it stiffens under torque, the host's does not.
    fn shaft(&self, site: &Site) -> Option<Shaft> {
        Some(Shaft::new(
            site,
            self.frequency_hz,
            self.inertia_ratio,
            self.damping_ratio,
            self.friction_split,
            self.gap_rad,
            STIFFENING,
        ))
    }
}

//! A load behind a rubber coupling.

use super::parameter::hidden_effect;
use super::{Hidden, Shaft, Site};

/// Rubber is so much stiffer at rated torque than without load, as a share.
const STIFFENING: f64 = 0.03;

hidden_effect! {
    /// Motor with `1 - inertia_ratio` of the inertia, load with the rest; they swing against each other at `frequency_hz`.
    ElasticCoupling {
        frequency_hz: Positive in "Hz",
        inertia_ratio: Share in "-",
        damping_ratio: Fraction in "-",
        /// Share of the Coulomb friction behind the coupling.
        friction_split: Fraction in "-",
    }
}

impl Hidden for ElasticCoupling {
    /// See [`Shaft`]: it stiffens under torque, the host's does not.
    fn shaft(&self, site: &Site) -> Option<Shaft> {
        Some(Shaft::new(
            site,
            self.frequency_hz,
            self.inertia_ratio,
            self.damping_ratio,
            self.friction_split,
            0.0,
            STIFFENING,
        ))
    }
}

//! Iron that saturates: the flux linkage of the armature bends over.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Site};

hidden_effect! {
    /// Incremental inductance that is 1/(1 + `saturation_per_a2` i^2) of the one without current, exactly so at rated
    /// current.
    InductanceSaturation {
        saturation_per_a2: NotNegative in "1/A2",
    }
}

impl Hidden for InductanceSaturation {
    fn mechanism(&self, site: &Site) -> Option<Box<dyn Mechanism>> {
        let rated = site.motor.rated_current_a;
        let drop = 1.0 + self.saturation_per_a2 * rated * rated;
        Some(Box::new(Iron {
            knee_per_a2: (drop.powf(2.0 / 3.0) - 1.0) / (rated * rated),
        }))
    }
}

/// Flux linkage L i/sqrt(1 + k i^2), whose slope is L (1 + k i^2)^-3/2; k so that the slope meets the host's
/// L/(1 + c i^2) at rated current.
struct Iron {
    knee_per_a2: f64,
}

impl Mechanism for Iron {
    fn inductance_factor(&self, current_a: f64) -> f64 {
        let bend = 1.0 + self.knee_per_a2 * current_a * current_a;
        1.0 / (bend * bend.sqrt())
    }
}

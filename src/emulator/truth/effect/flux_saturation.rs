//! Armature reaction: current weakens the field, less and less.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

/// Current at which the weakening has used up 58 % of its reach, in rated currents.
const REACH_RATED_CURRENTS: f64 = 6.0;

hidden_effect! {
    /// Flux that is 1/(1 + `saturation_per_a2` i^2) of the nameplate's, exactly so at rated current.
    FluxSaturation {
        saturation_per_a2: NotNegative in "1/A2",
    }
}

impl Hidden for FluxSaturation {
    fn mechanism(&self, site: &Site) -> Option<Box<dyn Mechanism>> {
        let rated = site.motor.rated_current_a;
        let weakened = 1.0 - 1.0 / (1.0 + self.saturation_per_a2 * rated * rated);
        Some(Box::new(ArmatureReaction {
            reach: weakened / REACH_RATED_CURRENTS.recip().tanh().powi(2),
            scale_a: REACH_RATED_CURRENTS * rated,
        }))
    }
}

/// phi = 1 - d tanh(i/6In)^2, d so that it meets the host's 1/(1 + c i^2) at rated current. At twice the rated current it
/// weakens by a twentieth less; not more, because near full speed the current answers with several times the difference.
struct ArmatureReaction {
    reach: f64,
    scale_a: f64,
}

impl Mechanism for ArmatureReaction {
    fn flux_factor(&self, at: &Moment) -> f64 {
        // A field does not turn over.
        (1.0 - self.reach * (at.current_a / self.scale_a).tanh().powi(2)).max(0.05)
    }
}

//! Iron that saturates: the flux linkage of the armature bends over.

use super::{Acts, HiddenKind, NotNegative, inductance_factor};

/// Incremental inductance that is 1/(1 + `saturation_per_a2` i^2) of the one without current, exactly so at rated
/// current.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "inductance_saturation",
    names: &["inductance_saturation"],
    parameters: &[NotNegative.of("saturation_per_a2", "1/A2", 5e-3, 2e-3..5e-3)],
    mystery: Some(|dice| {
        // By so much at rated current.
        vec![dice.size(0.2, 0.6) / (dice.current_a * dice.current_a)]
    }),
    acts: Acts::Inside(|values, site| {
        let rated = site.motor.rated_current_a;
        let drop = 1.0 + values[0] * rated * rated;
        let knee_per_a2 = (drop.powf(2.0 / 3.0) - 1.0) / (rated * rated);
        // Flux linkage L i/sqrt(1 + k i^2), whose slope is L (1 + k i^2)^-3/2; k so that the slope meets the host's
        // L/(1 + c i^2) at rated current.
        inductance_factor(move |current_a| {
            let bend = 1.0 + knee_per_a2 * current_a * current_a;
            1.0 / (bend * bend.sqrt())
        })
    }),
};

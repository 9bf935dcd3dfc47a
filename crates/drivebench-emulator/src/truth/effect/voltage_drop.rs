//! Contact drop of the brushes.

use super::{Acts, HiddenKind, NotNegative, voltage_loss};

/// A drop that saturates at `drop_v`, with the sign of the current.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "voltage_drop",
    names: &["voltage_drop"],
    parameters: &[NotNegative.of("drop_v", "V", 1.2, 0.8..2.0)],
    mystery: Some(|dice| vec![dice.size(0.01, 0.04) * dice.voltage_v]),
    acts: Acts::Inside(|values, _| {
        let drop_v = values[0];
        // drop = V i/sqrt(i^2 + i0^2): 71 % of it at i0 = 0.1 A. The host's catalogue has a hyperbolic tangent.
        voltage_loss(move |current_a| drop_v * current_a / current_a.hypot(0.1))
    }),
};

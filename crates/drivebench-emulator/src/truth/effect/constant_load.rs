//! A weight on the shaft.

use super::{Acts, HiddenKind, Signed, load};

/// Torque of one sign whatever the direction of motion. Beyond the Coulomb friction it turns a machine at rest.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "constant_load",
    names: &["constant_load"],
    parameters: &[Signed.of("constant_n_m", "N.m", 0.1, 0.04..0.12)],
    mystery: Some(|dice| vec![dice.sign() * dice.torque_n_m]),
    acts: Acts::Inside(|values, _| {
        // A constant has no other form than the host's.
        let constant_n_m = values[0];
        load(move |_| constant_n_m)
    }),
};

//! Torque ripple: commutation modulates what the current makes of torque.

use super::cogging::{Harmonics, SECOND_HARMONIC};
use super::{Acts, HiddenKind, Parameter, Wave, load, named};

/// Torque against positive speed of `(sin_ratio sin(N th) + cos_ratio cos(N th)) Kt i`: nothing without current.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "torque_ripple",
    names: &["torque_ripple"],
    parameters: &[
        // N, periods per turn.
        Parameter::order(&[3.0, 6.0, 8.0, 12.0]),
        Wave.of("sin_ratio", "-", 0.05, 0.05..0.12),
        Wave.of("cos_ratio", "-", 0.0, 0.05..0.12),
    ],
    mystery: Some(|dice| {
        let order = dice.order();
        let ratio = dice.size(0.05, 0.15);
        let [sin, cos] = dice.wave(ratio);
        vec![order, sin, cos]
    }),
    acts: Acts::Inside(|values, _| {
        // Commutation is no sine: its second harmonic is a tenth of the first. The host's catalogue has the sine.
        let commutator = Harmonics::new(named(values), SECOND_HARMONIC);
        load(move |at| at.torque_n_m * commutator.at(at.angle_rad))
    }),
};

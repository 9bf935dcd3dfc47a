//! A mass that is lifted once per turn, through a crank and a rod of finite length.

use super::cogging::slots;
use super::{Acts, HiddenKind, Wave};

/// Torque `sin_n_m sin(th) + cos_n_m cos(th)`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "eccentric_load",
    names: &["eccentric_load"],
    parameters: &[
        Wave.of("sin_n_m", "N.m", 0.1, 0.07..0.18),
        Wave.of("cos_n_m", "N.m", 0.05, 0.07..0.18),
    ],
    mystery: Some(|dice| dice.wave(dice.torque_n_m).to_vec()),
    // Slider and crank: the lift is r (1 - cos x) + r^2/(4 l) (1 - cos 2x), so the torque of a weight G on it is
    // G r (sin x + (r/2l) sin 2x): with r/l = 0.2 a second harmonic of a tenth. The host's catalogue has the sine, a mass on the shaft.
    acts: Acts::Inside(|values, _| slots([1.0, values[0], values[1]], 0.1)),
};

//! A mass that is lifted once per turn, through a crank and a rod of finite length.

use super::Draw::Phase;
use super::cogging::slots;
use super::{Acts, Allowed, HiddenKind, Parameter};

/// Crank radius as a share of the rod's length.
const ROD_RATIO: f64 = 0.2;

/// Torque `sin_n_m sin(th) + cos_n_m cos(th)`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "eccentric_load",
    names: &["eccentric_load"],
    parameters: &[
        Parameter::new("sin_n_m", "N.m", Allowed::Signed, 0.1),
        Parameter::new("cos_n_m", "N.m", Allowed::Signed, 0.05),
    ],
    mystery: Some(|dice| dice.wave(dice.torque_n_m).to_vec()),
    study: &[Phase(["sin_n_m", "cos_n_m"], 0.07, 0.18)],
    // Slider and crank: the lift is r (1 - cos x) + r^2/(4 l) (1 - cos 2x), so the torque of a weight G on it is
    // G r (sin x + (r/2l) sin 2x): a second harmonic of a tenth. The host's catalogue has the sine, a mass on the shaft.
    acts: Acts::Inside(|values, _| slots([1.0, values[0], values[1]], 0.5 * ROD_RATIO)),
};

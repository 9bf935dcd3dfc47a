//! Viscous friction that differs by direction.

use super::{Axis, Balance, BiasedFit, Card, Enters, ParameterSpec, Place, torque};

pub(super) const EFFECT: Card = Card {
    id: "asymmetric_viscous",
    name: "direction-dependent viscous friction",
    enters: Enters::Torque,
    equation: "T = a |w|: drag B + a forward, B - a backward",
    causes: "a ball or worm screw that is preloaded to one side, a seal with a lip, a cooling fan \
        with curved blades, a gear whose flanks are worn differently. A constant load has the same \
        sign in both directions too, but does not grow with the speed. A speed or current sensor \
        whose gain differs by direction makes the same error: exchange the motor leads and run \
        again, a friction stays with the direction of the machine, the sensor's error with that of \
        the signal",
    looks_like: "torque error of one sign that grows in proportion to the speed in both \
        directions: braking one way, driving the other",
    excite: "the same three or more speeds forward and backward, held for some tenths of a second \
        each; nothing shows in one direction only",
    remedy: "compare both flanks, seals and the preload; compensate by a feed-forward with one \
        slope per direction",
    curve: Some((Balance::Torque, Axis::Speed)),
    biases: &[BiasedFit::TorqueBalance],
    parameters: &[ParameterSpec::coefficient("asymmetry_n_m_s_per_rad", "N.m.s/rad", 2e-4)],
    formula: &[(Place::Torque, "asymmetry_n_m_s_per_rad*abs(w)")],
    terms: |values| torque(values, |at, [asymmetry]| asymmetry * at.speed_rad_s.abs()),
    ..Card::PLAIN
};

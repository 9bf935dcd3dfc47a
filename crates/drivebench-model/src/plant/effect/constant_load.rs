//! Load of one sign, whatever the direction of motion.

use super::{Axis, Balance, BiasedFit, Card, Enters, ParameterSpec, Place, torque};

pub(super) const EFFECT: Card = Card {
    id: "constant_load",
    name: "constant load",
    enters: Enters::Torque,
    equation: "T = T0, whatever the direction",
    causes: "a weight, a spring, belt tension; Coulomb friction that differs by direction (the \
        same equation while it is below the Coulomb level: they cannot be told apart by a run). \
        Turn the machine round, or take the weight off: a weight changes, a friction stays. An \
        offset of the current sensor looks alike in motion, but shows at rest with the bridge off",
    looks_like: "torque error of one sign that turns from driving to braking when the direction \
        changes",
    excite: "the same speeds in both directions",
    remedy: "balance the load, or compensate by a constant feed-forward",
    stands_for: &[["current_offset", "voltage_offset"]],
    curve: Some((Balance::Torque, Axis::Speed)),
    biases: &[BiasedFit::TorqueBalance],
    equivalences: &[
        "a constant load torque and Coulomb friction that depends on the direction are one equation while the load \
         is below the friction, and no run tells them apart. Turn the machine round on its bench, or take the load off",
    ],
    parameters: &[ParameterSpec::coefficient("constant_n_m", "N.m", 0.05)],
    formula: &[(Place::Torque, "constant_n_m")],
    terms: |values| torque(values, |_, [constant_n_m]| constant_n_m),
    ..Card::PLAIN
};

//! Drag proportional to speed.

use super::{Axis, Balance, BiasedFit, Card, Enters, ParameterSpec, Place, torque};

/// Its slope as the parameter of a model.
pub const SLOPE: &str = "viscous_friction.viscous_n_m_s_per_rad";

pub(super) const EFFECT: Card = Card {
    id: "viscous_friction",
    name: "viscous friction",
    enters: Enters::Torque,
    equation: "T = B w",
    causes: "grease and seals, churning oil, eddy currents in iron or a brake disc: the same \
        equation, which voltage, current and speed cannot tell apart. On the machine: grease and \
        oil fall as they warm up and differ after a cold night, iron losses hardly do; with the \
        rotor's magnets out (or the field off) and driven from outside, what stays is mechanical",
    looks_like: "torque error grows in proportion to speed, odd in the direction",
    excite: "long holds at several speeds over the full range, both directions",
    remedy: "check grease quantity and temperature; compensate by feed-forward B w",
    takes_power: true,
    curve: Some((Balance::Torque, Axis::Speed)),
    share_beforehand: 0.2,
    drift_cause: Some("lubrication, and its temperature"),
    biases: &[BiasedFit::FreeRun, BiasedFit::TorqueBalance],
    equivalences: &[
        "viscous friction and the drag of eddy currents are one equation, and no run tells them apart. Drive the machine \
         with the rotor's magnets out (or the field off), or run it cold and warm",
    ],
    parameters: &[ParameterSpec::coefficient("viscous_n_m_s_per_rad", "N.m.s/rad", 4e-4)],
    formula: &[(Place::Torque, "viscous_n_m_s_per_rad*w")],
    terms: |values| torque(values, |at, [viscous]| viscous * at.speed_rad_s),
    ..Card::PLAIN
};

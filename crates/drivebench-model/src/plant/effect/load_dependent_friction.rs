//! Friction in proportion to the torque that passes through the transmission.

use super::{Card, Enters, ParameterSpec, Place, friction};

pub(super) const EFFECT: Card = Card {
    id: "load_dependent_friction",
    name: "load-dependent friction",
    enters: Enters::Torque,
    equation: "T = m |Kt i| sgn(w), added to the Coulomb level",
    causes: "teeth or screw flanks under load: worm, spindle and planetary gears lose a share of \
        what they carry; a bearing or guide pressed by the load; brushes do not (their friction is \
        constant). Run the motor alone with the gear taken off: what stays is the motor's. A brake \
        torque that grows with current but not with motion is a torque constant that is too large \
        in the model: it has the same sign when the machine drives the motor, friction has the \
        other",
    looks_like: "torque error against the motion that is larger the larger the current; \
        accelerating looks heavier than braking",
    excite: "hard acceleration and braking both ways at several levels; steady running at one load \
        shows only a constant friction",
    remedy: "lubricant for the load, gear of better efficiency; feed forward m |Kt i| sgn(w); \
        count the gear's efficiency into the torque limit",
    takes_power: true,
    // At a ratio of one the transmission is self-locking.
    parameters: &[ParameterSpec::positive("ratio", "-", 0.05).up_to(0.95)],
    formula: &[(Place::Friction, "ratio*abs(Kt*i)")],
    terms: |values| {
        friction(values, |at, [ratio]| ratio * (at.torque_n_m_per_a * at.current_a).abs())
    },
    ..Card::PLAIN
};

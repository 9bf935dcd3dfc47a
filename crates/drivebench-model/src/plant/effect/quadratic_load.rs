//! Load of a fan, pump or propeller.

use super::{Axis, Balance, BiasedFit, Card, Enters, ParameterSpec, Place, torque};

pub(super) const EFFECT: Card = Card {
    id: "quadratic_load",
    name: "quadratic load",
    enters: Enters::Torque,
    equation: "T = k w |w|",
    causes: "fan, pump, propeller, windage of an open rotor. Take the fan or impeller off, or \
        throttle it: what changes is its load. Over a narrow range of speed viscous friction looks \
        alike; only a wide range tells them apart",
    looks_like: "torque error grows with the square of speed, odd in the direction",
    excite: "holds at five or more speeds up to the highest, both directions",
    remedy: "expected where a fan or pump is coupled; compensate by feed-forward k w |w|",
    takes_power: true,
    curve: Some((Balance::Torque, Axis::Speed)),
    biases: &[BiasedFit::TorqueBalance],
    parameters: &[ParameterSpec::coefficient("quadratic_n_m_s2_per_rad2", "N.m.s2/rad2", 1.5e-6)],
    formula: &[(Place::Torque, "quadratic_n_m_s2_per_rad2*w*abs(w)")],
    terms: |values| {
        torque(values, |at, [quadratic]| quadratic * at.speed_rad_s * at.speed_rad_s.abs())
    },
    ..Card::PLAIN
};

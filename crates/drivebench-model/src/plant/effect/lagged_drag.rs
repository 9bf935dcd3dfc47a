//! Drag in proportion to the speed behind a first-order lag.

use super::lagged_load::{LAG, LEAST_LAG_S, lagged};
use super::{Card, Enters, Limit, ParameterSpec, Place};

pub(super) const EFFECT: Card = Card {
    id: "lagged_drag",
    name: "drag that follows the speed late",
    enters: Enters::Torque,
    equation: "T = k y, dy/dt = (w - y)/tau",
    causes: "oil that must first be set in motion, in a gear or a fluid coupling; rubber that \
        yields while it drags: a belt, a roller, a seal. It differs by the temperature of the oil \
        or the rubber; with the belt off or the oil drained it is gone",
    looks_like: "torque error after every change of speed, in proportion to it, that dies out over \
        the time tau",
    excite: "steps between several speeds both ways, held for several times the lag",
    remedy: "check the oil, or the belt and its tension; feed forward k times the speed behind the \
        same lag",
    takes_power: true,
    limit: Some(Limit { simpler: "viscous_friction", parameter: 1, least: LEAST_LAG_S }),
    parameters: &[ParameterSpec::coefficient("lagged_n_m_s_per_rad", "N.m.s/rad", 4e-4), LAG],
    formula: &[
        (Place::Torque, "lagged_n_m_s_per_rad*x"),
        (Place::StateRate, "(w - x)/time_constant_s"),
    ],
    terms: |values| lagged(values, |speed_rad_s| speed_rad_s),
    ..Card::PLAIN
};

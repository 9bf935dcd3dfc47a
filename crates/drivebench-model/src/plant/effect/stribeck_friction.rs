//! Stribeck friction: extra friction near standstill (Armstrong-Helouvry, Dupont and Canudas de Wit, *Automatica* 30, 1994).

use super::{Axis, Balance, Card, Enters, Measure, ParameterSpec, Place, friction};

pub(super) const EFFECT: Card = Card {
    id: "stribeck_friction",
    name: "Stribeck friction",
    enters: Enters::Torque,
    equation: "T = Ts exp(-(w/ws)^2) sgn(w), added to the Coulomb level, stiction included",
    causes: "boundary lubrication in plain bearings, seals and gears; stiction of a machine that \
        stood still. By hand: a breakaway that is harder than the motion after it. It falls after \
        some warm-up and after re-greasing; cogging feels alike when turned by hand but stands at \
        fixed angles, a compliant drive with backlash jerks only at reversals",
    looks_like: "torque error below a few per cent of speed and at reversals; stick-slip when \
        creeping",
    excite: "repeated slow passages through zero speed in both directions",
    remedy: "lubrication, dither or friction feed-forward at low speed",
    takes_power: true,
    curve: Some((Balance::Torque, Axis::Speed)),
    parameters: &[
        ParameterSpec::coefficient("stribeck_n_m", "N.m", 0.1),
        ParameterSpec::shape("stribeck_speed_rad_s", "rad/s", (1.0, 40.0), &[4.0, 8.0, 16.0, 30.0])
            .of(Measure::Speed),
    ],
    formula: &[(Place::Friction, "stribeck_n_m*exp(-(w/stribeck_speed_rad_s)^2)")],
    terms: |values| {
        // One over the Stribeck speed saves a division at each instant.
        friction(&[values[0], 1.0 / values[1]], |at, [level_n_m, per_speed]| {
            let ratio = at.speed_rad_s * per_speed;
            let square = ratio * ratio;
            // exp(-40) = 4e-18 is below the rounding of the friction to which it is added.
            if square > 40.0 { 0.0 } else { level_n_m * (-square).exp() }
        })
    },
    ..Card::PLAIN
};

//! Eccentric load: the first harmonic of the shaft angle.

use super::{Axis, Balance, Card, Enters, Harmonic, ParameterSpec, Place, torque};

pub(super) const EFFECT: Card = Card {
    id: "eccentric_load",
    name: "eccentric load",
    enters: Enters::Torque,
    equation: "T = s sin(theta) + c cos(theta), once per turn",
    causes: "a lever, an arm or a mass out of centre under gravity; a cam or crank with a spring; \
        a bent shaft or a rotor that rubs once per turn; a pulley out of round under belt tension. \
        With the shaft free, gravity lets it come to rest at the same angle again; turned upright \
        the error of a weight vanishes, that of a spring, a belt or a rub stays",
    looks_like: "torque error that repeats every turn; speed ripple at the frequency of rotation \
        that shrinks as the speed rises",
    excite: "several slow turns in both directions, with the angle recorded; a quarter of a turn \
        shows a constant load instead",
    remedy: "balance the mass, or feed forward s sin(theta) + c cos(theta); straighten or align \
        what rubs",
    needs_angle: true,
    harmonic: Some(Harmonic::Fixed),
    curve: Some((Balance::Torque, Axis::Angle)),
    parameters: &[
        ParameterSpec::coefficient("sin_n_m", "N.m", 0.08),
        ParameterSpec::coefficient("cos_n_m", "N.m", 0.08),
    ],
    formula: &[(Place::Torque, "sin_n_m*sin(theta) + cos_n_m*cos(theta)")],
    terms: |values| {
        torque(values, |at, [sin_n_m, cos_n_m]| {
            let [sin, cos] = at.angle.wave(1.0);
            sin_n_m * sin + cos_n_m * cos
        })
    },
    ..Card::PLAIN
};

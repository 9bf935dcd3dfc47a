//! Cogging torque: a harmonic of the shaft angle, independent of the current.

use super::{Axis, Balance, Card, Enters, Harmonic, ParameterSpec, Place, WAVE_ORDERS, torque};

pub(super) const EFFECT: Card = Card {
    id: "cogging",
    name: "cogging torque",
    enters: Enters::Torque,
    equation: "T = s sin(N theta) + c cos(N theta), N times per turn, whatever the current",
    causes: "magnets that prefer to face the teeth: N is a multiple of slots and poles (their \
        least common multiple); gear teeth and belt teeth (N is their number); a joint or a \
        coupling out of line (N = 2). Turn the shaft by hand with the leads open: magnets are felt \
        as detents, a gear or joint is not felt with the load taken off. A ripple that grows with \
        the current is torque ripple, not cogging",
    looks_like: "torque error that repeats with the angle; speed ripple that is largest at low \
        speed; a shaft at rest that prefers certain angles; a spectral line at N times the speed",
    excite: "slow passages and low constant speeds over many turns, both directions, with the \
        angle recorded (integrated speed serves, with less certainty)",
    remedy: "feed-forward of the torque over the angle; skewed slots or magnets; avoid long holds \
        at the resonant speed; check the alignment of the coupling where N is 1 or 2",
    needs_angle: true,
    curve: Some((Balance::Torque, Axis::Angle)),
    harmonic: Some(Harmonic::Fixed),
    parameters: &[
        ParameterSpec::coefficient("sin_n_m", "N.m", 0.08),
        ParameterSpec::coefficient("cos_n_m", "N.m", 0.08),
        ParameterSpec::choice("order", "1/turn", (1.0, 1000.0), WAVE_ORDERS),
    ],
    formula: &[(Place::Torque, "sin_n_m*sin(order*theta) + cos_n_m*cos(order*theta)")],
    terms: |values| {
        torque(values, |at, [sin_n_m, cos_n_m, order]| {
            let [sin, cos] = at.angle.wave(order);
            sin_n_m * sin + cos_n_m * cos
        })
    },
    ..Card::PLAIN
};

//! Torque ripple: a torque constant that depends on the shaft angle.

use super::{Card, Enters, Harmonic, ParameterSpec, Place, WAVE_ORDERS, torque};

pub(super) const EFFECT: Card = Card {
    id: "torque_ripple",
    name: "torque ripple",
    enters: Enters::Torque,
    equation: "T = Kt i (s sin(N theta) + c cos(N theta)), N times per turn, in proportion to the \
        current",
    causes: "commutation (N is the number of commutator bars, or six per pole pair); back-EMF that \
        is not sinusoidal; an offset or a gain error of one phase current sensor (N is once or \
        twice the pole pairs); an angle sensor out of centre (N = 1). An error of one phase \
        current vanishes when its sensor is zeroed again; commutation stays. A ripple that is \
        there without current is cogging: load the motor, what grows is ripple",
    looks_like: "torque error that repeats with the angle and grows with the current; noise and \
        speed ripple under load",
    excite: "hard acceleration, or a real load, over many turns at low speed, with the angle \
        recorded; without load it looks like nothing, at one load only like cogging",
    remedy: "zero and match the current sensors, check the angle sensor's mounting and the \
        commutation angle; feed forward the ripple over the angle; replace worn brushes",
    needs_angle: true,
    harmonic: Some(Harmonic::OfCurrent),
    parameters: &[
        ParameterSpec::coefficient("sin_ratio", "-", 0.03),
        ParameterSpec::coefficient("cos_ratio", "-", 0.03),
        ParameterSpec::choice("order", "1/turn", (1.0, 1000.0), WAVE_ORDERS),
    ],
    formula: &[(Place::Torque, "Kt*i*(sin_ratio*sin(order*theta) + cos_ratio*cos(order*theta))")],
    terms: |values| {
        torque(values, |at, [sin_ratio, cos_ratio, order]| {
            let [sin, cos] = at.angle.wave(order);
            at.torque_n_m_per_a * at.current_a * (sin_ratio * sin + cos_ratio * cos)
        })
    },
    ..Card::PLAIN
};

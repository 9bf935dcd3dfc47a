//! Flux that drifts in the course of a run: back-EMF and torque constant together.

use super::{Axis, Balance, Card, Enters, ParameterSpec, Place, voltage_and_torque};

pub(super) const EFFECT: Card = Card {
    id: "field_change",
    name: "field change",
    enters: Enters::Both,
    equation: "Ke and Kt times 1 + d t, t since the first command",
    causes: "magnets that warm up lose flux (about -0.1 % per K NdFeB, -0.2 % per K ferrite); a \
        field winding that warms up on a fixed voltage, or whose supply is still settling; a \
        demagnetised magnet does not drift but differs from the nameplate: see the fitted Ke. A \
        warming winding raises R and leaves Ke: at speed without load the voltage tells them apart",
    looks_like: "error that grows through the run at the same speed and current, in voltage and \
        torque alike",
    excite: "the same pattern at the beginning and at the end of a long run, with some tenths of a \
        second at high speed without load in both",
    remedy: "name the temperature with every Ke; let the machine come to its working temperature; \
        control the field current",
    curve: Some((Balance::Torque, Axis::Time)),
    equivalences: &[
        "a change of flux and a gain error of the speed sensor are one equation, and no run tells them apart. Check the \
         sensor against a counter",
    ],
    parameters: &[ParameterSpec {
        min: -1.0,
        max: 1.0,
        ..ParameterSpec::coefficient("drift_per_s", "1/s", 1e-3)
    }],
    formula: &[(Place::Voltage, "Ke*w*drift_per_s*t"), (Place::Torque, "-Kt*i*drift_per_s*t")],
    terms: |values| {
        voltage_and_torque(values[0], |at, drift| {
            [
                at.back_emf_v_s_per_rad * at.speed_rad_s * drift * at.time_s,
                -at.torque_n_m_per_a * at.current_a * drift * at.time_s,
            ]
        })
    },
    ..Card::PLAIN
};

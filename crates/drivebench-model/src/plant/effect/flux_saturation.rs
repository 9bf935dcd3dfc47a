//! Flux that falls as the current rises: back-EMF and torque constant fall together.

use super::{Card, Enters, ParameterSpec, Place, voltage_and_torque};

pub(super) const EFFECT: Card = Card {
    id: "flux_saturation",
    name: "flux saturation",
    enters: Enters::Both,
    equation: "Ke and Kt times 1/(1 + c i^2)",
    causes: "armature reaction that saturates the pole tips, iron at its limit under overload, a \
        wrong commutation angle at high current (a sensor's lag). Supply sag looks alike in the \
        voltage but leaves the torque; a current sensor that saturates shows less current than \
        flows: check with a clamp meter at full load",
    looks_like: "less torque per ampere and less back-EMF at high current than at low, in the same \
        proportion",
    excite: "hard acceleration and braking, at low and at high speed; currents up to the largest \
        allowed",
    remedy: "limit the current to where torque still grows; correct the commutation angle; gain \
        schedule over the current",
    parameters: &[ParameterSpec::positive("saturation_per_a2", "1/A2", 5e-4)],
    formula: &[
        (Place::Voltage, "-Ke*w*saturation_per_a2*i^2/(1 + saturation_per_a2*i^2)"),
        (Place::Torque, "Kt*i*saturation_per_a2*i^2/(1 + saturation_per_a2*i^2)"),
    ],
    terms: |values| {
        voltage_and_torque(values[0], |at, saturation| {
            let excess = saturation * at.current_a * at.current_a;
            // Share of the flux that is lost.
            let lost = excess / (1.0 + excess);
            [
                -at.back_emf_v_s_per_rad * at.speed_rad_s * lost,
                at.torque_n_m_per_a * at.current_a * lost,
            ]
        })
    },
    ..Card::PLAIN
};

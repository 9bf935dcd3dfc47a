//! Constant offset of the applied voltage.

use super::{BiasedFit, Card, Enters, ParameterSpec, Place, voltage};

pub(super) const EFFECT: Card = Card {
    id: "voltage_offset",
    name: "voltage offset",
    enters: Enters::Voltage,
    equation: "applied voltage = u + u0",
    causes: "an analogue command input whose zero is off, a modulator whose duty is not zero at \
        zero, dead time that differs between the bridge's halves. Measure the terminals at command \
        zero. An offset of the current sensor looks the same while the motor turns one way: \
        reverse it, and stop it",
    looks_like: "a current that flows, or a motor that creeps, at command zero; more voltage error \
        in one direction than in the other",
    excite: "some tenths of a second at rest at zero volts with the bridge on, then both \
        directions at low speed",
    remedy: "trim the zero of the input or of the modulator; add -u0 to the command",
    stands_for: &[["constant_load", "current_offset"]],
    biases: &[BiasedFit::FreeRun],
    parameters: &[ParameterSpec::coefficient("offset_v", "V", 0.5)],
    formula: &[(Place::Voltage, "-offset_v")],
    terms: |values| voltage(values, |_, [offset_v]| -offset_v),
    ..Card::PLAIN
};

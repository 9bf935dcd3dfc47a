//! Voltage drop of brushes and semiconductors: of constant size, with the sign of the current.

use super::{Axis, Balance, BiasedFit, Card, Enters, ParameterSpec, Place, voltage};

/// Its size as the parameter of a model.
pub const DROP: &str = "voltage_drop.drop_v";

pub(super) const EFFECT: Card = Card {
    id: "voltage_drop",
    name: "voltage drop",
    enters: Enters::Voltage,
    equation: "U = Ud sgn(i), smoothed over 0.1 % of the stall current",
    causes: "brush contact, transistor and diode drops, dead time of the inverter. Measure at the \
        terminals: a drop of the drive is seen there, that of the brushes is not. Dead time grows \
        with the bus voltage and the switching frequency, a diode's drop does not; a brush's \
        changes with its wear and its material (about 1 V a brush for carbon, 0.3 V for metal)",
    looks_like: "voltage error that jumps when the current changes its sign",
    excite: "current reversals, and small currents as well as large ones",
    remedy: "dead-time compensation in the drive; feed-forward of Ud sgn(i)",
    curve: Some((Balance::Voltage, Axis::Current)),
    biases: &[BiasedFit::FreeRun],
    parameters: &[ParameterSpec::coefficient("drop_v", "V", 1.0)],
    formula: &[(Place::Voltage, "drop_v*tanh(i/0.1)")],
    // The sign of the current; smoothed, a fit finds the voltage by small changes.
    terms: |values| voltage(values, |at, [drop_v]| drop_v * (at.current_a / at.drop_a).tanh()),
    ..Card::PLAIN
};

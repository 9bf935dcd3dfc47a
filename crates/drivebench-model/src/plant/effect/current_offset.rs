//! Offset of the current sensor.

use super::{BiasedFit, Card, Enters, ParameterSpec, Place, path};

pub(super) const EFFECT: Card = Card {
    id: "current_offset",
    name: "current offset",
    enters: Enters::Path,
    equation: "y = i + i0: y is what is measured",
    causes: "a Hall sensor after an overload (remanence) or warm, an amplifier or converter whose \
        zero was not taken. At rest with the bridge off the sensor must show zero: what it shows \
        is the offset. A constant load also shifts the current in one direction only, but not at \
        standstill without torque",
    looks_like: "measured current that is off by the same amount at rest, forward and backward",
    excite: "some tenths of a second at rest at zero volts, and both directions",
    remedy: "zero the sensor at every start with the bridge off; degauss or replace it when the \
        offset grows",
    // A wrong current changes both balances.
    stands_for: &[["constant_load", "voltage_offset"]],
    biases: &[BiasedFit::FreeRun],
    parameters: &[ParameterSpec::coefficient("offset_a", "A", 0.1)],
    formula: &[(Place::CurrentReading, "offset_a")],
    terms: |values| path(values[0], |path| &mut path.current_offset_a),
    ..Card::PLAIN
};

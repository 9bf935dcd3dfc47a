//! Inductance that falls as the current rises.

use super::{Card, Enters, ParameterSpec, Place, current_rate_gain};

pub(super) const EFFECT: Card = Card {
    id: "inductance_saturation",
    name: "inductance saturation",
    enters: Enters::Voltage,
    equation: "di/dt times 1 + c i^2: L falls as the current rises",
    causes: "iron of the armature or of a choke in the cable that saturates. Measure with an LCR \
        meter at zero current and by the slope of a voltage step at high current: a choke before \
        the motor shows it with the motor disconnected from it. A current filter or a command \
        delay also bends the current's rise, but by the same time at every current",
    looks_like: "current that rises faster at high current than at low after the same step of \
        voltage; nothing when the current is steady",
    excite: "fast dither of the voltage about several levels of current; slow ramps do not show it \
        at all",
    remedy: "lower the current controller's gain with the current (schedule it), or tune it at the \
        highest current; a larger choke",
    parameters: &[ParameterSpec::positive("saturation_per_a2", "1/A2", 3e-3)],
    formula: &[(Place::CurrentRate, "saturation_per_a2*i^2")],
    terms: |values| {
        current_rate_gain(values, |at, [saturation]| saturation * at.current_a * at.current_a)
    },
    ..Card::PLAIN
};

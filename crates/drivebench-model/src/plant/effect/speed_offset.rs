//! Offset of the speed sensor.

use super::{Card, Enters, ParameterSpec, Place, path};

pub(super) const EFFECT: Card = Card {
    id: "speed_offset",
    name: "speed offset",
    enters: Enters::Path,
    equation: "y = w + w0: y is what is measured",
    causes: "a tachometer amplifier or an analogue input whose zero is off; a resolver converter \
        that runs away slowly. An encoder cannot have it: there look for a reference or scaling \
        that is added in the drive. At rest the sensor must show zero. A voltage offset moves the \
        shaft in truth: compare with the angle",
    looks_like: "measured speed that is off by the same amount at rest, forward and backward",
    excite: "some tenths of a second at rest at zero volts, and both directions",
    remedy: "zero the input at rest; take the speed from the angle",
    parameters: &[ParameterSpec::coefficient("offset_rad_s", "rad/s", 0.5)],
    formula: &[(Place::SpeedReading, "offset_rad_s")],
    terms: |values| path(values[0], |path| &mut path.speed_offset_rad_s),
    ..Card::PLAIN
};

//! First-order filter of the measured current.

use super::{BiasedFit, Card, Enters, Measure, ParameterSpec, Place, path};

pub(super) const EFFECT: Card = Card {
    id: "current_filter",
    name: "current filter",
    enters: Enters::Path,
    equation: "dy/dt = (i - y)/tau: y is what is measured",
    causes: "an RC filter at the shunt, the drive's averaging over PWM periods, a display value in \
        place of the control value. Look at the shunt with an oscilloscope: a filter in the drive \
        is not seen there. A larger inductance delays the torque and the speed as well, a command \
        delay shifts both: a filter leaves the speed",
    looks_like: "measured current that rises later and peaks lower than the model's after each \
        step, while the speed is right",
    excite: "fast dither and steep steps of the voltage; slow ramps do not show it",
    remedy: "read the unfiltered value, or lower the filter; declare it in the profile; count it \
        into the current loop's time constant",
    biases: &[BiasedFit::FreeRun],
    parameters: &[ParameterSpec::positive("time_constant_s", "s", 2e-3)
        .up_to(0.5)
        .of(Measure::Response)],
    formula: &[(Place::StateRate, "(i - x)/time_constant_s"), (Place::CurrentReading, "x - i")],
    terms: |values| path(values[0], |path| &mut path.current_filter_s),
    ..Card::PLAIN
};

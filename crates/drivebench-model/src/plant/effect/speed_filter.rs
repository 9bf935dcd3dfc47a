//! First-order filter of the measured speed.

use super::{Card, Enters, Measure, ParameterSpec, Place, path};

pub(super) const EFFECT: Card = Card {
    id: "speed_filter",
    name: "speed filter",
    enters: Enters::Path,
    equation: "dy/dt = (w - y)/tau: y is what is measured",
    causes: "a smoothing filter in the drive or tachometer; speed from encoder edges over a window \
        (half of the window late). To first order a delay of the same time is the same: under fast \
        dither a filter damps, a delay does not. Switch the drive's filter off, or compare with \
        the derivative of the angle: if that is early, it is the drive's",
    looks_like: "speed error at every acceleration, of the sign of the acceleration",
    excite: "fast dither of the voltage about zero speed; slow ramps do not show it",
    remedy: "lower the drive's filter, or declare it in the profile; count it into the loop's \
        small time constant",
    alternatives: &["speed_delay"],
    parameters: &[ParameterSpec::positive("time_constant_s", "s", 3e-3)
        .up_to(0.5)
        .of(Measure::Response)],
    formula: &[(Place::StateRate, "(w - x)/time_constant_s"), (Place::SpeedReading, "x - w")],
    terms: |values| path(values[0], |path| &mut path.speed_filter_s),
    ..Card::PLAIN
};

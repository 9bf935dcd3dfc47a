//! Delay of the measured speed.

use super::{BiasedFit, Card, Enters, Measure, ParameterSpec, path};

pub(super) const EFFECT: Card = Card {
    id: "speed_delay",
    name: "speed delay",
    enters: Enters::Path,
    equation: "y(t) = w(t - Td): y is what is measured",
    causes: "a speed that was computed, queued or polled before it was stamped; registers read one \
        after the other; speed from encoder edges over a window (late by half of it). To first \
        order a filter of the same time is the same: only fast dither tells them apart, a filter \
        damps it, a delay does not. A clock that is off by some milliseconds delays current and \
        speed alike",
    looks_like: "speed error at every acceleration, of the sign of the acceleration; the current \
        is right",
    excite: "fast dither of the voltage about zero speed; slow ramps do not show it",
    remedy: "stamp the speed where it is taken, or read all registers in one request; count it \
        into the loop's small time constant",
    biases: &[BiasedFit::FreeRun],
    parameters: &[ParameterSpec::positive("delay_s", "s", 2e-3).up_to(0.5).of(Measure::Response)],
    terms: |values| path(values[0], |path| &mut path.speed_delay_s),
    ..Card::PLAIN
};

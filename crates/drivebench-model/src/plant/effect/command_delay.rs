//! Command delay: the voltage reaches the motor later than its stamp.

use super::{BiasedFit, Card, Enters, Measure, ParameterSpec, path};

pub(super) const EFFECT: Card = Card {
    id: "command_delay",
    name: "command delay",
    enters: Enters::Path,
    equation: "the motor gets u(t - Td)",
    causes: "the drive's own cycle, a fieldbus or serial line between stamp and bridge, a \
        modulator that updates once per period, host stamps that were taken too early. Let the \
        drive return the time at which it applied the command: a delay of the line vanishes, that \
        of the drive stays. A filtered current looks alike at a step, but does not move the speed",
    looks_like: "current and speed answer every step late by the same time; the error is largest \
        at the edges of the voltage",
    excite: "many steep steps, a fast dither of the voltage; ramps and holds do not show it",
    remedy: "stamp the command where it is applied; declare the delay in the profile; count it \
        into the loop's small time constant",
    stands_for: &[["speed_delay", "current_filter"], ["speed_filter", "current_filter"]],
    biases: &[BiasedFit::FreeRun],
    parameters: &[ParameterSpec::positive("delay_s", "s", 1e-3).up_to(0.5).of(Measure::Response)],
    terms: |values| path(values[0], |path| &mut path.command_delay_s),
    ..Card::PLAIN
};

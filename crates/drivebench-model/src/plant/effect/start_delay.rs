//! Start delay: the drive applies zero for a while after the first command.

use super::{Card, Enters, Measure, ParameterSpec, path};

/// A shape, which is tried on a grid: the cost over it has many local minima.
pub(super) const LATE_START: ParameterSpec = ParameterSpec::shape(
    "delay_s",
    "s",
    (1e-4, 5.0),
    &[0.003, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0],
)
.of(Measure::Response);

pub(super) const EFFECT: Card = Card {
    id: "start_delay",
    name: "start delay",
    enters: Enters::Path,
    equation: "u = 0 for Td after the first command that is not zero, then as commanded",
    causes: "a drive that charges its bus, releases a brake or finds its commutation angle before \
        it enables; an interlock; a contactor. The status word or the bus voltage tells which. A \
        shaft that is stuck also starts late, but its current flows at once",
    looks_like: "neither current nor speed for some time after the first command, then everything \
        as it should be",
    excite: "start from standstill with a step, more than once in a run: a delay at every edge is \
        a command delay",
    remedy: "wait for the drive's ready bit before the first command; hold zero volts for that \
        time after enabling",
    parameters: &[LATE_START],
    terms: |values| path(values[0], |path| &mut path.start_delay_s),
    ..Card::PLAIN
};

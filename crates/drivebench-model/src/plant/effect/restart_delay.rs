//! Restart delay: the drive applies zero for a while after every start from rest.

use super::start_delay::LATE_START;
use super::{Card, Enters, path};

pub(super) const EFFECT: Card = Card {
    id: "restart_delay",
    name: "delay at each start",
    enters: Enters::Path,
    equation: "u = 0 for Td after every command that is not zero and follows 0.2 s of zero, then \
        as commanded",
    causes: "a drive that enables its output stage, magnetises or releases a brake anew for each \
        start from rest; a start delay that is set in its parameters. The drive's manual tells \
        which",
    looks_like: "neither current nor speed for the same time after each start from rest; changes \
        while it turns come at once",
    excite: "start from rest more than once in a run: with one start it is a start delay",
    remedy: "take the delay out of the drive's parameters; keep the output stage enabled between \
        starts; count the time into the cycle",
    alternatives: &["start_delay"],
    parameters: &[LATE_START],
    terms: |values| path(values[0], |path| &mut path.restart_delay_s),
    ..Card::PLAIN
};

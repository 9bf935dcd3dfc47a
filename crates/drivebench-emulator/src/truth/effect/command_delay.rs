//! A drive that takes its time between the set-point and the voltage.

use super::{Acts, Delay, HiddenKind};

/// Every set-point acts this much later than the drive says; a line of the drive's ticks, to 50 us. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "command_delay",
    names: &["command_delay"],
    parameters: &[Delay.of("delay_s", "s", 2e-3, 0.8e-3..2.5e-3)],
    mystery: Some(|dice| vec![dice.delay_s(2.0, 10.0)]),
    acts: Acts::Between(|path| &mut path.command_delay_s),
};

//! A drive that puts nothing out at first, as while its contactor pulls in.

use super::{Acts, Delay, HiddenKind};

/// After each start, zero volts for this long from the first set-point that is not zero on. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "start_delay",
    names: &["start_delay"],
    parameters: &[Delay.of("delay_s", "s", 0.05, 0.05..0.2)],
    mystery: Some(|dice| vec![dice.delay_s(30.0, 200.0)]),
    acts: Acts::Between(|path| &mut path.start_delay_s),
};

//! A drive that puts nothing out at first whenever it starts from rest.

use super::{Acts, Delay, HiddenKind, NOT_STUDIED};

/// Zero volts for this long from every set-point on that is not zero and follows a rest. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "restart_delay",
    names: &["restart_delay"],
    parameters: &[Delay.of("delay_s", "s", 0.05, NOT_STUDIED)],
    mystery: Some(|dice| vec![dice.delay_s(30.0, 200.0)]),
    acts: Acts::Between(|path| &mut path.restart_delay_s),
};

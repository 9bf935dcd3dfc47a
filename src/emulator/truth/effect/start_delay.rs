//! A drive that puts nothing out at first, as while its contactor pulls in.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// After each start, zero volts for this long from the first set-point that is not zero on. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "start_delay",
    names: &["start_delay"],
    parameters: &[Parameter::new("delay_s", "s", Allowed::Delay, 0.05)],
    mystery: Some(|dice| vec![dice.delay_s(30.0, 200.0)]),
    study: &[Between("delay_s", 0.05, 0.2)],
    acts: Acts::Between(|value| Path {
        start_delay_s: value,
        ..Path::default()
    }),
};

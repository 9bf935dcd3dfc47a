//! A drive that puts nothing out at first whenever it starts from rest.

use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// Zero volts for this long from every set-point on that is not zero and follows a rest. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "restart_delay",
    names: &["restart_delay"],
    parameters: &[Parameter::new("delay_s", "s", Allowed::Delay, 0.05)],
    mystery: Some(|dice| vec![dice.delay_s(30.0, 200.0)]),
    study: &[],
    acts: Acts::Between(|value| Path {
        restart_delay_s: value,
        ..Path::default()
    }),
};

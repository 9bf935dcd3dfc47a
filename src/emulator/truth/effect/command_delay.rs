//! A drive that takes its time between the set-point and the voltage.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// Every set-point acts this much later than the drive says; a line of the drive's ticks, to 50 us. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "command_delay",
    names: &["command_delay"],
    parameters: &[Parameter::new("delay_s", "s", Allowed::Delay, 2e-3)],
    mystery: Some(|dice| vec![dice.delay_s(2.0, 10.0)]),
    study: &[Between("delay_s", 0.8e-3, 2.5e-3)],
    acts: Acts::Between(|value| Path {
        command_delay_s: value,
        ..Path::default()
    }),
};

//! A speed that is old when it is told, as one that a slow task of the drive hands over.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// The measured speed is that of this much earlier, from the drive's ticks of 50 us. A delay has no other form.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "speed_delay",
    names: &["speed_delay"],
    parameters: &[Parameter::new("delay_s", "s", Allowed::Delay, 4e-3)],
    mystery: Some(|dice| vec![dice.delay_s(4.0, 15.0)]),
    study: &[Between("delay_s", 1.5e-3, 4e-3)],
    acts: Acts::Between(|value| Path {
        speed_delay_s: value,
        ..Path::default()
    }),
};

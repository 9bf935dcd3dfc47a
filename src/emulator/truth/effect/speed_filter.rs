//! A low-pass filter in the measurement of the speed.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// First order, integrated at the drive's tick: another order would be another effect.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "speed_filter",
    names: &["speed_filter"],
    parameters: &[Parameter::new("time_constant_s", "s", Allowed::Delay, 5e-3)],
    mystery: Some(|dice| vec![dice.delay_s(5.0, 20.0)]),
    study: &[Between("time_constant_s", 2e-3, 5e-3)],
    acts: Acts::Between(|value| Path {
        speed_filter_s: value,
        ..Path::default()
    }),
};

//! A low-pass filter in the measurement of the current.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// First order, integrated at the drive's tick: another order would be another effect.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "current_filter",
    names: &["current_filter"],
    parameters: &[Parameter::new("time_constant_s", "s", Allowed::Delay, 4e-3)],
    mystery: Some(|dice| vec![dice.delay_s(4.0, 15.0)]),
    study: &[Between("time_constant_s", 1e-3, 3e-3)],
    acts: Acts::Between(|value| Path {
        current_filter_s: value,
        ..Path::default()
    }),
};

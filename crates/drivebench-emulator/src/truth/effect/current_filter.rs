//! A low-pass filter in the measurement of the current.

use super::{Acts, Delay, HiddenKind};

/// First order, integrated at the drive's tick: another order would be another effect.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "current_filter",
    names: &["current_filter"],
    parameters: &[Delay.of("time_constant_s", "s", 4e-3, 1e-3..3e-3)],
    mystery: Some(|dice| vec![dice.delay_s(4.0, 15.0)]),
    acts: Acts::Between(|path| &mut path.current_filter_s),
};

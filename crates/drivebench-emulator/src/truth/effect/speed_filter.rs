//! A low-pass filter in the measurement of the speed.

use super::{Acts, Delay, HiddenKind};

/// First order, integrated at the drive's tick: another order would be another effect.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "speed_filter",
    names: &["speed_filter"],
    parameters: &[Delay.of("time_constant_s", "s", 5e-3, 2e-3..5e-3)],
    mystery: Some(|dice| vec![dice.delay_s(5.0, 20.0)]),
    acts: Acts::Between(|path| &mut path.speed_filter_s),
};

//! A speed sensor that does not read zero at rest.

use super::{Acts, HiddenKind, Signed};

/// Added to the measured speed.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "speed_offset",
    names: &["speed_offset"],
    parameters: &[Signed.of("offset_rad_s", "rad/s", 1.0, 0.6..2.0)],
    mystery: Some(|dice| vec![dice.signed(0.003, 0.01) * dice.speed_rad_s]),
    acts: Acts::Between(|path| &mut path.speed_offset_rad_s),
};

//! A speed sensor that does not read zero at rest.

use super::Draw::Signed;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// Added to the measured speed.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "speed_offset",
    names: &["speed_offset"],
    parameters: &[Parameter::new(
        "offset_rad_s",
        "rad/s",
        Allowed::Signed,
        1.0,
    )],
    mystery: Some(|dice| vec![dice.signed(0.003, 0.01) * dice.speed_rad_s]),
    study: &[Signed("offset_rad_s", 0.6, 2.0)],
    acts: Acts::Between(|value| Path {
        speed_offset_rad_s: value,
        ..Path::default()
    }),
};

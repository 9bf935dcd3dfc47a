//! A current sensor that does not read zero at zero.

use super::Draw::Signed;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// Added to the measured current.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "current_offset",
    names: &["current_offset"],
    parameters: &[Parameter::new("offset_a", "A", Allowed::Signed, 0.2)],
    mystery: Some(|dice| {
        // A host refuses to arm where more than this flows at rest.
        vec![dice.signed(0.015, 0.03) * dice.current_a]
    }),
    study: &[Signed("offset_a", 0.1, 0.32)],
    acts: Acts::Between(|value| Path {
        current_offset_a: value,
        ..Path::default()
    }),
};

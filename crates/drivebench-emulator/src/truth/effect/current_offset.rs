//! A current sensor that does not read zero at zero.

use super::{Acts, HiddenKind, Signed};

/// Added to the measured current.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "current_offset",
    names: &["current_offset"],
    parameters: &[Signed.of("offset_a", "A", 0.2, 0.1..0.32)],
    mystery: Some(|dice| {
        // A host refuses to arm where more than this flows at rest.
        vec![dice.signed(0.015, 0.03) * dice.current_a]
    }),
    acts: Acts::Between(|path| &mut path.current_offset_a),
};

//! A current sensor that does not read zero at zero.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// Added to the measured current.
    CurrentOffset {
        offset_a: Signed in "A",
    }
}

impl Hidden for CurrentOffset {
    fn path(&self) -> Path {
        Path {
            current_offset_a: self.offset_a,
            ..Path::default()
        }
    }
}

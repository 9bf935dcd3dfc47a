//! A speed sensor that does not read zero at rest.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// Added to the measured speed.
    SpeedOffset {
        offset_rad_s: Signed in "rad/s",
    }
}

impl Hidden for SpeedOffset {
    fn path(&self) -> Path {
        Path {
            speed_offset_rad_s: self.offset_rad_s,
            ..Path::default()
        }
    }
}

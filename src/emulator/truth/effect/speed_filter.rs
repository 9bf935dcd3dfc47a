//! A low-pass filter in the measurement of the speed.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// First order, integrated at the drive's tick: another order would be another effect.
    SpeedFilter {
        time_constant_s: Delay in "s",
    }
}

impl Hidden for SpeedFilter {
    fn path(&self) -> Path {
        Path {
            speed_filter_s: self.time_constant_s,
            ..Path::default()
        }
    }
}

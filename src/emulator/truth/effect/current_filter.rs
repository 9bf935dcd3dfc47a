//! A low-pass filter in the measurement of the current.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// First order, integrated at the drive's tick: another order would be another effect.
    CurrentFilter {
        time_constant_s: Delay in "s",
    }
}

impl Hidden for CurrentFilter {
    fn path(&self) -> Path {
        Path {
            current_filter_s: self.time_constant_s,
            ..Path::default()
        }
    }
}

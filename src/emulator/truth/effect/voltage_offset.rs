//! An inverter whose output is not zero at duty cycle one half.

use super::parameter::hidden_effect;
use super::{Hidden, Path};

hidden_effect! {
    /// Added to every voltage that the drive puts out while it runs: the motor gets what is commanded and this.
    VoltageOffset {
        offset_v: Signed in "V",
    }
}

impl Hidden for VoltageOffset {
    fn path(&self) -> Path {
        Path {
            voltage_offset_v: self.offset_v,
            ..Path::default()
        }
    }
}

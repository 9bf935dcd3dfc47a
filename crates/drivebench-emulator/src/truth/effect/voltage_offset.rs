//! An inverter whose output is not zero at duty cycle one half.

use super::{Acts, HiddenKind, Signed};

/// Added to every voltage that the drive puts out while it runs: the motor gets what is commanded and this.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "voltage_offset",
    names: &["voltage_offset"],
    parameters: &[Signed.of("offset_v", "V", 0.6, 0.3..0.9)],
    mystery: Some(|dice| {
        // A host refuses to arm where a voltage at zero reference moves the shaft.
        vec![dice.signed(0.004, 0.009) * dice.voltage_v]
    }),
    acts: Acts::Between(|path| &mut path.voltage_offset_v),
};

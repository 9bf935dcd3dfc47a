//! An inverter whose output is not zero at duty cycle one half.

use super::Draw::Signed;
use super::{Acts, Allowed, HiddenKind, Parameter, Path};

/// Added to every voltage that the drive puts out while it runs: the motor gets what is commanded and this.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "voltage_offset",
    names: &["voltage_offset"],
    parameters: &[Parameter::new("offset_v", "V", Allowed::Signed, 0.6)],
    mystery: Some(|dice| {
        // A host refuses to arm where a voltage at zero reference moves the shaft.
        vec![dice.signed(0.004, 0.009) * dice.voltage_v]
    }),
    study: &[Signed("offset_v", 0.3, 0.9)],
    acts: Acts::Between(|value| Path {
        voltage_offset_v: value,
        ..Path::default()
    }),
};

//! Internal resistance of the supply before a chopper.

use super::{Card, Enters, ParameterSpec, Place, voltage};

pub(super) const EFFECT: Card = Card {
    id: "supply_sag",
    name: "supply sag",
    enters: Enters::Voltage,
    equation: "U = Rs (u/110 V)^2 i",
    causes: "a supply, cable, fuse or battery with inner resistance Rs before the chopper: at duty \
        u/Us it carries (u/Us) i, sags by Rs times that, and the motor gets the share u/Us of it. \
        Measure the DC bus under load: if it sags by Rs (u/Us) i it is the supply; if it stands \
        still, a resistance that grows with the duty is in the drive (a contact, a chopper that \
        loses time under current). The size is that of a supply of 110 V: on one of Us volts the \
        resistance is Rs (Us/110 V)^2",
    looks_like: "voltage error at high voltage and high current together; the resistance seems to \
        grow towards full speed",
    excite: "hard acceleration at low and at high speed, so that the same current is met at small \
        and at full duty",
    remedy: "a stiffer supply, thicker or shorter cable, bus capacitors; feed the measured bus \
        voltage forward in the drive's modulator",
    takes_power: true,
    parameters: &[ParameterSpec::coefficient("sag_ohm", "ohm", 0.4)],
    formula: &[(Place::Voltage, "sag_ohm*(u/U)^2*i")],
    terms: |values| {
        voltage(values, |at, [sag_ohm]| {
            let duty = at.voltage_v / at.supply_v;
            // Without a supply (mechanical runs) there is no duty.
            if duty.is_finite() { sag_ohm * duty * duty * at.current_a } else { 0.0 }
        })
    },
    ..Card::PLAIN
};

//! Discontinuous conduction (Leonhard, *Control of Electrical Drives*, chapter 8): extra resistance at small currents, where the
//! current of a converter falls to zero between its pulses.

use super::{Axis, Balance, Card, Enters, Limit, Measure, ParameterSpec, Place, voltage};

pub(super) const EFFECT: Card = Card {
    id: "discontinuous_conduction",
    name: "discontinuous conduction",
    enters: Enters::Voltage,
    equation: "U = Rx i inside |i| < Ib, Rx Ib sgn(i) beyond",
    causes: "a thyristor or diode bridge, or a chopper at low frequency, whose current falls to \
        zero between pulses below Ib: the mean voltage drops as if by a resistance. Look at the \
        current with an oscilloscope: gaps between the pulses are proof. A brush or dead-time drop \
        has the same shape with a far smaller Ib and stays when the converter is replaced by a \
        battery (brushes) or when the load rises (both)",
    looks_like: "voltage error that grows steeply with the current up to a boundary and stays \
        constant above; a sluggish current at small load",
    excite: "no-load running, and small currents of both signs, as well as currents well above the \
        boundary",
    remedy: "a choke or a higher switching frequency lowers the boundary; an adaptive current \
        controller with another gain inside it",
    takes_power: true,
    curve: Some((Balance::Voltage, Axis::Current)),
    alternatives: &["voltage_drop"],
    // A boundary below nine times the current over which a voltage drop builds up is that of a drop.
    limit: Some(Limit { simpler: "voltage_drop", parameter: 1, least: 0.9 }),
    parameters: &[
        ParameterSpec::coefficient("extra_ohm", "ohm", 1.0),
        ParameterSpec::shape("boundary_a", "A", (0.01, 1000.0), &[0.3, 0.6, 1.2, 2.5, 5.0])
            .of(Measure::Current),
    ],
    formula: &[(Place::Voltage, "extra_ohm*0.5*(abs(i + boundary_a) - abs(i - boundary_a))")],
    terms: |values| {
        voltage(values, |at, [extra_ohm, boundary_a]| {
            extra_ohm * at.current_a.clamp(-boundary_a, boundary_a)
        })
    },
    ..Card::PLAIN
};

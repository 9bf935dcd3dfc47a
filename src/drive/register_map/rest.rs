//! What the readings of a drive at rest can be. A wrong address, word order or scale leaves these ranges at once, where
//! the true value is not zero; what is zero confirms little.

use super::facts::{Quantity, Signal, Unit};

/// Current of a machine at rest, as a share of the rated one: offset and noise of a sensor.
const CURRENT_SHARE: f64 = 0.1;
/// The same where no rated current is known, A.
const CURRENT_A: f64 = 1.0;
/// Speeds that a sensor or an observer shows at rest: 1 % of 3000 r/min.
const SPEED_RPM: f64 = 30.0;
const SPEED_RAD_S: f64 = 3.0;
const SPEED_HZ: f64 = 0.5;
/// Output of a power stage that is off, V.
const OUTPUT_V: f64 = 10.0;
/// From a small battery to the intermediate circuit of a 690 V converter, V.
const SUPPLY_V: [f64; 2] = [8.0, 1500.0];

/// Where the value of a signal lies while the drive is powered and the shaft stands still, in the signal's unit; `None`:
/// anything may be true.
pub(super) fn expected_at_rest(signal: &Signal, rated_current_a: Option<f64>) -> Option<[f64; 2]> {
    let around_zero = |most: f64| Some([-most, most]);
    match (signal.keys.quantity, signal.numbers.unit) {
        (Quantity::ShaftSpeed | Quantity::OutputSpeed, unit) => match unit {
            Unit::Rpm => around_zero(SPEED_RPM),
            Unit::RadS => around_zero(SPEED_RAD_S),
            Unit::Hertz => around_zero(SPEED_HZ),
            Unit::Percent => around_zero(1.0),
            _ => None,
        },
        (Quantity::Current, Unit::A) => {
            around_zero(rated_current_a.map_or(CURRENT_A, |rated| CURRENT_SHARE * rated))
        }
        (Quantity::Voltage, Unit::V) => around_zero(OUTPUT_V),
        (Quantity::Current | Quantity::Torque, Unit::Percent) => around_zero(100.0 * CURRENT_SHARE),
        (Quantity::Torque, Unit::NewtonMetre) => around_zero(1.0),
        (Quantity::Power, Unit::KiloWatt) => around_zero(0.1),
        (Quantity::Duty | Quantity::Power | Quantity::Voltage, Unit::Percent) => around_zero(5.0),
        (Quantity::BusVoltage | Quantity::LineVoltage, Unit::V) => Some(SUPPLY_V),
        (Quantity::FieldCurrent, Unit::A) => Some([0.0, 1000.0]),
        (Quantity::Temperature, Unit::Celsius) => Some([-40.0, 150.0]),
        (Quantity::RatedCurrent | Quantity::CurrentLimit, Unit::A) => Some([0.01, 10_000.0]),
        (Quantity::RatedVoltage | Quantity::VoltageLimit, Unit::V) => Some([1.0, 2000.0]),
        (Quantity::RatedSpeed, Unit::Rpm) => Some([10.0, 100_000.0]),
        _ => None,
    }
}

/// Whether a reading within its range also confirms address and order: a register that is not there reads zero as well.
pub(super) fn confirms(range: [f64; 2], value: f64) -> bool {
    let [low, high] = range;
    (low..=high).contains(&value) && !(low..=high).contains(&0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::DriveProfile;

    fn expected(profile: &str, signal: &str, rated_a: Option<f64>) -> Option<[f64; 2]> {
        let map = DriveProfile::named(profile).unwrap().registers.unwrap();
        expected_at_rest(map.signal(signal).unwrap(), rated_a)
    }

    #[test]
    fn a_standing_shaft_reads_about_zero_in_every_unit() {
        assert_eq!(expected("siemens-v20", "speed", None), Some([-30.0, 30.0]));
        assert_eq!(
            expected("siemens-v20", "frequency", None),
            Some([-0.5, 0.5])
        );
        assert_eq!(expected("siemens-v20", "current", None), Some([-1.0, 1.0]));
        assert_eq!(
            expected("siemens-v20", "current", Some(40.0)),
            Some([-4.0, 4.0])
        );
        assert_eq!(expected("siemens-v20", "status", None), None);
    }

    #[test]
    fn only_what_is_not_zero_at_rest_confirms_an_address() {
        let bus = expected("siemens-v20", "bus", None).unwrap();
        assert!(confirms(bus, 325.0));
        assert!(!confirms(bus, 0.0) && !confirms(bus, 21_000.0));
        assert!(!confirms([-30.0, 30.0], 0.0) && !confirms([-30.0, 30.0], 12.0));
    }
}

//! Bounds of the motor's parameters in a fit.

use super::model::Model;
use super::motor::MotorKey;
use super::scenario::Scenario;

/// Bounds of any parameter of a motor of any size, in its unit.
const ANY: (f64, f64) = (1e-12, 1e9);
/// The shortest electrical time constant, as a share of the sampling period: a shorter one is not observable in the samples,
/// and its equations are stiff.
pub const LEAST_TIME_CONSTANT: f64 = 1e-2;

/// Bounds of a parameter, in its unit, in a fit on `scenario`; a smaller value that the model has already is its own bound.
pub fn motor_range(key: MotorKey, model: &Model, scenario: &Scenario) -> (f64, f64) {
    let times = &scenario.sample_time_s;
    let resistance_ohm = model.motor.get(MotorKey::Resistance);
    let least = match (key, resistance_ohm, &times[..]) {
        (MotorKey::Inductance, Some(resistance_ohm), [first, .., last]) => {
            let period_s = (last - first) / (times.len() - 1) as f64;
            let resolved_h = LEAST_TIME_CONSTANT * period_s * resistance_ohm;
            model.motor.get(key).map_or(resolved_h, |present_h| present_h.min(resolved_h))
        }
        _ => ANY.0,
    };
    (least.max(ANY.0), ANY.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::Motor;
    use crate::plant::testing::record;

    #[test]
    fn an_inductance_is_not_fitted_below_the_observable() {
        let mut model = Model::baseline(Motor::zk_22fc());
        model.motor.set(MotorKey::Resistance, 2.0);
        for period_s in [1e-3, 1e-2] {
            let run = record(&model, vec![(0.0, 10.0)], period_s, 1.0, 1);
            let mut small = model.clone();
            small.motor.set(MotorKey::Inductance, 1e-6);
            for (model, expected_h) in [(&model, 2e-2 * period_s), (&small, 1e-6)] {
                let (least_h, _) = motor_range(MotorKey::Inductance, model, &run);
                assert!((least_h / expected_h - 1.0).abs() < 1e-6, "{least_h}");
            }
            for key in [MotorKey::Resistance, MotorKey::Inertia] {
                assert_eq!(motor_range(key, &model, &run), ANY);
            }
        }
    }
}

//! The same values in the units that data sheets and drives use.

use serde::Serialize;

use drivebench_model::plant::MotorKey;
use drivebench_model::sample::ParameterEstimate;
use drivebench_model::units;

/// How the constants of a direct-current machine belong together.
pub const RELATION: &str = "in SI Ke (V.s/rad) and Kt (N.m/A) are the same number for a DC machine; Kv = 60/(2 pi Ke). \
     All values are those of the equivalent DC machine, line to line for a brushless motor";

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Converted {
    #[serde(skip)]
    pub key: &'static str,
    pub value: f64,
    pub std: Option<f64>,
    pub unit: &'static str,
}

type Convert = fn(f64) -> f64;

/// Every motor value that has a second convention; only values that were found.
pub fn of(parameters: &[ParameterEstimate]) -> Vec<Converted> {
    let found = |of: MotorKey| {
        let parameter = parameters.iter().find(|p| p.key == of.key())?;
        Some((parameter.value?, parameter.std))
    };
    let torque =
        found(MotorKey::TorqueConstant).map_or(MotorKey::BackEmf, |_| MotorKey::TorqueConstant);
    let conventions: [(MotorKey, &str, &str, Convert); 5] = [
        (MotorKey::BackEmf, "back_emf_v_per_krpm", "V/krpm", units::v_per_krpm_from_v_s_per_rad),
        (
            MotorKey::BackEmf,
            "speed_constant_rpm_per_v",
            "r/min/V",
            units::rpm_per_v_from_v_s_per_rad,
        ),
        (torque, "torque_constant_n_m_per_a", "N.m/A", |value| value),
        (MotorKey::Inertia, "inertia_kg_cm2", "kg.cm2", units::kg_cm2_from_kg_m2),
        (MotorKey::Inertia, "gd2_n_m2", "N.m2", units::gd2_n_m2_from_kg_m2),
    ];
    let converted = conventions.into_iter().filter_map(|(of, key, unit, convert)| {
        let (value, std) = found(of).filter(|(value, _)| *value > 0.0)?;
        // Each of them is a power law: the relative deviation stays.
        let converted = convert(value);
        Some(Converted { key, value: converted, std: std.map(|std| std / value * converted), unit })
    });
    converted.collect()
}

/// Inertia and load torque referred to the load side of a gearbox that turns the motor `ratio` times per turn of the load.
pub fn on_load_shaft(parameters: &[ParameterEstimate], ratio: f64) -> Vec<ParameterEstimate> {
    let factor = |key: &str| match MotorKey::from_key(key) {
        Some(MotorKey::Inertia) => Some(ratio * ratio),
        Some(MotorKey::LoadTorque) => Some(ratio),
        _ => None,
    };
    let referred = |parameter: &ParameterEstimate| {
        let factor = factor(&parameter.key)?;
        Some(ParameterEstimate {
            value: parameter.value.map(|value| factor * value),
            std: parameter.std.map(|std| factor * std),
            ..parameter.clone()
        })
    };
    parameters.iter().filter_map(referred).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameter(key: MotorKey, value: f64) -> ParameterEstimate {
        ParameterEstimate::found(key.key(), key.unit(), value, 0.01 * value, None)
    }

    #[test]
    fn the_constants_keep_their_relative_deviation() {
        let found =
            of(&[parameter(MotorKey::BackEmf, 0.3538), parameter(MotorKey::Inertia, 0.0045)]);
        // GD2 is 4 g J.
        for (key, expected, tolerance) in [
            ("back_emf_v_per_krpm", 37.05, 0.01),
            ("speed_constant_rpm_per_v", 26.99, 0.01),
            ("torque_constant_n_m_per_a", 0.3538, 1e-12),
            ("gd2_n_m2", 0.17652, 1e-5),
        ] {
            let own = found.iter().find(|own| own.key == key).unwrap();
            assert!((own.value - expected).abs() < tolerance, "{own:?}");
            assert!((own.std.unwrap() / own.value - 0.01).abs() < 1e-12, "{own:?}");
        }
    }

    #[test]
    fn inertia_crosses_a_gearbox_with_the_square_of_its_ratio() {
        let motor = [
            parameter(MotorKey::Resistance, 1.1),
            parameter(MotorKey::Inertia, 0.004),
            parameter(MotorKey::LoadTorque, 0.4),
        ];
        let load = on_load_shaft(&motor, 10.0);
        assert_eq!(load.len(), 2);
        assert!((load[0].value.unwrap() - 0.4).abs() < 1e-12);
        assert!((load[1].value.unwrap() - 4.0).abs() < 1e-12);
    }
}

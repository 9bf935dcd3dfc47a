//! The only unit conversions in the program: everything else is SI, in `f64`, with the unit in the name.

use std::f64::consts::TAU;

pub fn rad_s_from_rpm(rpm: f64) -> f64 {
    rpm * TAU / 60.0
}

pub fn rpm_from_rad_s(speed_rad_s: f64) -> f64 {
    speed_rad_s * 60.0 / TAU
}

pub fn turns_from_rad(angle_rad: f64) -> f64 {
    angle_rad / TAU
}

pub fn v_per_krpm_from_v_s_per_rad(back_emf_v_s_per_rad: f64) -> f64 {
    back_emf_v_s_per_rad * rad_s_from_rpm(1000.0)
}

pub fn rpm_per_v_from_v_s_per_rad(back_emf_v_s_per_rad: f64) -> f64 {
    rpm_from_rad_s(1.0 / back_emf_v_s_per_rad)
}

pub fn kg_cm2_from_kg_m2(inertia_kg_m2: f64) -> f64 {
    1e4 * inertia_kg_m2
}

/// Converts an inertia from kg.m2 to the flywheel effect GD2 = 4 g J in N.m2, with the standard gravity g.
pub fn gd2_n_m2_from_kg_m2(inertia_kg_m2: f64) -> f64 {
    4.0 * 9.806_65 * inertia_kg_m2
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn conversions_agree_with_their_definitions() {
        for (found, expected) in [
            (rpm_from_rad_s(TAU), 60.0),
            (rad_s_from_rpm(60.0), TAU),
            // Paper B: 0.097 V/(r/min) = 97 V/krpm.
            (v_per_krpm_from_v_s_per_rad(0.926_282), 97.0),
        ] {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found}");
        }
    }
}

//! Background of a real bench: random torque, a little drag and cogging, a command delay, a supply with a source resistance.

use super::{Acts, HiddenEffect, HiddenKind, NOT_STUDIED, NotNegative, Site};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "messy",
    names: &[],
    // Multiplies every size of [`parts`].
    parameters: &[NotNegative.of("scale", "-", 1.0, NOT_STUDIED)],
    mystery: None,
    acts: Acts::Together(parts),
};

/// Torques as shares of the rated torque: 0.75 % random, 1.5 % drag at rated speed, 1.5 % cogging.
fn parts(scale: f64, site: &Site) -> Vec<HiddenEffect> {
    let torque = scale * site.rated_torque_n_m();
    let drag = 0.015 * torque / site.motor.rated_speed_rad_s;
    let parts: [(&str, &[(&str, f64)]); 5] = [
        ("random_load", &[("std_n_m", 0.0075 * torque), ("correlation_s", 0.05)]),
        ("viscous_friction", &[("viscous_n_m_s_per_rad", drag)]),
        ("cogging", &[("order", 7.0), ("sin_n_m", 0.015 * torque), ("cos_n_m", 0.0)]),
        ("command_delay", &[("delay_s", scale * 0.4e-3)]),
        ("supply_sag", &[("sag_ohm", scale * 0.05)]),
    ];
    parts.iter().filter_map(|(id, values)| HiddenEffect::new(id, values)).collect()
}

//! Background of a real bench: random torque, a little drag and cogging, a late command, a supply that gives way.

use super::{Acts, HiddenEffect, HiddenKind, NOT_STUDIED, NotNegative, Site};

/// Shares of the rated torque.
const RANDOM_SHARE: f64 = 0.0075;
const DRAG_SHARE_AT_RATED_SPEED: f64 = 0.015;
const COGGING_SHARE: f64 = 0.015;
const COGGING_ORDER: f64 = 7.0;
const RANDOM_CORRELATION_S: f64 = 0.05;
const COMMAND_DELAY_S: f64 = 0.4e-3;
const SAG_OHM: f64 = 0.05;

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "messy",
    names: &[],
    // 1: the sizes above; every size is multiplied by it.
    parameters: &[NotNegative.of("scale", "-", 1.0, NOT_STUDIED)],
    mystery: None,
    acts: Acts::Together(parts),
};

fn parts(scale: f64, site: &Site) -> Vec<HiddenEffect> {
    let torque = scale * site.rated_torque_n_m();
    let drag = DRAG_SHARE_AT_RATED_SPEED * torque / site.motor.rated_speed_rad_s;
    let parts: [(&str, &[(&str, f64)]); 5] = [
        (
            "random_load",
            &[("std_n_m", RANDOM_SHARE * torque), ("correlation_s", RANDOM_CORRELATION_S)],
        ),
        ("viscous_friction", &[("viscous_n_m_s_per_rad", drag)]),
        (
            "cogging",
            &[("order", COGGING_ORDER), ("sin_n_m", COGGING_SHARE * torque), ("cos_n_m", 0.0)],
        ),
        ("command_delay", &[("delay_s", scale * COMMAND_DELAY_S)]),
        ("supply_sag", &[("sag_ohm", scale * SAG_OHM)]),
    ];
    parts.iter().filter_map(|(id, values)| HiddenEffect::new(id, values)).collect()
}

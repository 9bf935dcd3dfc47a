//! A load between drag and fan: k |w|^1.5 against the motion.

use super::{Acts, HiddenKind, NotNegative, drag};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "fan_three_halves",
    names: &["quadratic_load", "viscous_friction"],
    parameters: &[NotNegative.of(
        "three_halves_n_m_s15_per_rad15",
        "N.m.s1.5/rad1.5",
        3e-5,
        2.2e-5..4e-5,
    )],
    mystery: None,
    acts: Acts::Inside(|values, _| {
        let size = values[0];
        drag(move |speed_rad_s| size * speed_rad_s * speed_rad_s.abs().sqrt())
    }),
};

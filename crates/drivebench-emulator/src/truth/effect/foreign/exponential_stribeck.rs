//! Friction beyond Coulomb that falls exponentially: Ms exp(-|w|/ws), without memory.

use super::{Acts, HiddenKind, NotNegative, Positive, friction, named};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "exponential_stribeck",
    names: &["stribeck_friction"],
    parameters: &[
        NotNegative.of("stribeck_n_m", "N.m", 0.16, 0.08..0.16),
        Positive.of("stribeck_speed_rad_s", "rad/s", 10.0, 6.0..18.0),
    ],
    mystery: None,
    acts: Acts::Inside(|values, _| {
        let [stribeck_n_m, stribeck_speed_rad_s] = named(values);
        friction(move |at| stribeck_n_m * (-at.speed_rad_s.abs() / stribeck_speed_rad_s).exp())
    }),
};

//! Friction beyond Coulomb that falls exponentially: Ms exp(-|w|/ws), without memory.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, friction, named};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "exponential_stribeck",
    names: &["stribeck_friction"],
    parameters: &[
        Parameter::new("stribeck_n_m", "N.m", Allowed::NotNegative, 0.16),
        Parameter::new("stribeck_speed_rad_s", "rad/s", Allowed::Positive, 10.0),
    ],
    mystery: None,
    study: &[
        Between("stribeck_n_m", 0.08, 0.16),
        Between("stribeck_speed_rad_s", 6.0, 18.0),
    ],
    acts: Acts::Inside(|values, _| {
        let [stribeck_n_m, stribeck_speed_rad_s] = named(values);
        friction(move |at| stribeck_n_m * (-at.speed_rad_s.abs() / stribeck_speed_rad_s).exp())
    }),
};

//! Viscous drag of a lubricant that thins with shear.

use super::{Acts, HiddenKind, NotNegative, drag};

/// Drag with the slope `viscous_n_m_s_per_rad` at low speed.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "viscous_friction",
    names: &["viscous_friction"],
    parameters: &[NotNegative.of("viscous_n_m_s_per_rad", "N.m.s/rad", 4e-4, 4e-4..8e-4)],
    mystery: Some(|dice| vec![dice.torque_n_m / dice.speed_rad_s]),
    acts: Acts::Inside(|values, site| {
        let viscous = values[0];
        // Scale of the thinning: 4 % less drag than linear at rated speed.
        let w0 = 2.0 * site.motor.rated_speed_rad_s;
        // Eyring fluid: torque = B w0 asinh(w/w0) (Eyring 1936, shear-thinning lubricant). The host's catalogue has B w.
        drag(move |speed_rad_s| viscous * w0 * (speed_rad_s / w0).asinh())
    }),
};

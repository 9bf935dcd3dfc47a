//! Drag that differs by direction: a lip seal that lifts off when the shaft turns one way.

use super::{Acts, HiddenKind, Signed, drag};

/// Torque `a |w|`: the drag is B + a forwards and B - a backwards.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "asymmetric_viscous",
    names: &["asymmetric_viscous"],
    parameters: &[Signed.of("asymmetry_n_m_s_per_rad", "N.m.s/rad", 1e-4, 2e-4..5e-4)],
    mystery: Some(|dice| vec![dice.sign() * dice.torque_n_m / dice.speed_rad_s]),
    acts: Acts::Inside(|values, site| {
        let slope = values[0];
        // Speed at which the seal begins to lift: 1 % less torque than `a |w|` at rated speed.
        let w0 = 0.01 * site.motor.rated_speed_rad_s;
        // torque = a (sqrt(w^2 + w0^2) - w0): no kink at rest, where the seal touches all round. The host's catalogue
        // has a |w|; this lies a w0 below it from a few w0 on, a constant that is 1 % of the torque at rated speed.
        drag(move |speed_rad_s| slope * (speed_rad_s.hypot(w0) - w0))
    }),
};

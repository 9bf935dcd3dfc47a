//! A fan or pump on the shaft.

use super::{Acts, HiddenKind, NotNegative, drag};

/// Load of `quadratic_n_m_s2_per_rad2` times rated speed squared at rated speed.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "quadratic_load",
    names: &["quadratic_load"],
    parameters: &[NotNegative.of(
        "quadratic_n_m_s2_per_rad2",
        "N.m.s2/rad2",
        1.8e-6,
        1.2e-6..2.8e-6,
    )],
    mystery: Some(|dice| vec![dice.torque_n_m / (dice.speed_rad_s * dice.speed_rad_s)]),
    acts: Acts::Inside(|values, site| {
        let rated_speed_rad_s = site.motor.rated_speed_rad_s;
        let torque_at_rated_n_m = values[0] * rated_speed_rad_s.powi(2);
        // T = Tn |w/wn|^1.95 sgn(w), as measured fans: a power a little below two. The host's catalogue has k w |w|.
        drag(move |speed_rad_s| {
            let ratio = (speed_rad_s / rated_speed_rad_s).abs();
            (torque_at_rated_n_m * ratio.powf(1.95)).copysign(speed_rad_s)
        })
    }),
};

//! Oil in a housing, or rubber that yields.

use super::lagged_load::Column;
use super::{Acts, HiddenKind, NotNegative, Positive};

/// Torque of `lagged_n_m_s_per_rad` times rated speed at rated speed, behind a lag of `time_constant_s`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "lagged_drag",
    names: &["lagged_drag"],
    parameters: &[
        NotNegative.of("lagged_n_m_s_per_rad", "N.m.s/rad", 4e-4, 4e-4..8e-4),
        Positive.of("time_constant_s", "s", 0.3, 0.15..0.6),
    ],
    mystery: Some(|dice| vec![dice.torque_n_m / dice.speed_rad_s, dice.between(0.15, 0.6)]),
    acts: Acts::Inside(|values, site| {
        let rated_speed_rad_s = site.motor.rated_speed_rad_s;
        // A power a little below one, as oil that thins with shear. The host's catalogue has w.
        let (at_rated_n_m, power) = (values[0] * rated_speed_rad_s, 0.97);
        Box::new(Column::new(at_rated_n_m, rated_speed_rad_s, power, values[1]))
    }),
};

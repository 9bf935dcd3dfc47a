//! A bearing that begins to drag some time after the drive was started.

use super::{Acts, HiddenKind, NotNegative, friction, named};

/// Drag in proportion to the speed from `time_s` after each start of the drive on.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "friction_onset",
    names: &["friction_onset"],
    parameters: &[
        NotNegative.of("viscous_n_m_s_per_rad", "N.m.s/rad", 4e-4, 4e-4..8e-4),
        NotNegative.of("time_s", "s", 0.6, 3.0..6.0),
    ],
    mystery: Some(|dice| vec![dice.torque_n_m / dice.speed_rad_s, dice.between(3.0, 9.0)]),
    acts: Acts::Inside(|values, _| {
        let [viscous, time_s] = named(values);
        // B w (1 - exp(-(t - t1)/20 ms)): the lubricating film breaks down. The host's catalogue has a logistic curve about t1.
        friction(move |at| viscous * at.speed_rad_s.abs() * at.first_order_lag(time_s, 0.02))
    }),
};

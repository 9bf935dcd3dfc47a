//! A weight that is picked up some time after the drive was started.

use super::{Acts, HiddenKind, NotNegative, Signed, load, named};

/// Torque of `load_n_m` against positive motion from `time_s` after each start of the drive on.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "one_sided_load",
    names: &["one_sided_load"],
    parameters: &[
        Signed.of("load_n_m", "N.m", 0.1, 0.08..0.2),
        NotNegative.of("time_s", "s", 0.4, 3.0..6.0),
    ],
    mystery: Some(|dice| vec![dice.sign() * dice.torque_n_m, dice.between(3.0, 9.0)]),
    acts: Acts::Inside(|values, _| {
        let [load_n_m, time_s] = named(values);
        // T (t - t1)/30 ms while the rope comes under tension. The host's catalogue has a logistic curve about t1.
        load(move |at| load_n_m * ((at.time_s - time_s) / 0.03).clamp(0.0, 1.0))
    }),
};

//! A brake that engages some time after the drive was started.

use super::{Acts, HiddenKind, NotNegative, friction, named};

/// Friction of `step_n_m` from `time_s` after each start of the drive on.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "load_step",
    names: &["load_step"],
    parameters: &[
        NotNegative.of("step_n_m", "N.m", 0.12, 0.08..0.2),
        NotNegative.of("time_s", "s", 0.6, 3.0..6.0),
    ],
    mystery: Some(|dice| vec![dice.torque_n_m, dice.between(3.0, 9.0)]),
    acts: Acts::Inside(|values, _| {
        let [step_n_m, time_s] = named(values);
        // T (1 - exp(-(t - t1)/15 ms)), the current of the brake's coil. The host's catalogue has a logistic curve
        // about t1.
        friction(move |at| step_n_m * at.first_order_lag(time_s, 0.015))
    }),
};

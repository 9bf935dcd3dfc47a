//! A weight that is picked up some time after the drive was started.

use super::Draw::{Between, Signed};
use super::{Acts, Allowed, HiddenKind, Parameter, load, named};

/// Time in which the rope comes under tension, s.
const TIGHT_S: f64 = 0.03;

/// Torque of `load_n_m` against positive motion from `time_s` after each start of the drive on.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "one_sided_load",
    names: &["one_sided_load"],
    parameters: &[
        Parameter::new("load_n_m", "N.m", Allowed::Signed, 0.1),
        Parameter::new("time_s", "s", Allowed::NotNegative, 0.4),
    ],
    mystery: Some(|dice| vec![dice.sign() * dice.torque_n_m, dice.between(3.0, 9.0)]),
    study: &[Signed("load_n_m", 0.08, 0.2), Between("time_s", 3.0, 6.0)],
    acts: Acts::Inside(|values, _| {
        let [load_n_m, time_s] = named(values);
        // T (t - t1)/30 ms until it hangs freely. The host's catalogue has a logistic curve about t1.
        load(move |at| load_n_m * ((at.time_s - time_s) / TIGHT_S).clamp(0.0, 1.0))
    }),
};

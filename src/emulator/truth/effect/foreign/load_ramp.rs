//! Friction that builds up slowly from `time_s` after each start on, to `step_n_m` within `rise_s`.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, friction, named};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "load_ramp",
    names: &["load_step"],
    parameters: &[
        Parameter::new("step_n_m", "N.m", Allowed::NotNegative, 0.16),
        Parameter::new("time_s", "s", Allowed::NotNegative, 0.1),
        Parameter::new("rise_s", "s", Allowed::Positive, 0.2),
    ],
    mystery: None,
    study: &[
        Between("step_n_m", 0.08, 0.2),
        Between("time_s", 3.0, 6.0),
        Between("rise_s", 0.5, 1.5),
    ],
    acts: Acts::Inside(|values, _| {
        let [step_n_m, time_s, rise_s] = named(values);
        friction(move |at| step_n_m * ((at.time_s - time_s) / rise_s).clamp(0.0, 1.0))
    }),
};

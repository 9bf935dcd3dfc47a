//! Friction that builds up slowly from `time_s` after each start on, to `step_n_m` within `rise_s`.

use super::{Acts, HiddenKind, NotNegative, Positive, friction, named};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "load_ramp",
    names: &["load_step"],
    parameters: &[
        NotNegative.of("step_n_m", "N.m", 0.16, 0.08..0.2),
        NotNegative.of("time_s", "s", 0.1, 3.0..6.0),
        Positive.of("rise_s", "s", 0.2, 0.5..1.5),
    ],
    mystery: None,
    acts: Acts::Inside(|values, _| {
        let [step_n_m, time_s, rise_s] = named(values);
        friction(move |at| step_n_m * ((at.time_s - time_s) / rise_s).clamp(0.0, 1.0))
    }),
};

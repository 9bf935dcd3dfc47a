//! Step of a load of one sign, whatever the direction of motion.

use super::{Card, Enters, ParameterSpec, Place, begun, torque};

pub(super) const EFFECT: Card = Card {
    id: "one_sided_load",
    name: "one-sided load from a moment on",
    enters: Enters::Torque,
    equation: "T = T1 from the time t1 on, whichever way the shaft turns; found anew in each run",
    causes: "a weight that is picked up or set down; a spring or a web that comes under tension; \
        wind or a stream that sets in; a second drive on the same shaft that begins to pull. \
        Compare the moment with the machine's log",
    looks_like: "torque error that is zero before a moment and of one sign after it, in both \
        directions",
    excite: "let the load come within a run that turns both ways: in one direction it looks like \
        friction",
    remedy: "a load observer; feed-forward where the load announces itself",
    share_beforehand: 0.03,
    excludes: &["load_step", "friction_onset"],
    changes: Some("load"),
    parameters: &[ParameterSpec::coefficient("load_n_m", "N.m", 0.08), ParameterSpec::EVENT_TIME],
    formula: &[(Place::Torque, "load_n_m*0.5*(1 + tanh((t - time_s)/0.02))")],
    terms: |values| torque(values, |at, [load_n_m, time_s]| load_n_m * begun(at, time_s)),
    ..Card::PLAIN
};

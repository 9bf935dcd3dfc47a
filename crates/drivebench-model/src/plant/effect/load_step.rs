//! Step of a friction-like load at a moment of the run.

use super::{Axis, Balance, Card, Enters, ParameterSpec, Place, begun, friction};

pub(super) const EFFECT: Card = Card {
    id: "load_step",
    name: "load step",
    enters: Enters::Torque,
    equation: "T = T1 sgn(w) from the time t1 on, found anew in each run",
    causes: "a brake, a clutch or a tool that engages; a belt that begins to rub; a seal that runs \
        dry. Compare the moment with the machine's log and listen: a brake or tool comes back at \
        the same place of the cycle, a rub at the same temperature or angle. What always comes at \
        the same angle is a load of position",
    looks_like: "torque error that is zero before a moment and constant after it",
    excite: "let the load come and go within one run, at steady speed",
    remedy: "a load observer; feed-forward where the load announces itself",
    curve: Some((Balance::Torque, Axis::Time)),
    is_disturbance_step: true,
    changes: Some("friction"),
    parameters: &[ParameterSpec::coefficient("step_n_m", "N.m", 0.08), ParameterSpec::EVENT_TIME],
    formula: &[(Place::Friction, "step_n_m*0.5*(1 + tanh((t - time_s)/0.02))")],
    terms: |values| friction(values, |at, [step_n_m, time_s]| step_n_m * begun(at, time_s)),
    ..Card::PLAIN
};

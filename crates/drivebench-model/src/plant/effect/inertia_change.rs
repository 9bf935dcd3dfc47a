//! Step of the inertia at a moment of the run.

use super::{Card, Enters, ParameterSpec, Place, begun, inertia_gain};

/// The inertia stays positive.
const LEAST_RATIO: f64 = -0.95;

pub(super) const EFFECT: Card = Card {
    id: "inertia_change",
    name: "inertia change",
    enters: Enters::Torque,
    equation: "J times 1 + r from the time t1 on, found anew in each run; the speed does not jump",
    causes: "a workpiece that is clamped or dropped; a clutch that takes another shaft along; a \
        coil that is wound or unwound; an arm that stretches; a coupling that slips or breaks. It \
        shows in accelerations only: what also shows at steady speed is a load",
    looks_like: "slower or faster speed-up after a moment, nothing at steady speed",
    excite: "the same accelerations before and after the moment, both ways",
    remedy: "schedule the speed loop's gains with the signal that announces the change, or let it \
        adapt",
    share_beforehand: 0.03,
    changes: Some("inertia"),
    parameters: &[
        ParameterSpec {
            min: LEAST_RATIO,
            max: 100.0,
            ..ParameterSpec::coefficient("ratio", "-", 0.1)
        },
        ParameterSpec::EVENT_TIME,
    ],
    formula: &[(Place::Inertia, "ratio*0.5*(1 + tanh((t - time_s)/0.02))")],
    terms: |values| {
        inertia_gain(values, |at, [ratio, time_s]| ratio.max(LEAST_RATIO) * begun(at, time_s))
    },
    ..Card::PLAIN
};

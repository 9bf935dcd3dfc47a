//! Step of the viscous friction at a moment of the run.

use super::{Card, Enters, ParameterSpec, Place, begun, torque};

pub(super) const EFFECT: Card = Card {
    id: "friction_onset",
    name: "onset of friction",
    enters: Enters::Torque,
    equation: "T = B1 w from the time t1 on, found anew in each run",
    causes: "a bearing that loses its lubricant or begins to seize; a pump or fan that is coupled \
        in; an eddy-current or fluid brake that is switched on; grease that is pushed into the \
        gap. A brake whose torque does not grow with the speed is a load step",
    looks_like: "torque error against the motion that is zero before a moment and grows with the \
        speed after it",
    excite: "several speeds before and after the moment: at one speed it looks like a load step",
    remedy: "stop and look at the bearing where nothing was switched on; else feed-forward of B1 w \
        from the signal that switches",
    share_beforehand: 0.03,
    excludes: &["load_step"],
    changes: Some("drag"),
    parameters: &[
        ParameterSpec::coefficient("viscous_n_m_s_per_rad", "N.m.s/rad", 8e-4),
        ParameterSpec::EVENT_TIME,
    ],
    formula: &[(Place::Torque, "viscous_n_m_s_per_rad*w*0.5*(1 + tanh((t - time_s)/0.02))")],
    terms: |values| {
        torque(values, |at, [viscous, time_s]| viscous * at.speed_rad_s * begun(at, time_s))
    },
    ..Card::PLAIN
};

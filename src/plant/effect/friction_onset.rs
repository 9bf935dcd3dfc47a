use super::onset::{TIME, begun};
use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Drag in proportion to the speed that is there from some moment on.
pub(super) struct FrictionOnset;

struct Drag {
    viscous_n_m_s_per_rad: f64,
    time_s: f64,
}

impl Effect for FrictionOnset {
    fn card(&self) -> &'static Card {
        &Card {
            id: "friction_onset",
            name: "onset of friction",
            enters: Enters::Torque,
            equation: "T = B1 w from the time t1 on, found anew in each run",
            causes: "a bearing that loses its lubricant or begins to seize; a pump or fan that is coupled in; an \
                     eddy-current or fluid brake that is switched on; grease that is pushed into the gap. A brake \
                     whose torque does not grow with the speed is a load step",
            looks_like: "torque error against the motion that is zero before a moment and grows with the speed after it",
            excite: "several speeds before and after the moment: at one speed it looks like a load step",
            remedy: "stop and look at the bearing where nothing was switched on; else feed-forward of B1 w from the \
                     signal that switches",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("viscous_n_m_s_per_rad", "N.m.s/rad", f64::MAX, 8e-4),
            TIME,
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Drag {
            viscous_n_m_s_per_rad: values[0],
            time_s: values[1],
        })
    }
}

impl Terms for Drag {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.viscous_n_m_s_per_rad * at.speed_rad_s * begun(at, self.time_s)
    }
}

use super::onset::{TIME, begun};
use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Friction-like load that is there from some moment on.
pub(super) struct LoadStep;

struct Step {
    level_n_m: f64,
    time_s: f64,
}

impl Effect for LoadStep {
    fn card(&self) -> &'static Card {
        &Card {
            id: "load_step",
            name: "load step",
            enters: Enters::Torque,
            equation: "T = T1 sgn(w) from the time t1 on, found anew in each run",
            causes: "a brake, a clutch or a tool that engages; a belt that begins to rub; a seal that runs dry. \
                     Compare the moment with the machine's log and listen: a brake or tool comes back at the same \
                     place of the cycle, a rub at the same temperature or angle. What always comes at the same angle \
                     is a load of position",
            looks_like: "torque error that is zero before a moment and constant after it",
            excite: "let the load come and go within one run, at steady speed",
            remedy: "a load observer; feed-forward where the load announces itself",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("step_n_m", "N.m", f64::MAX, 0.08),
            TIME,
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Step {
            level_n_m: values[0],
            time_s: values[1],
        })
    }
}

impl Terms for Step {
    fn friction_n_m(&self, at: &Instant) -> f64 {
        self.level_n_m * begun(at, self.time_s)
    }
}

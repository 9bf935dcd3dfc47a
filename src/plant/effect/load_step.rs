use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Friction-like load that is there from some moment on.
pub(super) struct LoadStep;

/// Time over which the step builds up, s; a true jump would leave its time without a slope to fit it by.
const RISE_S: f64 = 0.01;
/// Rise times after which the step has come, to the last bit.
const SETTLED: f64 = 37.0;

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
            ParameterSpec::event_time(
                "time_s",
                &[
                    0.08, 0.15, 0.22, 0.29, 0.36, 0.43, 0.5, 0.57, 0.64, 0.71, 0.78, 0.85, 0.92,
                ],
            ),
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
        let since = (at.time_s - self.time_s) / RISE_S;
        // Beyond, the exponential is lost in the rounding of the one that it is added to, and costs most of a free run.
        if since > SETTLED {
            self.level_n_m
        } else if since < -SETTLED {
            0.0
        } else {
            self.level_n_m / (1.0 + (-since).exp())
        }
    }
}

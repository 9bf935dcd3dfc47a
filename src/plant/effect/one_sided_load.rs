use super::onset::{TIME, begun};
use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Load that pulls one way whichever way the shaft turns, and is there from some moment on.
pub(super) struct OneSidedLoad;

struct Pull {
    load_n_m: f64,
    time_s: f64,
}

impl Effect for OneSidedLoad {
    fn card(&self) -> &'static Card {
        &Card {
            id: "one_sided_load",
            name: "one-sided load from a moment on",
            enters: Enters::Torque,
            equation: "T = T1 from the time t1 on, whichever way the shaft turns; found anew in each run",
            causes: "a weight that is picked up or set down; a spring or a web that comes under tension; wind or a \
                     stream that sets in; a second drive on the same shaft that begins to pull. Compare the moment \
                     with the machine's log",
            looks_like: "torque error that is zero before a moment and of one sign after it, in both directions",
            excite: "let the load come within a run that turns both ways: in one direction it looks like friction",
            remedy: "a load observer; feed-forward where the load announces itself",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("load_n_m", "N.m", f64::MAX, 0.08),
            TIME,
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Pull {
            load_n_m: values[0],
            time_s: values[1],
        })
    }
}

impl Terms for Pull {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.load_n_m * begun(at, self.time_s)
    }
}

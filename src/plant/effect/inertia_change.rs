use super::onset::{TIME, begun};
use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Inertia that is another one from some moment on.
pub(super) struct InertiaChange;

struct Added {
    ratio: f64,
    time_s: f64,
}

/// Nothing turns without inertia.
const LEAST_RATIO: f64 = -0.95;

impl Effect for InertiaChange {
    fn card(&self) -> &'static Card {
        &Card {
            id: "inertia_change",
            name: "inertia change",
            enters: Enters::Torque,
            equation: "J times 1 + r from the time t1 on, found anew in each run; the speed does not jump",
            causes: "a workpiece that is clamped or dropped; a clutch that takes another shaft along; a coil that is \
                     wound or unwound; an arm that stretches; a coupling that slips or breaks. It shows in \
                     accelerations only: what also shows at steady speed is a load",
            looks_like: "slower or faster speed-up after a moment, nothing at steady speed",
            excite: "the same accelerations before and after the moment, both ways",
            remedy: "schedule the speed loop's gains with the signal that announces the change, or let it adapt",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec {
                min: LEAST_RATIO,
                ..ParameterSpec::coefficient("ratio", "-", 100.0, 0.1)
            },
            TIME,
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Added {
            ratio: values[0].max(LEAST_RATIO),
            time_s: values[1],
        })
    }
}

impl Terms for Added {
    fn inertia_gain(&self, at: &Instant) -> f64 {
        self.ratio * begun(at, self.time_s)
    }
}

use super::{Card, Effect, Enters, ParameterSpec, Path, Terms};

/// Measured speed that is that of some time before.
pub(super) struct SpeedDelay;

struct Stale(f64);

impl Effect for SpeedDelay {
    fn card(&self) -> &'static Card {
        &Card {
            id: "speed_delay",
            name: "speed delay",
            enters: Enters::Path,
            equation: "y(t) = w(t - Td): y is what is measured",
            causes: "a speed that was computed, queued or polled before it was stamped; registers read one after the \
                     other; speed from encoder edges over a window (late by half of it). To first order a filter of \
                     the same time is the same: only fast dither tells them apart, a filter damps it, a delay does \
                     not. A clock that is off by some milliseconds delays current and speed alike",
            looks_like: "speed error at every acceleration, of the sign of the acceleration; the current is right",
            excite: "fast dither of the voltage about zero speed; slow ramps do not show it",
            remedy: "stamp the speed where it is taken, or read all registers in one request; count it into the \
                     loop's small time constant",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::positive("delay_s", "s", 0.5, 2e-3)];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Stale(values[0]))
    }
}

impl Terms for Stale {
    fn path(&self) -> Path {
        Path {
            speed_delay_s: self.0,
            ..Path::default()
        }
    }
}

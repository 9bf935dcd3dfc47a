use super::{Card, Effect, Enters, ParameterSpec, Path, Terms};

/// Measured speed that lags behind the shaft by a first-order filter.
pub(super) struct SpeedFilter;

struct Lag(f64);

impl Effect for SpeedFilter {
    fn card(&self) -> &'static Card {
        &Card {
            id: "speed_filter",
            name: "speed filter",
            enters: Enters::Path,
            equation: "dy/dt = (w - y)/tau: y is what is measured",
            causes: "a smoothing filter in the drive or tachometer; speed from encoder edges over a window (half of \
                     the window late). To first order a delay of the same time is the same: under fast dither a \
                     filter damps, a delay does not. Switch the drive's filter off, or compare with the derivative \
                     of the angle: if that is early, it is the drive's",
            looks_like: "speed error at every acceleration, of the sign of the acceleration",
            excite: "fast dither of the voltage about zero speed; slow ramps do not show it",
            remedy: "lower the drive's filter, or declare it in the profile; count it into the loop's small \
                     time constant",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::positive("time_constant_s", "s", 0.5, 3e-3)];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Lag(values[0]))
    }
}

impl Terms for Lag {
    fn path(&self) -> Path {
        Path {
            speed_filter_s: self.0,
            ..Path::default()
        }
    }
}

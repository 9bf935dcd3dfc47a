use super::{Card, Effect, Enters, ParameterSpec, Path, Terms};

/// Voltage that reaches the motor later than it was stamped.
pub(super) struct CommandDelay;

struct Late(f64);

impl Effect for CommandDelay {
    fn card(&self) -> &'static Card {
        &Card {
            id: "command_delay",
            name: "command delay",
            enters: Enters::Path,
            equation: "the motor gets u(t - Td)",
            causes: "the drive's own cycle, a fieldbus or serial line between stamp and bridge, a modulator that \
                     updates once per period, host stamps that were taken too early. Let the drive return the time \
                     at which it applied the command: a delay of the line vanishes, that of the drive stays. A \
                     filtered current looks alike at a step, but does not move the speed",
            looks_like: "current and speed answer every step late by the same time; the error is largest at the \
                         edges of the voltage",
            excite: "many steep steps, a fast dither of the voltage; ramps and holds do not show it",
            remedy: "stamp the command where it is applied; declare the delay in the profile; count it into the \
                     loop's small time constant",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::positive("delay_s", "s", 0.5, 1e-3)];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Late(values[0]))
    }
}

impl Terms for Late {
    fn path(&self) -> Path {
        Path {
            command_delay_s: self.0,
            ..Path::default()
        }
    }
}

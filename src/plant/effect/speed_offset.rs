use super::{Card, Effect, Enters, ParameterSpec, Path, Terms};

/// Speed sensor whose zero is off.
pub(super) struct SpeedOffset;

struct Zero(f64);

impl Effect for SpeedOffset {
    fn card(&self) -> &'static Card {
        &Card {
            id: "speed_offset",
            name: "speed offset",
            enters: Enters::Path,
            equation: "y = w + w0: y is what is measured",
            causes: "a tachometer amplifier or an analogue input whose zero is off; a resolver converter that runs \
                     away slowly. An encoder cannot have it: there look for a reference or scaling that is added in \
                     the drive. At rest the sensor must show zero. A voltage offset moves the shaft in truth: \
                     compare with the angle",
            looks_like: "measured speed that is off by the same amount at rest, forward and backward",
            excite: "some tenths of a second at rest at zero volts, and both directions",
            remedy: "zero the input at rest; take the speed from the angle",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::coefficient(
            "offset_rad_s",
            "rad/s",
            f64::MAX,
            0.5,
        )];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Zero(values[0]))
    }
}

impl Terms for Zero {
    fn path(&self) -> Path {
        Path {
            speed_offset_rad_s: self.0,
            ..Path::default()
        }
    }
}

use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Drive that applies more or less than it was told, by the same amount always.
pub(super) struct VoltageOffset;

struct Bias(f64);

impl Effect for VoltageOffset {
    fn card(&self) -> &'static Card {
        &Card {
            id: "voltage_offset",
            name: "voltage offset",
            enters: Enters::Voltage,
            equation: "applied voltage = u + u0",
            causes: "an analogue command input whose zero is off, a modulator whose duty is not zero at zero, dead \
                     time that differs between the bridge's halves. Measure the terminals at command zero. An offset \
                     of the current sensor looks the same while the motor turns one way: reverse it, and stop it",
            looks_like: "a current that flows, or a motor that creeps, at command zero; more voltage error in one \
                         direction than in the other",
            excite: "some tenths of a second at rest at zero volts with the bridge on, then both directions at low \
                     speed",
            remedy: "trim the zero of the input or of the modulator; add -u0 to the command",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::coefficient("offset_v", "V", f64::MAX, 0.5)];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Bias(values[0]))
    }
}

impl Terms for Bias {
    fn voltage_v(&self, _at: &Instant, _own: &[f64]) -> f64 {
        -self.0
    }
}

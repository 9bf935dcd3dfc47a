use super::{Card, Effect, Enters, ParameterSpec, Path, Terms};

/// Current sensor whose zero is off.
pub(super) struct CurrentOffset;

struct Zero(f64);

impl Effect for CurrentOffset {
    fn card(&self) -> &'static Card {
        &Card {
            id: "current_offset",
            name: "current offset",
            enters: Enters::Path,
            equation: "y = i + i0: y is what is measured",
            causes: "a Hall sensor after an overload (remanence) or warm, an amplifier or converter whose zero was \
                     not taken. At rest with the bridge off the sensor must show zero: what it shows is the offset. \
                     A constant load also shifts the current in one direction only, but not at standstill without \
                     torque",
            looks_like: "measured current that is off by the same amount at rest, forward and backward",
            excite: "some tenths of a second at rest at zero volts, and both directions",
            remedy: "zero the sensor at every start with the bridge off; degauss or replace it when the offset grows",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::coefficient("offset_a", "A", f64::MAX, 0.1)];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Zero(values[0]))
    }
}

impl Terms for Zero {
    fn path(&self) -> Path {
        Path {
            current_offset_a: self.0,
            ..Path::default()
        }
    }
}

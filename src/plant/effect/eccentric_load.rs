use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Load of position, once per turn.
pub(super) struct EccentricLoad;

struct Imbalance {
    sin_n_m: f64,
    cos_n_m: f64,
}

impl Effect for EccentricLoad {
    fn card(&self) -> &'static Card {
        &Card {
            id: "eccentric_load",
            name: "eccentric load",
            enters: Enters::Torque,
            equation: "T = s sin(theta) + c cos(theta), once per turn",
            causes: "a lever, an arm or a mass out of centre under gravity; a cam or crank with a spring; a bent \
                     shaft or a rotor that rubs once per turn; a pulley out of round under belt tension. With the \
                     shaft free, gravity lets it come to rest at the same angle again; turned upright the error of a \
                     weight vanishes, that of a spring, a belt or a rub stays",
            looks_like: "torque error that repeats every turn; speed ripple at the frequency of rotation that \
                         shrinks as the speed rises",
            excite: "several slow turns in both directions, with the angle recorded; a quarter of a turn shows a \
                     constant load instead",
            remedy: "balance the mass, or feed forward s sin(theta) + c cos(theta); straighten or align what rubs",
            needs_angle: true,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("sin_n_m", "N.m", f64::MAX, 0.08),
            ParameterSpec::coefficient("cos_n_m", "N.m", f64::MAX, 0.08),
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Imbalance {
            sin_n_m: values[0],
            cos_n_m: values[1],
        })
    }
}

impl Terms for Imbalance {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        let [sin, cos] = at.angle.wave(1.0);
        self.sin_n_m * sin + self.cos_n_m * cos
    }
}

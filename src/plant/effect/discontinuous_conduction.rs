use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Extra resistance at small currents, where a converter's current has gaps.
pub(super) struct DiscontinuousConduction;

struct Gaps {
    extra_ohm: f64,
    boundary_a: f64,
}

impl Effect for DiscontinuousConduction {
    fn card(&self) -> &'static Card {
        &Card {
            id: "discontinuous_conduction",
            name: "discontinuous conduction",
            enters: Enters::Voltage,
            equation: "U = Rx i inside |i| < Ib, Rx Ib sgn(i) beyond",
            causes: "a thyristor or diode bridge, or a chopper at low frequency, whose current falls to zero between \
                     pulses below Ib: the mean voltage drops as if by a resistance. Look at the current with an \
                     oscilloscope: gaps between the pulses are proof. A brush or dead-time drop has the same shape \
                     with a far smaller Ib and stays when the converter is replaced by a battery (brushes) or when \
                     the load rises (both)",
            looks_like: "voltage error that grows steeply with the current up to a boundary and stays constant \
                         above; a sluggish current at small load",
            excite: "no-load running, and small currents of both signs, as well as currents well above the boundary",
            remedy: "a choke or a higher switching frequency lowers the boundary; an adaptive current controller \
                     with another gain inside it",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("extra_ohm", "ohm", f64::MAX, 1.0),
            ParameterSpec::shape(
                "boundary_a",
                "A",
                (0.01, 1000.0),
                &[0.3, 0.6, 1.2, 2.5, 5.0],
            ),
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Gaps {
            extra_ohm: values[0],
            boundary_a: values[1],
        })
    }
}

impl Terms for Gaps {
    fn voltage_v(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.extra_ohm * at.current_a.clamp(-self.boundary_a, self.boundary_a)
    }
}

use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Load of a fan, pump or propeller.
pub(super) struct QuadraticLoad;

struct Fan(f64);

impl Effect for QuadraticLoad {
    fn card(&self) -> &'static Card {
        &Card {
            id: "quadratic_load",
            name: "quadratic load",
            enters: Enters::Torque,
            equation: "T = k w |w|",
            causes: "fan, pump, propeller, windage of an open rotor. Take the fan or impeller off, or throttle it: \
                     what changes is its load. Over a narrow range of speed viscous friction looks alike; only a \
                     wide range tells them apart",
            looks_like: "torque error grows with the square of speed, odd in the direction",
            excite: "holds at five or more speeds up to the highest, both directions",
            remedy: "expected where a fan or pump is coupled; compensate by feed-forward k w |w|",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::coefficient(
            "quadratic_n_m_s2_per_rad2",
            "N.m.s2/rad2",
            f64::MAX,
            1.5e-6,
        )];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Fan(values[0]))
    }
}

impl Terms for Fan {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.0 * at.speed_rad_s * at.speed_rad_s.abs()
    }
}

use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Torque constant that depends on the position: ripple in proportion to the current.
pub(super) struct TorqueRipple;

/// Number of periods per turn that are tried.
const ORDERS: &[f64] = &[
    2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0,
    19.0, 20.0, 21.0, 22.0, 23.0, 24.0,
];

struct Ripple {
    sin_ratio: f64,
    cos_ratio: f64,
    order: f64,
}

impl Effect for TorqueRipple {
    fn card(&self) -> &'static Card {
        &Card {
            id: "torque_ripple",
            name: "torque ripple",
            enters: Enters::Torque,
            equation: "T = Kt i (s sin(N theta) + c cos(N theta)), N times per turn, in proportion to the current",
            causes: "commutation (N is the number of commutator bars, or six per pole pair); back-EMF that is not \
                     sinusoidal; an offset or a gain error of one phase current sensor (N is once or twice the pole \
                     pairs); an angle sensor out of centre (N = 1). An error of one phase current vanishes when its \
                     sensor is zeroed again; commutation stays. A ripple that is there without current is cogging: \
                     load the motor, what grows is ripple",
            looks_like: "torque error that repeats with the angle and grows with the current; noise and speed ripple \
                         under load",
            excite: "hard acceleration, or a real load, over many turns at low speed, with the angle recorded; \
                     without load it looks like nothing, at one load only like cogging",
            remedy: "zero and match the current sensors, check the angle sensor's mounting and the commutation \
                     angle; feed forward the ripple over the angle; replace worn brushes",
            needs_angle: true,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("sin_ratio", "-", f64::MAX, 0.03),
            ParameterSpec::coefficient("cos_ratio", "-", f64::MAX, 0.03),
            ParameterSpec::choice("order", "1/turn", (1.0, 1000.0), ORDERS),
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Ripple {
            sin_ratio: values[0],
            cos_ratio: values[1],
            order: values[2],
        })
    }
}

impl Terms for Ripple {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        let [sin, cos] = at.angle.wave(self.order);
        at.torque_n_m_per_a * at.current_a * (self.sin_ratio * sin + self.cos_ratio * cos)
    }
}

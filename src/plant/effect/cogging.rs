use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Torque of position, a whole number of times per turn and independent of the current.
pub(super) struct Cogging;

/// Number of periods per turn that are tried.
const ORDERS: &[f64] = &[
    2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0,
    19.0, 20.0, 21.0, 22.0, 23.0, 24.0,
];

struct Wave {
    sin_n_m: f64,
    cos_n_m: f64,
    order: f64,
}

impl Effect for Cogging {
    fn card(&self) -> &'static Card {
        &Card {
            id: "cogging",
            name: "cogging torque",
            enters: Enters::Torque,
            equation: "T = s sin(N theta) + c cos(N theta), N times per turn, whatever the current",
            causes: "magnets that prefer to face the teeth: N is a multiple of slots and poles (their least common \
                     multiple); gear teeth and belt teeth (N is their number); a joint or a coupling out of line (N \
                     = 2). Turn the shaft by hand with the leads open: magnets are felt as detents, a gear or joint \
                     is not felt with the load taken off. A ripple that grows with the current is torque ripple, not \
                     cogging",
            looks_like: "torque error that repeats with the angle; speed ripple that is largest at low speed; a \
                         shaft at rest that prefers certain angles; a spectral line at N times the speed",
            excite: "slow passages and low constant speeds over many turns, both directions, with the angle recorded \
                     (integrated speed serves, with less certainty)",
            remedy: "feed-forward of the torque over the angle; skewed slots or magnets; avoid long holds at the \
                     resonant speed; check the alignment of the coupling where N is 1 or 2",
            needs_angle: true,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("sin_n_m", "N.m", f64::MAX, 0.08),
            ParameterSpec::coefficient("cos_n_m", "N.m", f64::MAX, 0.08),
            ParameterSpec::choice("order", "1/turn", (1.0, 1000.0), ORDERS),
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Wave {
            sin_n_m: values[0],
            cos_n_m: values[1],
            order: values[2],
        })
    }
}

impl Terms for Wave {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        let [sin, cos] = at.angle.wave(self.order);
        self.sin_n_m * sin + self.cos_n_m * cos
    }
}

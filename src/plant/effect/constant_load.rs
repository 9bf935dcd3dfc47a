use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Load of one sign, whatever the direction of motion.
pub(super) struct ConstantLoad;

struct Weight(f64);

impl Effect for ConstantLoad {
    fn card(&self) -> &'static Card {
        &Card {
            id: "constant_load",
            name: "constant load",
            enters: Enters::Torque,
            equation: "T = T0, whatever the direction",
            causes: "a weight, a spring, belt tension; Coulomb friction that differs by direction (the same equation \
                     while it is below the Coulomb level: they cannot be told apart by a run). Turn the machine \
                     round, or take the weight off: a weight changes, a friction stays. An offset of the current \
                     sensor looks alike in motion, but shows at rest with the bridge off",
            looks_like: "torque error of one sign that turns from driving to braking when the direction changes",
            excite: "the same speeds in both directions",
            remedy: "balance the load, or compensate by a constant feed-forward",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::coefficient(
            "constant_n_m",
            "N.m",
            f64::MAX,
            0.05,
        )];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Weight(values[0]))
    }
}

impl Terms for Weight {
    fn torque_n_m(&self, _at: &Instant, _own: &[f64]) -> f64 {
        self.0
    }
}

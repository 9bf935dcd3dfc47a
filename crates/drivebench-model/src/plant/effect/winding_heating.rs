//! Resistance that rises as the winding takes up its own loss.

use super::{
    Axis, Balance, BiasedFit, Card, Enters, Instant, Measure, ParameterSpec, Place, Terms,
};

pub(super) const EFFECT: Card = Card {
    id: "winding_heating",
    name: "winding heating",
    enters: Enters::Voltage,
    equation: "U = R g x i, dx/dt = i^2 - x/tau: the resistance rises with the heat x taken up",
    causes: "copper loss: +39 % resistance per 100 K. Measure the resistance at the terminals \
        before and at once after the run. If it has not changed, look for a contact that warms up \
        (cable, brushes, relay); if Ke fell too, the magnets are hot",
    looks_like: "voltage error that drifts over seconds and follows the current",
    excite: "a hard part first, then repeat the first part: hot against cold",
    remedy: "name the temperature with every resistance; let the winding cool between runs: what \
        is left of the heat of one run is in the resistance of the next",
    takes_power: true,
    curve: Some((Balance::Voltage, Axis::Time)),
    biases: &[BiasedFit::FreeRun],
    parameters: &[
        ParameterSpec::coefficient("gain_per_a2_s", "1/(A2.s)", 1e-3),
        ParameterSpec::shape("time_constant_s", "s", (1.0, 2000.0), &[5.0, 20.0, 80.0])
            .of(Measure::Length),
    ],
    formula: &[
        (Place::Voltage, "R*gain_per_a2_s*x*i"),
        (Place::StateRate, "i^2 - x/time_constant_s"),
    ],
    terms: |values| Box::new(Heat { gain_per_a2_s: values[0], time_constant_s: values[1] }),
    ..Card::PLAIN
};

/// The heat x taken up is a state of its own.
struct Heat {
    gain_per_a2_s: f64,
    time_constant_s: f64,
}

impl Terms for Heat {
    fn voltage_v(&self, at: &Instant, own: &[f64]) -> f64 {
        at.resistance_ohm * self.gain_per_a2_s * own[0] * at.current_a
    }

    fn states(&self) -> usize {
        1
    }

    fn derivative(&self, at: &Instant, own: &[f64], out: &mut [f64]) {
        out[0] = at.current_a * at.current_a - own[0] / self.time_constant_s;
    }
}

//! Copper that warms up: winding and frame as two heat stores.

use super::{Acts, HiddenKind, Mechanism, Moment, NotNegative, Positive};

/// Temperature coefficient of copper at 25 C, 1/K.
const COPPER_PER_K: f64 = 0.00393;

/// Resistance that rises by `gain_per_a2_s` per A^2 s and decays with `time_constant_s`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "winding_heating",
    names: &["winding_heating"],
    parameters: &[
        NotNegative.of("gain_per_a2_s", "1/(A2.s)", 2e-3, 0.8e-3..2.2e-3),
        Positive.of("time_constant_s", "s", 20.0, 8.0..40.0),
    ],
    mystery: Some(|dice| vec![dice.size(1e-3, 4e-3), dice.between(10.0, 40.0)]),
    acts: Acts::Inside(|values, _| {
        Box::new(CopperAndFrame {
            rise_per_a2_s: values[0] / COPPER_PER_K,
            time_constant_s: values[1],
            winding_k: 0.0,
            frame_k: 0.0,
        })
    }),
};

/// Two-node network with the loss of the *hot* copper:
/// dTw/dt = k (1 + a Tw) i^2 - (Tw - Tf)/tau, dTf/dt = ((Tw - Tf) - Tf/0.1)/(30 tau), R = R25 (1 + a Tw).
/// The host's catalogue has one node and the loss of the cold copper.
struct CopperAndFrame {
    /// k, K/(A^2 s).
    rise_per_a2_s: f64,
    time_constant_s: f64,
    winding_k: f64,
    frame_k: f64,
}

impl Mechanism for CopperAndFrame {
    fn resistance_factor(&self) -> f64 {
        1.0 + COPPER_PER_K * self.winding_k
    }

    fn winding_rise_k(&self) -> Option<f64> {
        Some(self.winding_k)
    }

    fn advance(&mut self, step_s: f64, at: &Moment, _put_out_v: f64) {
        let heat = self.rise_per_a2_s * self.resistance_factor() * at.current_a * at.current_a;
        let across = self.winding_k - self.frame_k;
        // The frame has 30 times the heat capacity of the winding and a tenth of the thermal resistance, to ambient.
        let frame_rate = (across - self.frame_k / 0.1) / (30.0 * self.time_constant_s);
        self.winding_k += step_s * (heat - across / self.time_constant_s);
        self.frame_k += step_s * frame_rate;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loss_grows_with_the_resistance() {
        let mut winding = KIND.mechanism(&[2e-3, 20.0]);
        let at = Moment { current_a: 5.0, ..Moment::default() };
        for _ in 0..400_000 {
            winding.advance(50e-6, &at, 0.0);
        }
        // At 5 A gain i^2 = 1/tau: hot loss and cooling grow alike and the rise is gain i^2 t = 1 (the cold copper's
        // would be 0.63), a little more with a frame that warms up.
        let rise = winding.resistance_factor() - 1.0;
        assert!((1.0..1.1).contains(&rise), "{rise}");
    }
}

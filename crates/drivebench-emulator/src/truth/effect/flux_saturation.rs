//! Armature reaction: current weakens the field, less and less.

use super::{Acts, HiddenKind, NotNegative, flux_factor};
use crate::truth::MotorTruth;

/// Current at which the weakening has used up 58 % of its reach, in rated currents.
const REACH_RATED_CURRENTS: f64 = 6.0;

/// Flux that is 1/(1 + `saturation_per_a2` i^2) of the nameplate's, exactly so at rated current.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "flux_saturation",
    names: &["flux_saturation"],
    parameters: &[NotNegative.of("saturation_per_a2", "1/A2", 4e-4, 1.5e-4..4e-4)],
    mystery: Some(|dice| {
        // By so much at rated current. From 2 % on, the back-EMF at full speed falls faster with the current than the
        // resistance's voltage grows, and the current runs away; above 0.0128 that of the weakest specimen does.
        vec![dice.size(0.005, 0.0125) / (dice.current_a * dice.current_a)]
    }),
    acts: Acts::Inside(|values, site| {
        let rated = site.motor.rated_current_a;
        let weakened = 1.0 - 1.0 / (1.0 + values[0] * rated * rated);
        let reach = weakened / REACH_RATED_CURRENTS.recip().tanh().powi(2);
        let scale_a = REACH_RATED_CURRENTS * rated;
        // phi = 1 - d tanh(i/6In)^2, d so that it meets the host's 1/(1 + c i^2) at rated current. At twice the rated
        // current it weakens by a twentieth less; not more, because near full speed the current answers with several
        // times the difference. A field does not turn over.
        flux_factor(move |at| (1.0 - reach * (at.current_a / scale_a).tanh().powi(2)).max(0.05))
    }),
};

/// Largest `saturation_per_a2` with which the current stays stable up to `current_limit_a` at rated speed, for every
/// specimen within `tolerance`, 1/A2: R i + E phi(i) must rise with i, or more current means still more of it.
pub fn largest_stable(motor: &MotorTruth, current_limit_a: f64, tolerance: f64) -> f64 {
    let scale_a = REACH_RATED_CURRENTS * motor.rated_current_a;
    // tanh (1 - tanh^2), the slope of tanh^2, is steepest at 0.66.
    let bend = (current_limit_a / scale_a).min(0.66).tanh();
    let slope = 2.0 * bend * (1.0 - bend * bend) / scale_a;
    let back_emf_v = motor.back_emf_v_s_per_rad * motor.rated_speed_rad_s;
    let worst = (1.0 - tolerance) / (1.0 + tolerance);
    let reach = worst * motor.resistance_ohm / (back_emf_v * slope);
    let weakened = reach * REACH_RATED_CURRENTS.recip().tanh().powi(2);
    if weakened >= 1.0 {
        return f64::INFINITY;
    }
    weakened / (1.0 - weakened) / motor.rated_current_a.powi(2)
}

#[cfg(test)]
mod tests {
    use super::super::super::motor::zk_22fc;
    use super::super::Moment;
    use super::*;

    #[test]
    fn the_largest_stable_size_keeps_the_voltage_rising() {
        let motor = zk_22fc();
        let most = largest_stable(&motor, 11.4, 0.0);
        assert!((5e-4..6e-4).contains(&most), "{most}");
        let slope_at_limit = |saturation_per_a2| {
            let field = KIND.mechanism(&[saturation_per_a2]);
            let volts = |current_a: f64| {
                let at = Moment { current_a, ..Moment::default() };
                let back_emf_v = motor.back_emf_v_s_per_rad * motor.rated_speed_rad_s;
                motor.resistance_ohm * current_a + back_emf_v * field.flux_factor(&at)
            };
            volts(11.4) - volts(11.3)
        };
        assert!(slope_at_limit(0.97 * most) > 0.0);
        assert!(slope_at_limit(1.03 * most) < 0.0);
        // A specimen may have less resistance and more flux.
        assert!(largest_stable(&motor, 11.4, 0.1) < most);
    }
}

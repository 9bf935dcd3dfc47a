//! The true parameters of the motor, and the spread between nameplate and specimen.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Parameters of a permanent-magnet or separately excited DC motor, at 25 C and with the load on its shaft.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorTruth {
    pub name: String,
    pub rated_voltage_v: f64,
    pub rated_current_a: f64,
    pub rated_speed_rad_s: f64,
    pub resistance_ohm: f64,
    pub inductance_h: f64,
    pub back_emf_v_s_per_rad: f64,
    /// Left out: equal to the back-EMF constant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_n_m_per_a: Option<f64>,
    pub inertia_kg_m2: f64,
    /// Coulomb friction, always against the motion; it holds the shaft at rest up to this torque.
    pub load_torque_n_m: f64,
}

impl MotorTruth {
    /// Torque per ampere, N.m/A.
    pub fn torque_constant(&self) -> f64 {
        self.torque_n_m_per_a.unwrap_or(self.back_emf_v_s_per_rad)
    }

    /// One specimen of this motor: R, L, Ke (with Kt), J and Mc each within `fraction` of the nameplate, uniformly.
    #[must_use]
    pub fn specimen(&self, fraction: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Stream of the generator that is used for tolerances; noise has its own.
        rng.set_stream(1);
        let mut factor = || 1.0 + fraction * (2.0 * rng.random::<f64>() - 1.0);
        let mut specimen = self.clone();
        specimen.resistance_ohm *= factor();
        specimen.inductance_h *= factor();
        let flux = factor();
        specimen.back_emf_v_s_per_rad *= flux;
        specimen.torque_n_m_per_a = self.torque_n_m_per_a.map(|constant| constant * flux);
        specimen.inertia_kg_m2 *= factor();
        specimen.load_torque_n_m *= factor();
        specimen
    }

    /// The first value that no motor can have, as `(key, value)`.
    pub(crate) fn impossible(&self) -> Option<(&'static str, f64)> {
        let positive = [
            ("rated_voltage_v", self.rated_voltage_v),
            ("rated_current_a", self.rated_current_a),
            ("rated_speed_rad_s", self.rated_speed_rad_s),
            ("resistance_ohm", self.resistance_ohm),
            ("inductance_h", self.inductance_h),
            ("back_emf_v_s_per_rad", self.back_emf_v_s_per_rad),
            ("torque_n_m_per_a", self.torque_constant()),
            ("inertia_kg_m2", self.inertia_kg_m2),
        ];
        positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)).or_else(|| {
            let torque = self.load_torque_n_m;
            (!(torque.is_finite() && torque >= 0.0)).then_some(("load_torque_n_m", torque))
        })
    }
}

/// The DC motor of paper A.
#[cfg(test)]
pub(crate) fn zk_22fc() -> MotorTruth {
    MotorTruth {
        name: "ZK-22FC".to_owned(),
        rated_voltage_v: 110.0,
        rated_current_a: 5.7,
        rated_speed_rad_s: 293.2,
        resistance_ohm: 1.1,
        inductance_h: 0.0099,
        back_emf_v_s_per_rad: 0.3538,
        torque_n_m_per_a: None,
        inertia_kg_m2: 0.0045,
        load_torque_n_m: 0.455,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_specimen_lies_within_tolerance_and_depends_on_the_seed() {
        let mut nameplate = zk_22fc();
        nameplate.torque_n_m_per_a = Some(0.30);
        assert_eq!(nameplate.specimen(0.0, 3), nameplate);
        for seed in 0..200 {
            let specimen = nameplate.specimen(0.1, seed);
            assert_eq!(specimen, nameplate.specimen(0.1, seed));
            let ratios = [
                specimen.resistance_ohm / nameplate.resistance_ohm,
                specimen.inductance_h / nameplate.inductance_h,
                specimen.back_emf_v_s_per_rad / nameplate.back_emf_v_s_per_rad,
                specimen.inertia_kg_m2 / nameplate.inertia_kg_m2,
                specimen.load_torque_n_m / nameplate.load_torque_n_m,
            ];
            assert!(ratios.iter().all(|ratio| (ratio - 1.0).abs() <= 0.1));
            // Each parameter has a draw of its own, but Kt and Ke share the flux.
            assert!(ratios.windows(2).all(|pair| pair[0].to_bits() != pair[1].to_bits()));
            let ratio = specimen.torque_constant() / specimen.back_emf_v_s_per_rad;
            assert!((ratio - 0.30 / 0.3538).abs() < 1e-12);
        }
        assert_eq!(nameplate.impossible(), None);
        nameplate.inertia_kg_m2 = 0.0;
        assert_eq!(nameplate.impossible(), Some(("inertia_kg_m2", 0.0)));
    }
}

//! A second inertia behind a coupling, with or without play.
//!
//! ```text
//! motor, J1, sensors --[ stiffness, film, play ]-- load, J2, its share of the Coulomb friction
//! ```

use super::effect::Site;

/// The coupling and what is behind it. Symbols as in the literature: x the twist, r the load's share of the inertia,
/// k = (2 pi f)^2 J r (1 - r), d = 2 zeta sqrt(k J r (1 - r)).
#[derive(Clone, Copy, Debug)]
pub(super) struct Shaft {
    /// J1/J and J2/J.
    pub(super) motor_share: f64,
    pub(super) load_share: f64,
    /// Share of the Coulomb friction behind the coupling.
    pub(super) friction_split: f64,
    stiffness: f64,
    damping: f64,
    half_gap_rad: f64,
    /// s (k/Tn)^2, so that its product with z^2 is what the coupling has become stiffer by.
    stiffening: f64,
}

impl Shaft {
    /// `stiffening`: by how much the coupling is stiffer at rated torque than without load, as a share.
    pub(super) fn new(
        site: &Site,
        [frequency_hz, inertia_ratio, damping_ratio, friction_split]: [f64; 4],
        gap_rad: f64,
        stiffening: f64,
    ) -> Self {
        let reduced = site.motor.inertia_kg_m2 * inertia_ratio * (1.0 - inertia_ratio);
        let stiffness = (std::f64::consts::TAU * frequency_hz).powi(2) * reduced;
        Self {
            motor_share: 1.0 - inertia_ratio,
            load_share: inertia_ratio,
            friction_split,
            stiffness,
            damping: 2.0 * damping_ratio * (stiffness * reduced).sqrt(),
            half_gap_rad: 0.5 * gap_rad,
            stiffening: stiffening * (stiffness / site.rated_torque_n_m()).powi(2),
        }
    }

    /// Torque from motor to load, N.m: T = k z (1 + s (k z/Tn)^2) + d dx/dt, z the twist beyond half the play. The film
    /// between the flanks damps within the play too. The host's catalogue has no stiffening.
    pub(super) fn torque_n_m(&self, twist_rad: f64, rate_rad_s: f64) -> f64 {
        let beyond = twist_rad - twist_rad.clamp(-self.half_gap_rad, self.half_gap_rad);
        let spring = self.stiffness * beyond * (1.0 + self.stiffening * beyond * beyond);
        spring + self.damping * rate_rad_s
    }
}

#[cfg(test)]
mod tests {
    use super::super::motor::zk_22fc;
    use super::*;

    #[test]
    fn a_rated_torque_makes_it_a_few_percent_stiffer_and_play_shifts_it() {
        let site = Site::of(&zk_22fc());
        let shaft = Shaft::new(&site, [20.0, 0.4, 0.05, 0.5], 0.0, 0.03);
        let linear = shaft.torque_n_m(1e-6, 0.0) / 1e-6;
        let twist = site.rated_torque_n_m() / linear;
        let ratio = shaft.torque_n_m(twist, 0.0) / site.rated_torque_n_m();
        assert!((ratio - 1.0 - 0.03).abs() < 1e-6, "{ratio}");
        let loose = Shaft::new(&site, [20.0, 0.4, 0.05, 0.5], 0.04, 0.03);
        assert!(loose.torque_n_m(0.0199, 0.0) == 0.0, "play carries nothing");
        let beyond = loose.torque_n_m(-0.03, 0.0) - shaft.torque_n_m(-0.01, 0.0);
        assert!(beyond.abs() < 1e-12, "{beyond}");
    }
}

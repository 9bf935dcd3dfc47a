//! A fan with a long duct or a pump with a long pipe.

use super::{Acts, HiddenKind, Mechanism, Moment, NotNegative, Positive};

/// Load of `lagged_n_m_s2_per_rad2` times rated speed squared at rated speed, behind a lag of `time_constant_s`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "lagged_load",
    names: &["lagged_load"],
    parameters: &[
        NotNegative.of("lagged_n_m_s2_per_rad2", "N.m.s2/rad2", 1.8e-6, 1.2e-6..2.8e-6),
        Positive.of("time_constant_s", "s", 0.3, 0.15..0.6),
    ],
    mystery: Some(|dice| {
        vec![dice.torque_n_m / (dice.speed_rad_s * dice.speed_rad_s), dice.between(0.15, 0.6)]
    }),
    acts: Acts::Inside(|values, site| {
        let rated_speed_rad_s = site.motor.rated_speed_rad_s;
        // As measured fans: a power a little below two. The host's catalogue has w |w|.
        let (at_rated_n_m, power) = (values[0] * rated_speed_rad_s.powi(2), 1.95);
        Box::new(Column::new(at_rated_n_m, rated_speed_rad_s, power, values[1]))
    }),
};

/// A column that is set in motion: dT/dt = (Tn |w/wn|^power sgn(w) - T)/tau.
pub(super) struct Column {
    at_rated_n_m: f64,
    rated_speed_rad_s: f64,
    power: f64,
    time_constant_s: f64,
    torque_n_m: f64,
}

impl Column {
    pub(super) const fn new(
        at_rated_n_m: f64,
        rated_speed_rad_s: f64,
        power: f64,
        time_constant_s: f64,
    ) -> Self {
        Self { at_rated_n_m, rated_speed_rad_s, power, time_constant_s, torque_n_m: 0.0 }
    }
}

impl Mechanism for Column {
    fn load_torque_n_m(&self, _at: &Moment) -> f64 {
        self.torque_n_m
    }

    fn advance(&mut self, step_s: f64, at: &Moment, _put_out_v: f64) {
        let ratio = (at.speed_rad_s / self.rated_speed_rad_s).abs();
        let settled_n_m = (self.at_rated_n_m * ratio.powf(self.power)).copysign(at.speed_rad_s);
        self.torque_n_m += (settled_n_m - self.torque_n_m) * step_s / self.time_constant_s;
    }
}

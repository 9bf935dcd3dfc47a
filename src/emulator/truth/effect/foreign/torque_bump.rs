use super::{Hidden, Mechanism, Moment, Site, hidden_effect};

hidden_effect! {
    /// Friction that is higher about one speed, in either direction: a resonance that takes up power there.
    TorqueBump {
        bump_n_m: NotNegative in "N.m",
        speed_rad_s: Positive in "rad/s",
        width_rad_s: Positive in "rad/s",
    }
}

impl Hidden for TorqueBump {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Bump(self.clone())))
    }
}

/// T exp(-((|w| - w0)/width)^2) against the motion.
struct Bump(TorqueBump);

impl Mechanism for Bump {
    fn friction_n_m(&self, at: &Moment) -> f64 {
        let off = (at.speed_rad_s.abs() - self.0.speed_rad_s) / self.0.width_rad_s;
        self.0.bump_n_m * (-off * off).exp()
    }
}

use super::{Hidden, Mechanism, Moment, Site, hidden_effect};

hidden_effect! {
    /// Friction beyond Coulomb that falls exponentially: Ms exp(-|w|/ws), without memory.
    ExponentialStribeck {
        stribeck_n_m: NotNegative in "N.m",
        stribeck_speed_rad_s: Positive in "rad/s",
    }
}

impl Hidden for ExponentialStribeck {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Film(self.clone())))
    }
}

struct Film(ExponentialStribeck);

impl Mechanism for Film {
    fn friction_n_m(&self, at: &Moment) -> f64 {
        self.0.stribeck_n_m * (-at.speed_rad_s.abs() / self.0.stribeck_speed_rad_s).exp()
    }
}

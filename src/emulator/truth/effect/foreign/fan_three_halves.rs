use super::{Hidden, Mechanism, Site, hidden_effect};

hidden_effect! {
    /// A load between drag and fan: k |w|^1.5 against the motion.
    FanThreeHalves {
        three_halves_n_m_s15_per_rad15: NotNegative in "N.m.s1.5/rad1.5",
    }
}

impl Hidden for FanThreeHalves {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Stirrer(self.three_halves_n_m_s15_per_rad15)))
    }
}

struct Stirrer(f64);

impl Mechanism for Stirrer {
    fn drag_torque_n_m(&self, speed_rad_s: f64) -> f64 {
        self.0 * speed_rad_s * speed_rad_s.abs().sqrt()
    }
}

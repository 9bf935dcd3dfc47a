use super::{Hidden, Mechanism, Moment, Site, hidden_effect};

hidden_effect! {
    /// A torque that swings in time, whatever the machine does: a neighbour's machine on the same frame.
    Shaker {
        amplitude_n_m: NotNegative in "N.m",
        frequency_hz: Positive in "Hz",
    }
}

impl Hidden for Shaker {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Swing {
            amplitude_n_m: self.amplitude_n_m,
            frequency_rad_s: std::f64::consts::TAU * self.frequency_hz,
        }))
    }
}

struct Swing {
    amplitude_n_m: f64,
    frequency_rad_s: f64,
}

impl Mechanism for Swing {
    fn load_torque_n_m(&self, at: &Moment) -> f64 {
        self.amplitude_n_m * (self.frequency_rad_s * at.time_s).sin()
    }
}

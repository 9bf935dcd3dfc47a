use super::{Hidden, Mechanism, Moment, Site, hidden_effect};

hidden_effect! {
    /// Friction that builds up slowly from `time_s` after each start on, to `step_n_m` within `rise_s`.
    LoadRamp {
        step_n_m: NotNegative in "N.m",
        time_s: NotNegative in "s",
        rise_s: Positive in "s",
    }
}

impl Hidden for LoadRamp {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Ramp(self.clone())))
    }
}

struct Ramp(LoadRamp);

impl Mechanism for Ramp {
    fn friction_n_m(&self, at: &Moment) -> f64 {
        self.0.step_n_m * ((at.time_s - self.0.time_s) / self.0.rise_s).clamp(0.0, 1.0)
    }
}

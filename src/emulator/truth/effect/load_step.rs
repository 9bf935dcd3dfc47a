//! A brake that engages some time after the drive was started.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

/// Time constant with which the brake takes hold, s.
const GRIP_S: f64 = 0.015;

hidden_effect! {
    /// Friction of `step_n_m` from `time_s` after each start of the drive on.
    LoadStep {
        step_n_m: NotNegative in "N.m",
        time_s: NotNegative in "s",
    }
}

impl Hidden for LoadStep {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Brake {
            torque_n_m: self.step_n_m,
            time_s: self.time_s,
        }))
    }
}

/// T (1 - exp(-(t - t1)/15 ms)), the current of the brake's coil. The host's catalogue has a logistic curve about t1.
struct Brake {
    torque_n_m: f64,
    time_s: f64,
}

impl Mechanism for Brake {
    fn friction_n_m(&self, at: &Moment) -> f64 {
        let since_s = at.time_s - self.time_s;
        if since_s > 0.0 {
            -self.torque_n_m * (-since_s / GRIP_S).exp_m1()
        } else {
            0.0
        }
    }
}

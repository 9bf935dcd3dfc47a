//! A weight that is picked up some time after the drive was started.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

/// Time in which the rope comes under tension, s.
const TIGHT_S: f64 = 0.03;

hidden_effect! {
    /// Torque of `load_n_m` against positive motion from `time_s` after each start of the drive on.
    OneSidedLoad {
        load_n_m: Signed in "N.m",
        time_s: NotNegative in "s",
    }
}

impl Hidden for OneSidedLoad {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Weight {
            torque_n_m: self.load_n_m,
            time_s: self.time_s,
        }))
    }
}

/// T (t - t1)/30 ms until it hangs freely. The host's catalogue has a logistic curve about t1.
struct Weight {
    torque_n_m: f64,
    time_s: f64,
}

impl Mechanism for Weight {
    fn load_torque_n_m(&self, at: &Moment) -> f64 {
        self.torque_n_m * ((at.time_s - self.time_s) / TIGHT_S).clamp(0.0, 1.0)
    }
}

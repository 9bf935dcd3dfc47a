//! A weight on the shaft.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

hidden_effect! {
    /// Torque of one sign whatever the direction of motion. Beyond the Coulomb friction it turns a machine at rest.
    ConstantLoad {
        constant_n_m: Signed in "N.m",
    }
}

impl Hidden for ConstantLoad {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Weight(self.constant_n_m)))
    }
}

/// A constant has no other form than the host's.
struct Weight(f64);

impl Mechanism for Weight {
    fn load_torque_n_m(&self, _at: &Moment) -> f64 {
        self.0
    }
}

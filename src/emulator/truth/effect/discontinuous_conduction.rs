//! A thyristor bridge whose current comes in pieces: below a boundary its voltage falls steeply with the current.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Site};

hidden_effect! {
    /// Extra resistance of `extra_ohm` while the current is below `boundary_a`; above, what it dropped there stays.
    DiscontinuousConduction {
        boundary_a: Positive in "A",
        extra_ohm: NotNegative in "ohm",
    }
}

impl Hidden for DiscontinuousConduction {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Bridge {
            boundary_a: self.boundary_a,
            extra_ohm: self.extra_ohm,
        }))
    }
}

/// drop = r i/(1 + (i/ib)^4)^(1/4): the load line bends over about the boundary, as that of a bridge with some
/// inductance left does. The host's has a corner there.
struct Bridge {
    boundary_a: f64,
    extra_ohm: f64,
}

impl Mechanism for Bridge {
    fn voltage_loss_v(&self, current_a: f64) -> f64 {
        let ratio = current_a / self.boundary_a;
        self.extra_ohm * current_a / (1.0 + ratio.powi(4)).sqrt().sqrt()
    }
}

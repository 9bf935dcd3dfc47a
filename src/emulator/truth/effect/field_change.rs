//! Magnets that warm up and lose flux.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

/// Thermal time constant of the magnets, s.
const MAGNET_TIME_CONSTANT_S: f64 = 60.0;

hidden_effect! {
    /// Flux that changes by `drift_per_s` of itself at first, from each start of the drive on.
    FieldChange {
        drift_per_s: Signed in "1/s",
    }
}

impl Hidden for FieldChange {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Magnets {
            settled: self.drift_per_s * MAGNET_TIME_CONSTANT_S,
        }))
    }
}

/// phi = 1 + drift T (1 - exp(-t/T)), T = 60 s: over a run of 12 s it bends by a tenth from the host's 1 + drift t.
/// Each run begins with cold magnets: the pause before it counts as long enough.
struct Magnets {
    settled: f64,
}

impl Mechanism for Magnets {
    fn flux_factor(&self, at: &Moment) -> f64 {
        let share = -(-at.time_s / MAGNET_TIME_CONSTANT_S).exp_m1();
        // A field does not turn over.
        (1.0 + self.settled * share).max(0.05)
    }
}

//! A workpiece that is clamped some time after the drive was started.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Moment, Site};

hidden_effect! {
    /// Inertia larger by the share `ratio` from `time_s` after each start of the drive on; the speed does not jump. A
    /// change of inertia has no other form.
    InertiaChange {
        ratio: NotNegative in "-",
        time_s: NotNegative in "s",
    }
}

impl Hidden for InertiaChange {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Clamped {
            ratio: self.ratio,
            time_s: self.time_s,
        }))
    }
}

struct Clamped {
    ratio: f64,
    time_s: f64,
}

impl Mechanism for Clamped {
    fn inertia_factor(&self, at: &Moment) -> f64 {
        if at.time_s >= self.time_s {
            1.0 + self.ratio
        } else {
            1.0
        }
    }
}

use super::super::cogging::{Harmonics, Slots};
use super::{Hidden, Mechanism, Site, hidden_effect};

/// Second harmonic as a share of the first.
const SECOND_HARMONIC: f64 = 0.4;

hidden_effect! {
    /// Cogging far from a sine: 40 % second harmonic.
    HarmonicCogging {
        order: Order in "-",
        sin_n_m: Signed in "N.m",
        cos_n_m: Signed in "N.m",
    }
}

impl Hidden for HarmonicCogging {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Slots(Harmonics::new(
            self.order,
            (self.sin_n_m, self.cos_n_m),
            SECOND_HARMONIC,
        ))))
    }
}

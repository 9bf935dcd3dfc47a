//! Contact drop of the brushes.

use super::parameter::hidden_effect;
use super::{Hidden, Mechanism, Site};

/// Current at which the contact film carries 71 % of its full drop, A.
const FILM_CURRENT_A: f64 = 0.1;

hidden_effect! {
    /// A drop that saturates at `drop_v`, with the sign of the current.
    VoltageDrop {
        drop_v: NotNegative in "V",
    }
}

impl Hidden for VoltageDrop {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(BrushFilm {
            drop_v: self.drop_v,
        }))
    }
}

/// drop = V i/sqrt(i^2 + i0^2). The host's catalogue has a hyperbolic tangent.
struct BrushFilm {
    drop_v: f64,
}

impl Mechanism for BrushFilm {
    fn voltage_loss_v(&self, current_a: f64) -> f64 {
        self.drop_v * current_a / current_a.hypot(FILM_CURRENT_A)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::motor::zk_22fc;
    use super::*;

    #[test]
    fn odd_and_saturating() {
        let film = VoltageDrop { drop_v: 1.2 }
            .mechanism(&Site::of(&zk_22fc()))
            .unwrap();
        assert!((film.voltage_loss_v(5.7) - 1.2).abs() < 1e-3);
        assert!((film.voltage_loss_v(-0.1) + 1.2 / 2.0_f64.sqrt()).abs() < 1e-12);
    }
}

use super::{Hidden, Mechanism, Site, hidden_effect};

/// Six times as wide as that of the host's contact drop, A.
const WIDTH_A: f64 = 0.6;

hidden_effect! {
    /// A contact drop that builds up over the current: V tanh(i/0.6 A).
    SoftDrop {
        drop_v: NotNegative in "V",
    }
}

impl Hidden for SoftDrop {
    fn mechanism(&self, _site: &Site) -> Option<Box<dyn Mechanism>> {
        Some(Box::new(Contact(self.drop_v)))
    }
}

struct Contact(f64);

impl Mechanism for Contact {
    fn voltage_loss_v(&self, current_a: f64) -> f64 {
        self.0 * (current_a / WIDTH_A).tanh()
    }
}

//! A contact drop that builds up over the current: V tanh(i/0.6 A).

use super::{Acts, HiddenKind, NotNegative, voltage_loss};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "soft_drop",
    names: &["voltage_drop"],
    parameters: &[NotNegative.of("drop_v", "V", 3.0, 0.8..2.0)],
    mystery: None,
    acts: Acts::Inside(|values, _| {
        let drop_v = values[0];
        // 0.6 A: six times the width of the host's contact drop.
        voltage_loss(move |current_a| drop_v * (current_a / 0.6).tanh())
    }),
};

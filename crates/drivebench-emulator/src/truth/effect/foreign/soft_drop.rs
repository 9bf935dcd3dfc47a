//! A contact drop that builds up over the current: V tanh(i/0.6 A).

use super::{Acts, HiddenKind, NotNegative, voltage_loss};

/// Six times as wide as that of the host's contact drop, A.
const WIDTH_A: f64 = 0.6;

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "soft_drop",
    names: &["voltage_drop"],
    parameters: &[NotNegative.of("drop_v", "V", 3.0, 0.8..2.0)],
    mystery: None,
    acts: Acts::Inside(|values, _| {
        let drop_v = values[0];
        voltage_loss(move |current_a| drop_v * (current_a / WIDTH_A).tanh())
    }),
};

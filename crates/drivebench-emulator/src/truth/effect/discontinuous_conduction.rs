//! A thyristor bridge whose current comes in pieces: below a boundary its voltage falls steeply with the current.

use super::{Acts, HiddenKind, NotNegative, Positive, named, voltage_loss};

/// Extra resistance of `extra_ohm` while the current is below `boundary_a`; above, what it dropped there stays.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "discontinuous_conduction",
    names: &["discontinuous_conduction"],
    parameters: &[
        Positive.of("boundary_a", "A", 2.0, 1.0..2.5),
        NotNegative.of("extra_ohm", "ohm", 1.0, 0.5..1.5),
    ],
    mystery: Some(|dice| vec![dice.between(1.0, 3.0), dice.size(0.5, 2.0)]),
    acts: Acts::Inside(|values, _| {
        let [boundary_a, extra_ohm] = named(values);
        // drop = r i/(1 + (i/ib)^4)^(1/4): the load line bends over about the boundary, as that of a bridge with some
        // inductance left does. The host's has a corner there.
        voltage_loss(move |current_a| {
            let ratio = current_a / boundary_a;
            extra_ohm * current_a / (1.0 + ratio.powi(4)).sqrt().sqrt()
        })
    }),
};

//! A thyristor bridge whose current comes in pieces: below a boundary its voltage falls steeply with the current.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, named, voltage_loss};

/// Extra resistance of `extra_ohm` while the current is below `boundary_a`; above, what it dropped there stays.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "discontinuous_conduction",
    names: &["discontinuous_conduction"],
    parameters: &[
        Parameter::new("boundary_a", "A", Allowed::Positive, 2.0),
        Parameter::new("extra_ohm", "ohm", Allowed::NotNegative, 1.0),
    ],
    mystery: Some(|dice| vec![dice.between(1.0, 3.0), dice.size(0.5, 2.0)]),
    study: &[
        Between("boundary_a", 1.0, 2.5),
        Between("extra_ohm", 0.5, 1.5),
    ],
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

//! A load behind a rubber coupling.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, Shaft, named};

/// Rubber is so much stiffer at rated torque than without load, as a share.
const STIFFENING: f64 = 0.03;

/// Motor with `1 - inertia_ratio` of the inertia, load with the rest; they swing against each other at `frequency_hz`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "elastic_coupling",
    names: &["elastic_coupling"],
    parameters: &[
        Parameter::new("frequency_hz", "Hz", Allowed::Positive, 22.0),
        Parameter::new("inertia_ratio", "-", Allowed::Share, 0.4),
        Parameter::new("damping_ratio", "-", Allowed::Fraction, 0.03),
        // Share of the Coulomb friction behind the coupling.
        Parameter::new("friction_split", "-", Allowed::Fraction, 0.5),
    ],
    mystery: Some(|dice| {
        vec![
            dice.between(10.0, 30.0),
            dice.between(0.3, 0.6),
            dice.between(0.02, 0.08),
            dice.between(0.2, 0.8),
        ]
    }),
    study: &[
        Between("frequency_hz", 14.0, 30.0),
        Between("inertia_ratio", 0.35, 0.6),
        Between("damping_ratio", 0.03, 0.08),
        Between("friction_split", 0.2, 0.6),
    ],
    // See [`Shaft`]: it stiffens under torque, the host's does not.
    acts: Acts::Behind(|values, site| Shaft::new(site, named(values), 0.0, STIFFENING)),
};

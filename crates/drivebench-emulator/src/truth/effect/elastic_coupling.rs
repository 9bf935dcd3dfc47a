//! A load behind a rubber coupling.

use super::{Acts, Fraction, HiddenKind, Positive, Shaft, Share, named};

/// Motor with `1 - inertia_ratio` of the inertia, load with the rest; they swing against each other at `frequency_hz`.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "elastic_coupling",
    names: &["elastic_coupling"],
    parameters: &[
        Positive.of("frequency_hz", "Hz", 22.0, 14.0..30.0),
        Share.of("inertia_ratio", "-", 0.4, 0.35..0.6),
        Fraction.of("damping_ratio", "-", 0.03, 0.03..0.08),
        // Share of the Coulomb friction behind the coupling.
        Fraction.of("friction_split", "-", 0.5, 0.2..0.6),
    ],
    mystery: Some(|dice| {
        vec![
            dice.between(10.0, 30.0),
            dice.between(0.3, 0.6),
            dice.between(0.02, 0.08),
            dice.between(0.2, 0.8),
        ]
    }),
    // Rubber is 3 % stiffer at rated torque than without load ([`Shaft`]); the host's stiffness is constant.
    acts: Acts::Behind(|values, site| Shaft::new(site, named(values), 0.0, 0.03)),
};

//! A load behind a coupling with play.

use super::{Acts, Fraction, HiddenKind, NotNegative, Positive, Shaft, Share, named};

/// As `elastic_coupling`, and over `gap_rad` the coupling carries no torque.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "backlash",
    names: &["backlash"],
    parameters: &[
        Positive.of("frequency_hz", "Hz", 45.0, 35.0..55.0),
        Share.of("inertia_ratio", "-", 0.4, 0.35..0.6),
        Fraction.of("damping_ratio", "-", 0.05, 0.03..0.08),
        // Share of the Coulomb friction behind the coupling.
        Fraction.of("friction_split", "-", 0.5, 0.2..0.6),
        NotNegative.of("gap_rad", "rad", 0.04, 0.03..0.08),
    ],
    mystery: Some(|dice| {
        vec![
            dice.between(25.0, 45.0),
            dice.between(0.3, 0.6),
            dice.between(0.02, 0.08),
            dice.between(0.2, 0.8),
            dice.size(0.02, 0.1),
        ]
    }),
    // Flanks in line contact are 1 % stiffer at rated torque than without load ([`Shaft`]); the host's stiffness is constant. A
    // larger change would move the impacts so far that no fit finds the motion after them.
    acts: Acts::Behind(|values, site| Shaft::new(site, named(values), values[4], 0.01)),
};

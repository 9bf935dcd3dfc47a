//! A load behind a coupling with play.

use super::Draw::Between;
use super::{Acts, Allowed, HiddenKind, Parameter, Shaft, named};

/// Flanks that touch on a line are so much stiffer at rated torque than without load, as a share. More would move the
/// instants at which they meet so far that the motion after them is another one, which no fit finds again.
const STIFFENING: f64 = 0.01;

/// As `elastic_coupling`, and over `gap_rad` the coupling carries no torque.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "backlash",
    names: &["backlash"],
    parameters: &[
        Parameter::new("frequency_hz", "Hz", Allowed::Positive, 45.0),
        Parameter::new("inertia_ratio", "-", Allowed::Share, 0.4),
        Parameter::new("damping_ratio", "-", Allowed::Fraction, 0.05),
        // Share of the Coulomb friction behind the coupling.
        Parameter::new("friction_split", "-", Allowed::Fraction, 0.5),
        Parameter::new("gap_rad", "rad", Allowed::NotNegative, 0.04),
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
    study: &[
        Between("frequency_hz", 35.0, 55.0),
        Between("inertia_ratio", 0.35, 0.6),
        Between("damping_ratio", 0.03, 0.08),
        Between("friction_split", 0.2, 0.6),
        Between("gap_rad", 0.03, 0.08),
    ],
    // See [`Shaft`]: it stiffens under torque, the host's does not.
    acts: Acts::Behind(|values, site| Shaft::new(site, named(values), values[4], STIFFENING)),
};

//! Cogging far from a sine: 40 % second harmonic.

use super::super::cogging::slots;
use super::Draw::{OneOf, Phase};
use super::{Acts, Allowed, HiddenKind, Parameter, named};

/// Second harmonic as a share of the first.
const SECOND_HARMONIC: f64 = 0.4;

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "harmonic_cogging",
    names: &["cogging"],
    parameters: &[
        Parameter::new("order", "-", Allowed::Order, 7.0),
        Parameter::new("sin_n_m", "N.m", Allowed::Signed, 0.1),
        Parameter::new("cos_n_m", "N.m", Allowed::Signed, 0.0),
    ],
    mystery: None,
    study: &[
        OneOf("order", &[4.0, 6.0, 8.0, 9.0]),
        Phase(["sin_n_m", "cos_n_m"], 0.07, 0.15),
    ],
    acts: Acts::Inside(|values, _| slots(named(values), SECOND_HARMONIC)),
};

//! Cogging far from a sine: 40 % second harmonic.

use super::super::cogging::slots;
use super::{Acts, HiddenKind, Parameter, Wave, named};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "harmonic_cogging",
    names: &["cogging"],
    parameters: &[
        Parameter::order(&[4.0, 6.0, 8.0, 9.0]),
        Wave.of("sin_n_m", "N.m", 0.1, 0.07..0.15),
        Wave.of("cos_n_m", "N.m", 0.0, 0.07..0.15),
    ],
    mystery: None,
    acts: Acts::Inside(|values, _| slots(named(values), 0.4)),
};

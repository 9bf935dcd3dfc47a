//! Errors of a sequence and the checks of its values.

use thiserror::Error;

/// A value of one excitation that is not allowed.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{key} = {value} is not allowed (allowed: {allowed})")]
pub struct Refusal {
    pub key: &'static str,
    pub value: f64,
    pub allowed: &'static str,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum ExcitationError {
    #[error("sequence part {number} ({kind}): {refusal}")]
    Value {
        /// Position in the sequence, from 1.
        number: usize,
        kind: &'static str,
        refusal: Refusal,
    },
    #[error("slew_v_per_s = {0} is not allowed (allowed: more than 0, finite)")]
    Slew(f64),
    #[error("the sequence has no parts")]
    Empty,
    #[error("the sequence lasts {0} s (allowed: up to 86400 s)")]
    TooLong(f64),
}

impl ExcitationError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Value { .. } => "correct the value in the bench file's sequence",
            Self::Slew(_) => {
                "300 to 500 V/s keeps a motor of 0.0045 kg.m2 under four times its rated current"
            }
            Self::Empty => "add at least one part, for instance standstill = { seconds = 0.5 }",
            Self::TooLong(_) => "shorten the parts or record several runs",
        }
    }
}

/// The longest program, s: a day.
pub(super) const LONGEST_S: f64 = 86_400.0;

pub(super) fn finite(key: &'static str, value: f64) -> Result<(), Refusal> {
    refuse_unless(value.is_finite(), key, value, "a finite number")
}

pub(super) fn amplitude(key: &'static str, value: f64) -> Result<(), Refusal> {
    let good = value.is_finite() && value >= 0.0;
    refuse_unless(good, key, value, "0 or more, finite")
}

pub(super) fn duration(key: &'static str, value: f64) -> Result<(), Refusal> {
    let good = value > 0.0 && value <= LONGEST_S;
    refuse_unless(good, key, value, "more than 0 s, up to 86400 s")
}

/// A clock that is not longer than what it divides; more than a million changes would be a mistake in a unit.
pub(super) fn clock(key: &'static str, value: f64, seconds: f64) -> Result<(), Refusal> {
    let good = value > 0.0 && value <= seconds && seconds / value <= 1e6;
    let allowed = "more than 0 s, up to the length of its part, at most 1e6 changes";
    refuse_unless(good, key, value, allowed)
}

pub(super) fn refuse_unless(
    good: bool,
    key: &'static str,
    value: f64,
    allowed: &'static str,
) -> Result<(), Refusal> {
    let refusal = Refusal { key, value, allowed };
    if good { Ok(()) } else { Err(refusal) }
}

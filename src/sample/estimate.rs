//! A number with its uncertainty and verdict; nothing is shown without both.

use serde::Serialize;

/// What the data allow to be said about a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    Settled,
    Searching,
    /// The data do not carry it: value and standard deviation are null.
    NotObservable,
    /// A value was found but physics forbids it: shown, with the reason.
    Invalid,
    /// Given by the user, not fitted.
    Fixed,
}

impl Verdict {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Settled => "settled",
            Self::Searching => "searching",
            Self::NotObservable => "not observable",
            Self::Invalid => "invalid",
            Self::Fixed => "fixed",
        }
    }
}

/// One estimated parameter. Serialises to the contract of `identify --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// `inertia_kg_m2`, or `stribeck_friction.stribeck_n_m` for a parameter of an effect.
    #[serde(skip)]
    pub key: String,
    pub value: Option<f64>,
    /// Standard deviation, same unit.
    pub std: Option<f64>,
    pub unit: &'static str,
    pub verdict: Verdict,
    pub reason: Option<String>,
}

impl ParameterEstimate {
    /// A parameter that the data do not carry.
    pub fn not_observable(key: &str, unit: &'static str, reason: impl Into<String>) -> Self {
        Self {
            key: key.to_owned(),
            value: None,
            std: None,
            unit,
            verdict: Verdict::NotObservable,
            reason: Some(reason.into()),
        }
    }
}

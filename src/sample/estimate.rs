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

/// Standard deviations that hold 95 % of a normal distribution on either side of its mean.
const TWO_SIDED_95: f64 = 1.959_964;

/// One estimated parameter. Serialises to the contract of `identify --json`, with the 95 % interval beside.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(into = "Contract")]
pub struct ParameterEstimate {
    /// `inertia_kg_m2`, or `stribeck_friction.stribeck_n_m` for a parameter of an effect.
    pub key: String,
    pub value: Option<f64>,
    /// Standard deviation, same unit. The 95 % interval is the value and 1.96 of these on either side.
    pub std: Option<f64>,
    pub unit: &'static str,
    pub verdict: Verdict,
    pub reason: Option<String>,
}

/// What `identify --json` prints of a parameter.
#[derive(Serialize)]
struct Contract {
    value: Option<f64>,
    std: Option<f64>,
    interval_95: Option<[f64; 2]>,
    unit: &'static str,
    verdict: Verdict,
    reason: Option<String>,
}

impl From<ParameterEstimate> for Contract {
    fn from(estimate: ParameterEstimate) -> Self {
        Self {
            interval_95: estimate.interval_95(),
            value: estimate.value,
            std: estimate.std,
            unit: estimate.unit,
            verdict: estimate.verdict,
            reason: estimate.reason,
        }
    }
}

impl ParameterEstimate {
    /// Interval that covers the truth in 95 % of runs; none for a value that was given, or without one.
    pub fn interval_95(&self) -> Option<[f64; 2]> {
        let (value, std) = (self.value?, self.std.filter(|std| *std > 0.0)?);
        let half = TWO_SIDED_95 * std;
        Some([value - half, value + half])
    }

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

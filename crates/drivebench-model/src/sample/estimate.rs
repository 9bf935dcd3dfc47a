//! An estimated parameter with its standard deviation and verdict.

use crate::tabulated;
use serde::ser::SerializeStruct as _;
use serde::{Deserialize, Serialize, Serializer};

use crate::findings;
use crate::text::number::{self, significant, with_std, with_unit};

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Verdict {
        Settled = "settled",
        Searching = "searching",
        /// Not determined by the data: value and standard deviation are null.
        NotObservable = "not observable",
        /// Physically impossible value: shown, with the reason.
        Invalid = "invalid",
        /// Given by the user, not fitted.
        Fixed = "fixed",
    }
    pub const fn name(self) -> &'static str;
}

findings! {
    /// Why an estimate has no value, or is not settled.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Reason {
        NotExcited = "not_excited",
        Uncertain = "uncertain",
        MayBeZero = "may_be_zero",
        Impossible = "impossible_value",
        OnlyTogether = "determined_only_with_others",
        /// It holds if another value, or the form of an effect, is right.
        DependsOnAnother = "depends_on_another_value",
        /// Another value, or another effect, explains the run as well.
        Ambiguous = "not_told_from_another",
        SampledTooSlowly = "sampled_too_slowly",
        StampsUncertain = "stamps_too_uncertain",
        TooFewRows = "too_few_rows",
        SignalMissing = "signal_missing",
        SignalOrigin = "origin_of_a_signal",
        FaultyData = "fault_of_the_data",
        VoltageLimited = "voltage_limited_by_the_drive",
        NotConverged = "fit_not_converged",
        ModelMisses = "model_misses_something",
        MethodBiased = "method_is_biased",
        NotInScheme = "not_carried_by_the_scheme",
        NoStep = "no_step_to_read",
        ReadOnce = "read_once",
        RunsDiffer = "runs_differ",
        NotInEveryRun = "not_in_every_run",
        Disagree = "estimates_disagree",
        InertiaChanged = "inertia_changed",
        HoldoutOnly = "happened_in_the_holdout_only",
        TemperatureUnknown = "temperature_unknown",
    }
}

/// Half-width of the two-sided 95 % interval of a normal distribution, in standard deviations.
pub const TWO_SIDED_95: f64 = 1.959_964;

/// One estimated parameter. Serialises to the contract of `identify --json`, with the 95 % interval beside.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterEstimate {
    /// `inertia_kg_m2`, or `stribeck_friction.stribeck_n_m` for a parameter of an effect.
    pub key: String,
    pub value: Option<f64>,
    /// Standard deviation, same unit. The 95 % interval is the value and 1.96 of these on either side.
    pub std: Option<f64>,
    pub unit: &'static str,
    pub verdict: Verdict,
    pub reason: Option<String>,
    /// Of the reason; none where it was read from a file.
    pub code: Option<Reason>,
}

impl Serialize for ParameterEstimate {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut out = serializer.serialize_struct("ParameterEstimate", 7)?;
        out.serialize_field("value", &self.value)?;
        out.serialize_field("std", &self.std)?;
        out.serialize_field("interval_95", &self.interval_95())?;
        out.serialize_field("unit", self.unit)?;
        out.serialize_field("verdict", &self.verdict)?;
        out.serialize_field("reason", &self.reason)?;
        out.serialize_field("reason_code", &self.code)?;
        out.end()
    }
}

impl ParameterEstimate {
    /// Interval that covers the truth in 95 % of runs; none for a value that was given, or without one.
    pub fn interval_95(&self) -> Option<[f64; 2]> {
        let (value, std) = (self.value?, self.std.filter(|std| *std > 0.0)?);
        let half = TWO_SIDED_95 * std;
        Some([value - half, value + half])
    }

    /// `value ± std` with so many standard deviations, without the unit; `n/a` where it is not observable.
    pub fn number(&self, deviations: f64) -> String {
        match (self.verdict, self.value) {
            (Verdict::NotObservable, _) | (_, None) => number::MISSING.to_owned(),
            (Verdict::Fixed, Some(value)) => significant(value, 5),
            (_, Some(value)) => with_std(value, self.std.map(|std| deviations * std)),
        }
    }

    pub fn text(&self, deviations: f64) -> String {
        with_unit(&self.number(deviations), self.unit)
    }

    pub fn find<'a>(parameters: &'a [Self], key: &str) -> Option<&'a Self> {
        parameters.iter().find(|parameter| parameter.key == key)
    }

    pub fn value_of(parameters: &[Self], key: &str) -> Option<f64> {
        Self::find(parameters, key)?.value
    }

    /// Changes a settled verdict to searching, for a reason; any other stays.
    pub fn unsettle(&mut self, code: Reason, reason: impl Into<String>) {
        if self.verdict == Verdict::Settled {
            self.set(Verdict::Searching, code, reason);
        }
    }

    pub fn set(&mut self, verdict: Verdict, code: Reason, reason: impl Into<String>) {
        (self.verdict, self.code, self.reason) = (verdict, Some(code), Some(reason.into()));
    }

    /// Value and standard deviation, where the verdict is settled or searching.
    pub fn carried(&self) -> Option<(f64, Option<f64>)> {
        let is_observable = matches!(self.verdict, Verdict::Settled | Verdict::Searching);
        Some((self.value.filter(|_| is_observable)?, self.std))
    }

    /// An estimated value: settled, or searching for a reason.
    pub fn found(
        key: impl Into<String>,
        unit: &'static str,
        value: f64,
        std: f64,
        doubt: Option<(Reason, String)>,
    ) -> Self {
        let verdict = doubt.as_ref().map(|_| Verdict::Searching);
        let (code, reason) = doubt.unzip();
        Self {
            verdict: verdict.unwrap_or(Verdict::Settled),
            reason,
            code,
            std: Some(std),
            ..Self::fixed(key, unit, value)
        }
    }

    pub fn fixed(key: impl Into<String>, unit: &'static str, value: f64) -> Self {
        Self {
            key: key.into(),
            value: Some(value),
            std: Some(0.0),
            unit,
            verdict: Verdict::Fixed,
            reason: None,
            code: None,
        }
    }

    pub fn not_observable(
        key: &str,
        unit: &'static str,
        code: Reason,
        reason: impl Into<String>,
    ) -> Self {
        Self {
            value: None,
            std: None,
            verdict: Verdict::NotObservable,
            reason: Some(reason.into()),
            code: Some(code),
            ..Self::fixed(key, unit, f64::NAN)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_that_is_not_observable_has_no_number() {
        let mut parameter = ParameterEstimate::not_observable(
            "inductance_h",
            "H",
            Reason::SampledTooSlowly,
            "sample faster",
        );
        assert_eq!(parameter.text(1.0), "n/a");
        parameter.value = Some(0.01);
        parameter.verdict = Verdict::Searching;
        assert_eq!(parameter.text(1.0), "0.0100 ± unknown H");
        parameter.std = Some(0.001);
        assert_eq!(parameter.text(2.0), "0.0100 ± 0.0020 H");
    }
}

//! Identity checks, states and the steps of commands: what refers to signals and set-points by name.

use std::collections::BTreeMap;
use std::ops::Range;

use toml::Spanned;

use super::super::facts::{
    Condition, IdentityCheck, IdentityTest, PollRate, RegisterMap, SetPoint, Step,
};
use super::super::schema::{ConditionKeys, IdentityKeys, StepKeys};
use super::Reader;
use crate::config_text::ConfigError;

impl Reader<'_> {
    pub(super) fn identity(
        &self,
        spanned: &Spanned<IdentityKeys>,
        map: &RegisterMap,
    ) -> Result<IdentityCheck, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        match (&keys.signal, keys.object, &keys.contains) {
            (None, Some(object), Some(contains)) if self.functions.contains(&43) => Ok(IdentityCheck::Object {
                object,
                contains: contains.clone(),
            }),
            (Some(signal), None, None) => {
                self.known(signal, map.signals.iter().map(|s| s.name.as_str()), "signal", &span)?;
                let test = match (keys.equals, &keys.one_of, keys.within) {
                    (Some(pattern), None, None) => IdentityTest::OneOf(vec![pattern]),
                    (None, Some(patterns), None) => IdentityTest::OneOf(patterns.clone()),
                    (None, None, Some(range)) => IdentityTest::Within(range),
                    _ => return Err(self.at(&span, "signal", "expected one of equals, one_of and within".to_owned())),
                };
                Ok(IdentityCheck::Signal {
                    signal: signal.clone(),
                    mask: keys.mask.unwrap_or(u32::MAX),
                    test,
                })
            }
            _ => Err(self.at(&span, "", "an identity check has a signal with equals, one_of or within; or, with function code 43, an object and contains".to_owned())),
        }
    }

    pub(super) fn state(
        &self,
        spanned: &Spanned<ConditionKeys>,
        map: &RegisterMap,
    ) -> Result<Result<Condition, String>, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        if let Some(reason) = &keys.none {
            return Ok(Err(reason.clone()));
        }
        let (Some(signal), Some(mask)) = (&keys.signal, keys.mask) else {
            return Err(self.at(
                &span,
                "",
                "a state has signal, mask and equals (or not_equals), or none = \"why\"".to_owned(),
            ));
        };
        let (pattern, negated) = match (keys.equals, keys.not_equals) {
            (Some(pattern), None) => (pattern, false),
            (None, Some(pattern)) => (pattern, true),
            _ => {
                return Err(self.at(
                    &span,
                    "mask",
                    "expected one of equals and not_equals".to_owned(),
                ));
            }
        };
        self.condition(signal, mask, pattern, negated, &span, map)
            .map(Ok)
    }

    pub(super) fn condition(
        &self,
        signal: &str,
        mask: u32,
        pattern: u32,
        negated: bool,
        span: &Range<usize>,
        map: &RegisterMap,
    ) -> Result<Condition, ConfigError> {
        let fast = map
            .signals
            .iter()
            .filter(|signal| signal.poll == PollRate::Fast);
        let fast: Vec<&str> = fast.map(|signal| signal.name.as_str()).collect();
        self.known(
            signal,
            fast.iter().copied(),
            "signal with poll = \"fast\"",
            span,
        )?;
        if pattern & !mask != 0 {
            let message = format!(
                "{pattern:#06x} has bits outside of the mask {mask:#06x}: it can never hold"
            );
            return Err(self.at(span, "mask", message));
        }
        Ok(Condition {
            signal: signal.to_owned(),
            mask,
            pattern,
            negated,
            line: self.line(span),
        })
    }

    pub(super) fn fault_codes(
        &self,
        texts: &BTreeMap<String, String>,
    ) -> Result<BTreeMap<u16, String>, ConfigError> {
        let number = |text: &str| match text.strip_prefix("0x") {
            Some(digits) => u16::from_str_radix(digits, 16),
            None => text.parse(),
        };
        let codes = texts.iter().map(|(code, text)| {
            let code = number(code).map_err(|_| {
                let message =
                    format!("{code:?} is no fault code (expected 0 to 65535, or 0x0000 to 0xffff)");
                self.at(&self.part("[fault_codes"), code, message)
            })?;
            Ok((code, text.clone()))
        });
        codes.collect()
    }

    pub(super) fn steps(
        &self,
        steps: &[Spanned<StepKeys>],
        map: &RegisterMap,
    ) -> Result<Vec<Step>, ConfigError> {
        steps.iter().map(|step| self.step(step, map)).collect()
    }

    /// The steps of a command that may be empty, but not be forgotten.
    pub(super) fn declared(
        &self,
        name: &str,
        steps: Option<&[Spanned<StepKeys>]>,
        map: &RegisterMap,
    ) -> Result<Vec<Step>, ConfigError> {
        let Some(steps) = steps else {
            let why = match name {
                "coast" => "it is tried where stop fails",
                _ => "without it no fault can be cleared over the bus",
            };
            return Err(self.whole(
                "[commands]",
                format!("the command {name} is missing: {why} (expected its steps; or {name} = [] if the drive has none)"),
            ));
        };
        self.steps(steps, map)
    }

    pub(super) fn step(
        &self,
        spanned: &Spanned<StepKeys>,
        map: &RegisterMap,
    ) -> Result<Step, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        match (&keys.write, &keys.wait, keys.delay_ms) {
            (Some(name), None, None) => {
                self.known(name, map.set_points.iter().map(|p| p.name.as_str()), "setpoint", &span)?;
                let point = map.set_point(name).filter(|point| point.name == *name);
                let value = keys.value.ok_or_else(|| self.at(&span, "write", "value is missing".to_owned()))?;
                let fits = point.is_none_or(|point| {
                    !point.numbers.scale_by.is_empty()
                        || point.location.layout.encode(point.numbers.raw(value, 1.0)).is_some()
                });
                if !fits {
                    return Err(self.at(&span, "value", format!("value {value} does not fit the type of {name}")));
                }
                if let Some(reason) = point.and_then(|point| not_by_command(point, value)) {
                    return Err(self.at(&span, "value", reason));
                }
                let mask = keys.mask.map(u16::try_from).transpose();
                let mask = mask.map_err(|_| self.at(&span, "mask", "a mask for writing has 16 bits".to_owned()))?;
                Ok(Step::Write {
                    set_point: name.clone(),
                    value,
                    mask,
                })
            }
            (None, Some(signal), None) => {
                let (Some(mask), Some(pattern), Some(within_ms)) = (keys.mask, keys.equals, keys.within_ms) else {
                    return Err(self.at(&span, "wait", "a wait has mask, equals and within_ms".to_owned()));
                };
                if !(within_ms.is_finite() && within_ms > 0.0) {
                    return Err(self.at(&span, "within_ms", format!("within_ms {within_ms} is not allowed (expected more than 0)")));
                }
                Ok(Step::Wait {
                    condition: self.condition(signal, mask, pattern, false, &span, map)?,
                    within_s: within_ms * 1e-3,
                    error: keys.error.clone(),
                })
            }
            (None, None, Some(ms)) if ms.is_finite() && ms >= 0.0 => Ok(Step::Delay { seconds: ms * 1e-3 }),
            _ => Err(self.at(&span, "", "a step is one of { write, value }, { wait, mask, equals, within_ms } and { delay_ms }".to_owned())),
        }
    }
}

/// Why a command must not write this value: the bench gives references, a command only takes them back.
fn not_by_command(point: &SetPoint, value: f64) -> Option<String> {
    if point.is_word() || value == 0.0 {
        return None;
    }
    let (name, unit) = (&point.name, point.numbers.unit.name());
    let value_text = format!("{value} {unit}");
    let value_text = value_text.trim_end();
    if point.quantity.moves() {
        return Some(format!(
            "value {value_text} would move the motor: {name} is a {} (expected 0; a value is in the setpoint's unit, not raw)",
            point.quantity.name()
        ));
    }
    let [low, high] = point.limits?;
    let low = if point.sign.is_some() { -high } else { low };
    (!(low..=high).contains(&value)).then(|| {
        format!("value {value_text} is outside of the limits of {name} (expected {low} to {high} {unit}, not raw)")
    })
}

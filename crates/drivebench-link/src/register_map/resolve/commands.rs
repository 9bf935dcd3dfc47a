//! Identity checks, states and the steps of commands: what refers to signals and set-points by name.

use std::collections::BTreeMap;

use toml::Spanned;

use super::super::facts::{
    Beyond, Condition, IdentityCheck, IdentityTest, RegisterMap, SetPoint, Step, Write,
};
use super::super::schema::{ConditionKeys, IdentityKeys, StepKeys};
use super::super::terms::PollRate;
use super::{Checked, Part, Reader};

impl Reader<'_> {
    pub(super) fn identity(
        &self,
        spanned: &Spanned<IdentityKeys>,
        map: &RegisterMap,
    ) -> Checked<IdentityCheck> {
        let keys = spanned.get_ref();
        let part = self.part(spanned.span(), "");
        match (&keys.signal, keys.object, &keys.contains) {
            (None, Some(object), Some(contains)) if map.functions.contains(&43) => {
                Ok(IdentityCheck::Object {
                    object,
                    contains: contains.clone(),
                })
            }
            (Some(signal), None, None) => {
                let names = map.signals.iter().map(|s| s.name.as_str());
                self.known(signal, names, "signal", &part.span)?;
                let test = match (keys.equals, &keys.one_of, keys.within) {
                    (Some(pattern), None, None) => IdentityTest::OneOf(vec![pattern]),
                    (None, Some(patterns), None) => IdentityTest::OneOf(patterns.clone()),
                    (None, None, Some(range)) => IdentityTest::Within(range),
                    _ => return Err(part.wrong("signal", "expected one of equals, one_of and within")),
                };
                Ok(IdentityCheck::Signal {
                    signal: signal.clone(),
                    mask: keys.mask.unwrap_or(u32::MAX),
                    test,
                })
            }
            _ => Err(part.wrong("", "an identity check has a signal with equals, one_of or within; or, with function code 43, an object and contains")),
        }
    }

    pub(super) fn state(
        &self,
        spanned: &Spanned<ConditionKeys>,
        map: &RegisterMap,
    ) -> Checked<Result<Condition, String>> {
        let keys = spanned.get_ref();
        let part = self.part(spanned.span(), "");
        if let Some(reason) = &keys.none {
            return Ok(Err(reason.clone()));
        }
        let (Some(signal), Some(mask)) = (&keys.signal, keys.mask) else {
            let message = "a state has signal, mask and equals (or not_equals), or none = \"why\"";
            return Err(part.wrong("", message));
        };
        let (pattern, negated) = match (keys.equals, keys.not_equals) {
            (Some(pattern), None) => (pattern, false),
            (None, Some(pattern)) => (pattern, true),
            _ => return Err(part.wrong("mask", "expected one of equals and not_equals")),
        };
        let or = match (&keys.or, keys.beyond, &keys.of) {
            (None, None, None) => None,
            (Some(signal), Some(share), Some(of)) => Some(beyond(&part, map, signal, share, of)?),
            _ => return Err(part.wrong("", "or, beyond and of belong together")),
        };
        let bits = condition(&part, map, signal, (mask, pattern), negated)?;
        Ok(Ok(Condition { or, ..bits }))
    }

    pub(super) fn fault_codes(
        &self,
        texts: &BTreeMap<String, String>,
    ) -> Checked<BTreeMap<u16, String>> {
        let number = |text: &str| match text.strip_prefix("0x") {
            Some(digits) => u16::from_str_radix(digits, 16),
            None => text.parse(),
        };
        let codes = texts.iter().map(|(code, text)| {
            let code = number(code).map_err(|_| {
                let message =
                    format!("{code:?} is no fault code (expected 0 to 65535, or 0x0000 to 0xffff)");
                self.at(&self.from("[fault_codes"), code, message)
            })?;
            Ok((code, text.clone()))
        });
        codes.collect()
    }

    pub(super) fn steps(
        &self,
        steps: &[Spanned<StepKeys>],
        map: &RegisterMap,
    ) -> Checked<Vec<Step>> {
        steps.iter().map(|step| self.step(step, map)).collect()
    }

    /// The steps of a command that may be empty, but not be forgotten.
    pub(super) fn declared(
        &self,
        name: &str,
        steps: Option<&[Spanned<StepKeys>]>,
        map: &RegisterMap,
    ) -> Checked<Vec<Step>> {
        let steps = steps.ok_or_else(|| {
            let why = match name {
                "coast" => "it is tried where stop fails",
                _ => "without it no fault can be cleared over the bus",
            };
            self.whole(
                "[commands]",
                format!("the command {name} is missing: {why} (expected its steps; or {name} = [] if the drive has none)"),
            )
        })?;
        self.steps(steps, map)
    }

    pub(super) fn step(&self, spanned: &Spanned<StepKeys>, map: &RegisterMap) -> Checked<Step> {
        let keys = spanned.get_ref();
        let part = self.part(spanned.span(), "");
        match (&keys.write, &keys.wait, keys.delay_ms) {
            (Some(name), None, None) => {
                let names = map.set_points.iter().map(|p| p.name.as_str());
                self.known(name, names, "setpoint", &part.span)?;
                let point = map.set_point(name).filter(|point| point.name == *name);
                let value = keys.value.ok_or_else(|| part.wrong("write", "value is missing"))?;
                let fits = point.is_none_or(|point| {
                    let raw = point.numbers.raw(value, 1.0);
                    !point.numbers.scale_by.is_empty() || point.location.layout.encode(raw).is_some()
                });
                let message = format_args!("value {value} does not fit the type of {name}");
                part.require(fits, "value", message)?;
                part.of("value", point.map_or(Ok(()), |point| by_command(point, value)))?;
                let mask = keys.mask.map(u16::try_from).transpose();
                let mask =
                    mask.map_err(|_| part.wrong("mask", "a mask for writing has 16 bits"))?;
                let set_point = name.clone();
                Ok(Step::Write(Write { set_point, value, mask }))
            }
            (None, Some(signal), None) => {
                let (Some(mask), Some(pattern), Some(within_ms)) =
                    (keys.mask, keys.equals, keys.within_ms)
                else { return Err(part.wrong("wait", "a wait has mask, equals and within_ms")) };
                let holds = within_ms.is_finite() && within_ms > 0.0;
                let message = format_args!("within_ms {within_ms} is not allowed (expected more than 0)");
                part.require(holds, "within_ms", message)?;
                Ok(Step::Wait {
                    condition: condition(&part, map, signal, (mask, pattern), false)?,
                    within_s: within_ms * 1e-3,
                    error: keys.error.clone(),
                })
            }
            (None, None, Some(ms)) if ms.is_finite() && ms >= 0.0 => {
                Ok(Step::Delay { seconds: ms * 1e-3 })
            }
            _ => Err(part.wrong("", "a step is one of { write, value }, { wait, mask, equals, within_ms } and { delay_ms }")),
        }
    }
}

/// A test of the bits of a signal that is read in every cycle.
fn condition(
    part: &Part<'_>,
    map: &RegisterMap,
    signal: &str,
    (mask, pattern): (u32, u32),
    negated: bool,
) -> Checked<Condition> {
    let fast = map.signals.iter().filter(|s| s.keys.poll == PollRate::Fast);
    let fast = fast.map(|signal| signal.name.as_str());
    part.reader.known(signal, fast, "signal with poll = \"fast\"", &part.span)?;
    let holds = pattern & !mask == 0;
    let message =
        format_args!("{pattern:#06x} has bits outside of the mask {mask:#06x}: it can never hold");
    part.require(holds, "mask", message)?;
    Ok(Condition {
        signal: signal.to_owned(),
        mask,
        pattern,
        negated,
        or: None,
        line: part.reader.line(&part.span),
    })
}

/// A test of a value that is read in every cycle against a share of another one.
fn beyond(
    part: &Part<'_>,
    map: &RegisterMap,
    signal: &str,
    share: f64,
    of: &str,
) -> Checked<Beyond> {
    let fast = map.signals.iter().filter(|s| s.keys.poll == PollRate::Fast);
    let fast = fast.map(|signal| signal.name.as_str());
    part.reader.known(signal, fast, "signal with poll = \"fast\"", &part.span)?;
    let names = map.signals.iter().map(|signal| signal.name.as_str());
    part.reader.known(of, names, "signal", &part.span)?;
    let unit = |name| map.signal(name).map(|signal| signal.numbers.unit);
    let is_share = unit(signal) == unit(of) && share > 0.0 && share < 1.0;
    let message =
        "beyond is no share of it (expected more than 0, less than 1, and two signals of one unit)";
    part.require(is_share, "beyond", format_args!("{message}"))?;
    Ok(Beyond { signal: signal.to_owned(), of: of.to_owned(), share })
}

/// Why a command must not write this value: the bench gives references, a command only takes them back.
fn by_command(point: &SetPoint, value: f64) -> Result<(), String> {
    if point.is_word() || value == 0.0 {
        return Ok(());
    }
    let (name, unit) = (&point.name, point.numbers.unit.name());
    let value_text = format!("{value} {unit}");
    let value_text = value_text.trim_end();
    let quantity = point.keys.quantity;
    if quantity.moves() {
        return Err(format!(
            "value {value_text} would move the motor: {name} is a {} (expected 0; a value is in the setpoint's unit, not raw)",
            quantity.name()
        ));
    }
    match point.range() {
        Some([low, high]) if !(low..=high).contains(&value) => Err(format!(
            "value {value_text} is outside of the limits of {name} (expected {low} to {high} {unit}, not raw)"
        )),
        _ => Ok(()),
    }
}

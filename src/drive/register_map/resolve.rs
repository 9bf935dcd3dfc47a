//! From the keys of a profile file to the map: addresses, names and limits, each error at its line.

use std::collections::BTreeMap;
use std::ops::Range;

use toml::Spanned;

use super::address::{Base, Formula, Written, resolve};
use super::facts::{
    Commands, Condition, DeviceKind, IdentityCheck, IdentityTest, Location, Numbers, PollRate,
    Quantity, RegisterMap, SetPoint, Sign, Signal, Step, Supervision, Traits, channel_of, demand_si,
};
use super::schema::{
    ConditionKeys, IdentityKeys, ProfileFile, SetPointKeys, SignalKeys, StepKeys, WatchdogKeys,
};
use super::value::Layout;
use crate::config_text::{self, ConfigError, help_for_unknown};
use crate::drive::RegisterTable;
use crate::drive::profile::{
    Capabilities, DriveLimits, DriveProfile, LinkSettings, SignalOrigins, SignalSides, Watchdog,
};
use crate::sample::Channel;
use crate::units::rad_s_from_rpm;

const HELP: &str = "see docs/adding-a-drive.md for every key, its unit and its default";
/// The schema that this program reads.
const SCHEMA: u32 = 1;

/// Reads the file; `file` names it in errors.
pub(super) fn read(file: &str, text: &str) -> Result<(RegisterMap, DriveProfile), ConfigError> {
    let keys: ProfileFile = config_text::parse(file, text)?;
    let reader = Reader {
        file,
        text,
        base: Base::Zero,
        formula: None,
        functions: Vec::new(),
    };
    reader.map(&keys)
}

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
    base: Base,
    formula: Option<Formula>,
    functions: Vec<u8>,
}

impl Reader<'_> {
    fn map(mut self, file: &ProfileFile) -> Result<(RegisterMap, DriveProfile), ConfigError> {
        self.link(file)?;
        let mut signals = Vec::new();
        for (name, keys) in &file.signals {
            signals.push(self.signal(name, keys)?);
        }
        let mut set_points = Vec::new();
        for (name, keys) in &file.setpoints {
            set_points.push(self.set_point(name, keys)?);
        }
        let link = file.link.get_ref();
        let mut map = RegisterMap {
            device: file.device.clone(),
            converter: file.converter.as_ref().map(|c| *c.get_ref()),
            functions: link.functions.clone(),
            max_read: link.max_read,
            max_write: link.max_write,
            max_hole: link.max_hole,
            exact_reads: Vec::new(),
            resync: link.resync,
            nvm_cycles: link.nvm_cycles,
            identity: Vec::new(),
            signals,
            missing: BTreeMap::new(),
            set_points,
            commands: Commands::default(),
            state: BTreeMap::new(),
            untold: BTreeMap::new(),
            watchdog: self.watchdog(&file.watchdog)?,
            field_min_a: file.limits.field_min_a,
            rates: *file.rates.get_ref(),
        };
        for (first, count) in &link.exact_reads {
            let written = Written {
                address: Some(*first),
                parameter: None,
                can: None,
            };
            let found = resolve(written, self.base, self.formula)
                .map_err(|reason| self.at(&file.link.span(), "exact_reads", reason))?;
            map.exact_reads.push((found.address, *count));
        }
        self.roles(file, &mut map)?;
        self.cross_check(file, &map)?;
        for check in &file.identity {
            map.identity.push(self.identity(check, &map)?);
        }
        for (name, condition) in &file.state {
            self.known(name, RegisterMap::STATES, "state", &condition.span())?;
            match self.state(condition, &map)? {
                Ok(condition) => drop(map.state.insert(name.clone(), condition)),
                Err(reason) => drop(map.untold.insert(name.clone(), reason)),
            }
        }
        for name in ["fault", "running"] {
            if !map.state.contains_key(name) && !map.untold.contains_key(name) {
                return Err(self.whole(
                    "[state",
                    format!("the state {name} is neither mapped nor declared untold (expected a condition, or none = \"why\")"),
                ));
            }
        }
        map.commands = Commands {
            enable: self.steps(&file.commands.enable, &map)?,
            stop: self.steps(&file.commands.stop, &map)?,
            coast: self.steps(&file.commands.coast, &map)?,
            reset: self.steps(&file.commands.reset, &map)?,
            quickstop: self.steps(&file.commands.quickstop, &map)?,
        };
        let profile = profile_of(file, &map);
        profile
            .check()
            .map_err(|error| self.at(&file.link.span(), "", error.to_string()))?;
        Ok((map, profile))
    }

    fn link(&mut self, file: &ProfileFile) -> Result<(), ConfigError> {
        let schema = *file.schema.get_ref();
        if schema != SCHEMA {
            let text = format!("schema {schema} is not allowed (expected {SCHEMA})");
            return Err(self.at(&file.schema.span(), "", text));
        }
        let link = file.link.get_ref();
        let wrong = |key: &str, message: String| Err(self.at(&file.link.span(), key, message));
        let Some(base) = link.address_base.base() else {
            return wrong(
                "address_base",
                "this address_base is not allowed (expected 0, 1 or \"4x1\")".to_owned(),
            );
        };
        for function in &link.functions {
            if ![1, 2, 3, 4, 5, 6, 8, 11, 15, 16, 22, 23, 43].contains(function) {
                return wrong(
                    "functions",
                    format!("function code {function} is not one of Modbus"),
                );
            }
        }
        if !link.functions.iter().any(|function| matches!(function, 3 | 4)) {
            return wrong("functions", "neither 3 nor 4 is there: nothing can be read".to_owned());
        }
        for (key, value, most) in [
            ("max_read", link.max_read, 125),
            ("max_write", link.max_write, 123),
        ] {
            if !(1..=most).contains(&value) {
                return wrong(key, format!("{key} {value} is not allowed (expected 1 to {most})"));
            }
        }
        let (fc08, tcp) = (
            link.functions.contains(&8),
            link.protocol == crate::drive::Protocol::ModbusTcp,
        );
        match link.resync {
            super::Resync::Fc08 if !fc08 => {
                return wrong("resync", "resync \"fc08\" needs function code 8 in functions".to_owned());
            }
            super::Resync::Tid if !tcp => {
                return wrong("resync", "resync \"tid\" needs protocol \"modbus-tcp\"".to_owned());
            }
            super::Resync::Length if link.max_read < 2 => {
                return wrong("resync", "resync \"length\" needs max_read 2 or more: reads of one length are all alike".to_owned());
            }
            _ => {}
        }
        if link.protocol == crate::drive::Protocol::Stream {
            return wrong("protocol", "a register map is not spoken over \"stream\" (expected modbus-rtu or modbus-tcp)".to_owned());
        }
        self.base = base;
        self.formula = link.address_formula;
        self.functions.clone_from(&link.functions);
        Ok(())
    }

    fn signal(&self, name: &str, spanned: &Spanned<SignalKeys>) -> Result<Signal, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let wrong = |key: &str, message: String| self.at(&span, key, format!("signal {name}: {message}"));
        let found = resolve(keys.written(), self.base, self.formula).map_err(|r| wrong("address", r))?;
        let usual = if self.functions.contains(&3) { 3 } else { 4 };
        let function = match (keys.function, found.is_input) {
            (Some(function), _) => function,
            (None, Some(true)) => 4,
            (None, Some(false)) => 3,
            (None, None) => usual,
        };
        let table = match function {
            3 => RegisterTable::Holding,
            4 => RegisterTable::Input,
            _ => return Err(wrong("function", format!("function {function} is not allowed (expected 3 or 4)"))),
        };
        self.knows(function).map_err(|r| wrong("function", r))?;
        let bits = match &keys.bits {
            None => None,
            Some(text) => Some(
                bit_range(text, 16 * keys.kind.registers())
                    .ok_or_else(|| wrong("bits", format!("bits {text:?} is not allowed (expected \"FIRST..LAST\" within the type)")))?,
            ),
        };
        if let Some(valid) = keys.valid
            && valid[0].partial_cmp(&valid[1]) != Some(std::cmp::Ordering::Less)
        {
            return Err(wrong("valid", format!("valid {valid:?} is not allowed (expected [lowest, highest])")));
        }
        let channel = channel_of(keys.quantity, keys.unit, keys.pole_pairs);
        if channel.is_some() && keys.origin.is_none() {
            return Err(wrong("quantity", "origin is missing (expected measured, estimated or commanded)".to_owned()));
        }
        Ok(Signal {
            name: name.to_owned(),
            location: Location {
                table,
                address: found.address,
                layout: Layout {
                    kind: keys.kind,
                    words: keys.word_order,
                    bytes: keys.byte_order,
                    byte: keys.byte,
                    bits,
                },
            },
            numbers: self.numbers(keys.scale, keys.offset, &keys.scale_by, keys.unit, |m| wrong("scale", m))?,
            quantity: keys.quantity,
            poll: keys.poll,
            valid: keys.valid,
            invalid: keys.invalid.clone(),
            traits: Traits {
                origin: keys.origin,
                signed: keys.signed.unwrap_or_else(|| keys.kind.is_signed()),
                filter_ms: keys.filter_ms,
                update_ms: keys.update_ms,
                basis: keys.basis,
                side: keys.side,
                trust: keys.trust,
                note: keys.note.clone(),
            },
            channel,
        })
    }

    fn numbers(
        &self,
        scale: Option<f64>,
        offset: Option<f64>,
        scale_by: &[String],
        unit: super::Unit,
        wrong: impl Fn(String) -> ConfigError,
    ) -> Result<Numbers, ConfigError> {
        let (scale, offset) = (scale.unwrap_or(1.0), offset.unwrap_or(0.0));
        if !(scale.is_finite() && scale != 0.0 && offset.is_finite()) {
            return Err(wrong(format!("scale {scale}, offset {offset} is not allowed (expected finite numbers, scale other than 0)")));
        }
        Ok(Numbers {
            scale,
            offset,
            scale_by: scale_by.to_vec(),
            unit,
        })
    }

    fn set_point(&self, name: &str, spanned: &Spanned<SetPointKeys>) -> Result<SetPoint, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let wrong = |key: &str, message: String| self.at(&span, key, format!("setpoint {name}: {message}"));
        let found = resolve(keys.written(), self.base, self.formula).map_err(|r| wrong("address", r))?;
        if found.is_input == Some(true) {
            return Err(wrong("address", "an input register cannot be written".to_owned()));
        }
        let registers = keys.kind.registers();
        let single = registers == 1 && self.functions.contains(&6);
        let function = keys.function.unwrap_or(if single { 6 } else { 16 });
        if !matches!(function, 6 | 16) || (function == 6 && registers > 1) {
            return Err(wrong("function", format!("function {function} is not allowed (expected 6 for one register, or 16)")));
        }
        self.knows(function).map_err(|r| wrong("function", r))?;
        let layout = Layout {
            words: keys.word_order,
            bytes: keys.byte_order,
            ..Layout::plain(keys.kind)
        };
        let numbers = self.numbers(keys.scale, keys.offset, &keys.scale_by, keys.unit, |m| wrong("scale", m))?;
        if let Some(limits) = keys.limits {
            let ordered = limits[0].is_finite() && limits[1].is_finite() && limits[0] < limits[1];
            // With a factor from the drive this can only be known when the factor is.
            let fits = !numbers.scale_by.is_empty()
                || limits
                    .iter()
                    .all(|limit| layout.encode(numbers.raw(*limit, 1.0)).is_some());
            if !(ordered && fits) {
                return Err(wrong("limits", format!("limits {limits:?} is not allowed (expected [lowest, highest] that the raw type holds)")));
            }
        }
        for (key, value) in [("refresh_ms", keys.refresh_ms), ("slew_per_s", keys.slew_per_s)] {
            if value.is_some_and(|value| !(value.is_finite() && value > 0.0)) {
                return Err(wrong(key, format!("{key} is not allowed (expected more than 0)")));
            }
        }
        if keys.nvm && keys.refresh_ms.is_some() {
            return Err(wrong("refresh_ms", "a register in non-volatile memory must not be refreshed: each write wears it out".to_owned()));
        }
        if keys.quantity != Quantity::Word && keys.limits.is_none() {
            return Err(wrong("quantity", "limits are missing (expected [lowest, highest] in the setpoint's unit)".to_owned()));
        }
        Ok(SetPoint {
            name: name.to_owned(),
            location: Location {
                table: RegisterTable::Holding,
                address: found.address,
                layout,
            },
            function,
            si: demand_si(keys.quantity, keys.unit, keys.pole_pairs),
            numbers,
            quantity: keys.quantity,
            limits: keys.limits,
            slew_per_s: keys.slew_per_s,
            refresh_s: keys.refresh_ms.map(|ms| ms * 1e-3),
            readback: keys.readback,
            nvm: keys.nvm,
            stopped_only: keys.write_only_when.is_some(),
            sign: keys.sign.as_ref().map(|sign| Sign {
                set_point: sign.setpoint.clone(),
                mask: sign.mask,
            }),
            trust: keys.trust,
            note: keys.note.clone(),
        })
    }

    fn watchdog(&self, spanned: &Spanned<WatchdogKeys>) -> Result<Supervision, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let wrong = |key: &str, message: String| self.at(&span, key, format!("watchdog: {message}"));
        let time = match &keys.time {
            None => None,
            Some(time) => {
                let found = resolve(time.written(), self.base, self.formula).map_err(|r| wrong("time", r))?;
                let location = Location {
                    table: RegisterTable::Holding,
                    address: found.address,
                    layout: Layout::plain(super::Kind::U16),
                };
                Some((location, time.unit_ms * 1e-3))
            }
        };
        if keys.set_ms.is_some() && (time.is_none() || keys.nvm) {
            return Err(wrong("set_ms", "set_ms needs a time register outside of non-volatile memory".to_owned()));
        }
        let times = [keys.default_ms, keys.set_ms, Some(keys.boot_delay_s)];
        if times.into_iter().flatten().any(|time| !(time.is_finite() && time >= 0.0)) {
            return Err(wrong("default_ms", "times must be 0 or more".to_owned()));
        }
        let s = |ms: f64| ms * 1e-3;
        Ok(Supervision {
            kind: keys.kind,
            kicked_by: keys.kicked_by,
            default_s: keys.default_ms.map(s),
            on_expire: keys.on_expire,
            auto_resume: keys.auto_resume,
            nvm: keys.nvm,
            time,
            set_s: keys.set_ms.map(s),
            boot_delay_s: keys.boot_delay_s,
            proof: keys.proof.clone(),
            note: keys.note.clone(),
        })
    }

    /// Every required channel is mapped or declared missing, and none twice.
    fn roles(&self, file: &ProfileFile, map: &mut RegisterMap) -> Result<(), ConfigError> {
        for (key, reason) in &file.missing {
            self.known(key, Channel::ALL.map(Channel::key), "channel", &reason.span())?;
            map.missing.insert(key.clone(), reason.get_ref().clone());
        }
        for channel in Channel::ALL {
            let mut fill = map.signals.iter().filter(|s| s.channel.is_some_and(|(has, _)| has == channel));
            let (first, second) = (fill.next(), fill.next());
            let key = channel.key();
            if let (Some(first), Some(second)) = (first, second) {
                let message = format!("signals {} and {} are both {key} (expected one)", first.name, second.name);
                return Err(self.at(&file.signals[&second.name].span(), "", message));
            }
            match (first, file.missing.get(key)) {
                (Some(signal), Some(reason)) => {
                    let message = format!("{key} is declared missing, and the signal {} is it", signal.name);
                    return Err(self.at(&reason.span(), "", message));
                }
                (None, None) if RegisterMap::REQUIRED.contains(&channel) => {
                    return Err(self.whole(
                        "[signals",
                        format!("{key} is neither mapped nor declared missing (expected a signal, or {key} = \"why\" in [missing])"),
                    ));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Names that lead from one part to another, and lengths against the drive's limits.
    fn cross_check(&self, file: &ProfileFile, map: &RegisterMap) -> Result<(), ConfigError> {
        let once: Vec<&str> = map
            .signals
            .iter()
            .filter(|signal| signal.poll == PollRate::Once)
            .map(|signal| signal.name.as_str())
            .collect();
        for signal in &map.signals {
            let span = file.signals[&signal.name].span();
            for factor in &signal.numbers.scale_by {
                self.known(factor, once.iter().copied(), "signal with poll = \"once\"", &span)?;
            }
            let registers = signal.location.layout.registers();
            if registers > map.max_read {
                let message = format!("signal {} has {registers} registers, and max_read is {}", signal.name, map.max_read);
                return Err(self.at(&span, "type", message));
            }
        }
        for point in &map.set_points {
            let span = file.setpoints[&point.name].span();
            for factor in &point.numbers.scale_by {
                self.known(factor, once.iter().copied(), "signal with poll = \"once\"", &span)?;
            }
            let registers = point.location.layout.registers();
            if registers > map.max_write {
                let message = format!("setpoint {} has {registers} registers, and max_write is {}", point.name, map.max_write);
                return Err(self.at(&span, "type", message));
            }
            if let Some(sign) = &point.sign {
                let words = map.set_points.iter().filter(|p| p.is_word()).map(|p| p.name.as_str());
                let words: Vec<&str> = words.collect();
                self.known(&sign.set_point, words.iter().copied(), "setpoint of quantity \"word\"", &span)?;
            }
        }
        let thyristor = map.device.kind == DeviceKind::ThyristorDc;
        if thyristor != map.converter.is_some() {
            let message = "a drive of kind \"thyristor_dc\", and no other, needs [converter] with dead_time_ms and quadrants";
            return Err(self.whole("[device]", message.to_owned()));
        }
        if let (Some(converter), Some(spanned)) = (map.converter, &file.converter) {
            if ![1, 2, 4].contains(&converter.quadrants) {
                let message = format!("quadrants {} is not allowed (expected 1, 2 or 4)", converter.quadrants);
                return Err(self.at(&spanned.span(), "quadrants", message));
            }
            if map.of_quantity(Quantity::FieldCurrent).is_none() {
                return Err(self.at(&spanned.span(), "", "a thyristor drive needs a signal of quantity \"field_current\": a lost field is a trip".to_owned()));
            }
        }
        let rates = map.rates;
        if !(rates.fast_hz > 0.0 && rates.slow_hz > 0.0 && rates.slow_hz <= rates.fast_hz) {
            return Err(self.at(&file.rates.span(), "fast_hz", "rates must be above 0, and slow_hz at most fast_hz".to_owned()));
        }
        Ok(())
    }

    fn identity(&self, spanned: &Spanned<IdentityKeys>, map: &RegisterMap) -> Result<IdentityCheck, ConfigError> {
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

    fn state(&self, spanned: &Spanned<ConditionKeys>, map: &RegisterMap) -> Result<Result<Condition, String>, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        if let Some(reason) = &keys.none {
            return Ok(Err(reason.clone()));
        }
        let (Some(signal), Some(mask)) = (&keys.signal, keys.mask) else {
            return Err(self.at(&span, "", "a state has signal, mask and equals (or not_equals), or none = \"why\"".to_owned()));
        };
        let (pattern, negated) = match (keys.equals, keys.not_equals) {
            (Some(pattern), None) => (pattern, false),
            (None, Some(pattern)) => (pattern, true),
            _ => return Err(self.at(&span, "mask", "expected one of equals and not_equals".to_owned())),
        };
        self.condition(signal, mask, pattern, negated, &span, map).map(Ok)
    }

    fn condition(
        &self,
        signal: &str,
        mask: u32,
        pattern: u32,
        negated: bool,
        span: &Range<usize>,
        map: &RegisterMap,
    ) -> Result<Condition, ConfigError> {
        let fast = map.signals.iter().filter(|signal| signal.poll == PollRate::Fast);
        let fast: Vec<&str> = fast.map(|signal| signal.name.as_str()).collect();
        self.known(signal, fast.iter().copied(), "signal with poll = \"fast\"", span)?;
        if pattern & !mask != 0 {
            let message = format!("{pattern:#06x} has bits outside of the mask {mask:#06x}: it can never hold");
            return Err(self.at(span, "mask", message));
        }
        Ok(Condition {
            signal: signal.to_owned(),
            mask,
            pattern,
            negated,
        })
    }

    fn steps(&self, steps: &[Spanned<StepKeys>], map: &RegisterMap) -> Result<Vec<Step>, ConfigError> {
        steps.iter().map(|step| self.step(step, map)).collect()
    }

    fn step(&self, spanned: &Spanned<StepKeys>, map: &RegisterMap) -> Result<Step, ConfigError> {
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

    fn knows(&self, function: u8) -> Result<(), String> {
        if self.functions.contains(&function) {
            Ok(())
        } else {
            Err(format!("the drive does not know function code {function} (link.functions has {:?})", self.functions))
        }
    }

    /// An error that names the nearest, unless `name` is one of `allowed`.
    fn known<'b>(
        &self,
        name: &str,
        allowed: impl IntoIterator<Item = &'b str> + Clone,
        what: &str,
        span: &Range<usize>,
    ) -> Result<(), ConfigError> {
        if allowed.clone().into_iter().any(|known| known == name) {
            return Ok(());
        }
        let offset = self.text[span.start..].find(name).map_or(span.start, |at| span.start + at);
        let message = format!("{name:?} is no {what} of this profile");
        Err(ConfigError::at(self.file, self.text, offset, message, help_for_unknown(name, allowed)))
    }

    /// An error at a key of a part; at the part where the key is not there.
    fn at(&self, span: &Range<usize>, key: &str, message: String) -> ConfigError {
        let tail = &self.text[span.start..];
        let offset = tail
            .match_indices(key)
            .find(|(at, _)| {
                !key.is_empty()
                    && tail[at + key.len()..].trim_start().starts_with('=')
                    && !tail[..*at].ends_with(|c: char| c.is_alphanumeric() || c == '_')
            })
            .map_or(span.start, |(at, _)| span.start + at);
        ConfigError::at(self.file, self.text, offset, message, HELP)
    }

    /// An error at the first place of a header.
    fn whole(&self, header: &str, message: String) -> ConfigError {
        let offset = self.text.find(header).unwrap_or(0);
        ConfigError::at(self.file, self.text, offset, message, HELP)
    }
}

/// `"3..5"` within `width` bits.
fn bit_range(text: &str, width: u16) -> Option<(u8, u8)> {
    let (first, last) = text.split_once("..")?;
    let (first, last) = (first.parse::<u8>().ok()?, last.parse::<u8>().ok()?);
    (first <= last && u16::from(last) < width).then_some((first, last))
}

/// What the bench sees of it.
fn profile_of(file: &ProfileFile, map: &RegisterMap) -> DriveProfile {
    let link = file.link.get_ref();
    let origin = |channel| map.of_channel(channel).and_then(|signal| signal.traits.origin);
    let side = |channel| map.of_channel(channel).and_then(|signal| signal.traits.side);
    let able = |quantity| map.demand(quantity).is_some();
    DriveProfile {
        name: map.device.id.clone(),
        source: map.device.source.clone(),
        trust: map.device.trust,
        link: LinkSettings {
            protocol: link.protocol,
            baud: link.baud,
            unit: link.unit,
            framing: link.framing,
            reply_ms: link.reply_ms,
            gap_us: link.gap_us,
            deadline_ms: link.deadline_ms,
        },
        capabilities: Capabilities {
            voltage_command: able(Quantity::Voltage),
            current_command: able(Quantity::Current),
            speed_command: able(Quantity::Speed),
        },
        signals: SignalOrigins {
            voltage_cmd_v: None,
            voltage_v: origin(Channel::Voltage),
            current_a: origin(Channel::Current),
            speed_rad_s: origin(Channel::Speed),
            angle_rad: origin(Channel::Angle),
            torque_n_m: origin(Channel::Torque),
            bus_v: origin(Channel::Bus),
            temperature_c: origin(Channel::Temperature),
        },
        sides: SignalSides {
            voltage_v: side(Channel::Voltage),
            current_a: side(Channel::Current),
        },
        watchdog: Watchdog {
            kicked_by: map.watchdog.kicked_by,
            default_ms: map.watchdog.default_s.map(|s| s * 1e3),
        },
        limits: DriveLimits {
            current_a: file.limits.current_a,
            voltage_v: file.limits.voltage_v,
            speed_rad_s: file.limits.speed_rpm.map(rad_s_from_rpm),
        },
        registers: None,
    }
}

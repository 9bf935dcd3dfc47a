//! Signals, set-points and the watchdog, each on its own.

use toml::Spanned;

use super::super::address::resolve;
use super::super::facts::{
    Location, Numbers, PerTurn, PollRate, Quantity, SetPoint, Sign, Signal, Supervision, Traits,
    Unit, channel_of, demand_si,
};
use super::super::schema::{SetPointKeys, SignalKeys, WatchdogKeys, WatchdogTime};
use super::super::value::{Kind, Layout};
use super::Reader;
use crate::config_text::ConfigError;
use crate::drive::RegisterTable;

impl Reader<'_> {
    pub(super) fn signal(
        &self,
        name: &str,
        spanned: &Spanned<SignalKeys>,
    ) -> Result<Signal, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let wrong =
            |key: &str, message: String| self.at(&span, key, format!("signal {name}: {message}"));
        if let Some(reason) = keys.quantity.not_read() {
            return Err(wrong("quantity", reason));
        }
        if let Some((key, reason)) = keys.quantity.misfit(keys.unit) {
            return Err(wrong(key, reason));
        }
        let found =
            resolve(keys.written(), self.base, self.formula).map_err(|r| wrong("address", r))?;
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
            _ => {
                return Err(wrong(
                    "function",
                    format!("function {function} is not allowed (expected 3 or 4)"),
                ));
            }
        };
        self.knows(function).map_err(|r| wrong("function", r))?;
        let bits = match &keys.bits {
            None => None,
            Some(text) => Some(bit_range(text, 16 * keys.kind.registers()).ok_or_else(|| {
                wrong(
                    "bits",
                    format!(
                        "bits {text:?} is not allowed (expected \"FIRST..LAST\" within the type)"
                    ),
                )
            })?),
        };
        if let Some(valid) = keys.valid
            && valid[0].partial_cmp(&valid[1]) != Some(std::cmp::Ordering::Less)
        {
            return Err(wrong(
                "valid",
                format!("valid {valid:?} is not allowed (expected [lowest, highest])"),
            ));
        }
        let per_turn = self
            .per_turn(keys.unit, keys.pole_pairs, keys.counts_per_turn)
            .map_err(|(key, message)| wrong(key, message))?;
        let channel = channel_of(keys.quantity, keys.unit, per_turn);
        if channel.is_some() && keys.origin.is_none() {
            return Err(wrong(
                "quantity",
                "origin is missing (expected measured, estimated or commanded)".to_owned(),
            ));
        }
        let layout = Layout {
            kind: keys.kind,
            words: keys.word_order,
            bytes: keys.byte_order,
            byte: keys.byte,
            bits,
        };
        if keys.quantity == Quantity::Clock {
            clock_fits(keys, layout).map_err(|(key, message)| wrong(key, message))?;
        }
        let wraps_at = wraps_at(keys, layout).map_err(|m| wrong("wraps_at", m))?;
        Ok(Signal {
            name: name.to_owned(),
            line: self.line(&span),
            location: Location {
                table,
                address: found.address,
                layout,
            },
            numbers: Self::numbers(keys.scale, keys.offset, &keys.scale_by, keys.unit, |m| {
                wrong("scale", m)
            })?,
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
                pole_pairs: keys.pole_pairs,
                trust: keys.trust,
                note: keys.note.clone(),
            },
            channel,
            wraps_at,
        })
    }

    /// What a shaft's turn is in the unit; the encoder may be that of the device.
    fn per_turn(
        &self,
        unit: Unit,
        pole_pairs: Option<u8>,
        counts: Option<u32>,
    ) -> Result<PerTurn, (&'static str, String)> {
        if counts.is_some() && !unit.is_counts() {
            let message = format!(
                "counts_per_turn does not fit unit \"{}\" (expected \"counts\" or \"counts/s\")",
                unit.name()
            );
            return Err(("counts_per_turn", message));
        }
        let counts = counts.or(self.counts_per_turn);
        match counts {
            None if unit.is_counts() => Err((
                "unit",
                format!(
                    "unit \"{}\" needs counts_per_turn, here or in [device] (expected the edges that are counted in one turn: four times the lines of an incremental encoder)",
                    unit.name()
                ),
            )),
            Some(0) => Err((
                "counts_per_turn",
                "counts_per_turn 0 is not allowed (expected 1 or more)".to_owned(),
            )),
            counts => Ok(PerTurn { pole_pairs, counts }),
        }
    }

    pub(super) fn numbers(
        scale: Option<f64>,
        offset: Option<f64>,
        scale_by: &[String],
        unit: Unit,
        wrong: impl Fn(String) -> ConfigError,
    ) -> Result<Numbers, ConfigError> {
        let (scale, offset) = (scale.unwrap_or(1.0), offset.unwrap_or(0.0));
        if !(scale.is_finite() && scale != 0.0 && offset.is_finite()) {
            return Err(wrong(format!(
                "scale {scale}, offset {offset} is not allowed (expected finite numbers, scale other than 0)"
            )));
        }
        Ok(Numbers {
            scale,
            offset,
            scale_by: scale_by.to_vec(),
            unit,
        })
    }

    pub(super) fn set_point(
        &self,
        name: &str,
        spanned: &Spanned<SetPointKeys>,
    ) -> Result<SetPoint, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let wrong =
            |key: &str, message: String| self.at(&span, key, format!("setpoint {name}: {message}"));
        if let Some(reason) = keys.quantity.not_written() {
            return Err(wrong("quantity", reason));
        }
        if let Some((key, reason)) = keys.quantity.misfit(keys.unit) {
            return Err(wrong(key, reason));
        }
        let per_turn = self
            .per_turn(keys.unit, keys.pole_pairs, keys.counts_per_turn)
            .map_err(|(key, message)| wrong(key, message))?;
        let found =
            resolve(keys.written(), self.base, self.formula).map_err(|r| wrong("address", r))?;
        if found.is_input == Some(true) {
            return Err(wrong(
                "address",
                "an input register cannot be written".to_owned(),
            ));
        }
        let registers = keys.kind.registers();
        let single = registers == 1 && self.functions.contains(&6);
        let function = keys.function.unwrap_or(if single { 6 } else { 16 });
        if !matches!(function, 6 | 16) || (function == 6 && registers > 1) {
            return Err(wrong(
                "function",
                format!("function {function} is not allowed (expected 6 for one register, or 16)"),
            ));
        }
        self.knows(function).map_err(|r| wrong("function", r))?;
        let layout = Layout {
            words: keys.word_order,
            bytes: keys.byte_order,
            ..Layout::plain(keys.kind)
        };
        let numbers = Self::numbers(keys.scale, keys.offset, &keys.scale_by, keys.unit, |m| {
            wrong("scale", m)
        })?;
        if let Some(limits) = keys.limits {
            // With a factor from the drive this can only be known when the factor is.
            let fits = |limit| {
                let raw = numbers.raw(limit, 1.0);
                !numbers.scale_by.is_empty() || layout.encode(raw).is_some()
            };
            check_limits(limits, keys.quantity, fits).map_err(|text| wrong("limits", text))?;
        }
        for (key, value) in [
            ("refresh_ms", keys.refresh_ms),
            ("slew_per_s", keys.slew_per_s),
        ] {
            if value.is_some_and(|value| !(value.is_finite() && value > 0.0)) {
                return Err(wrong(
                    key,
                    format!("{key} is not allowed (expected more than 0)"),
                ));
            }
        }
        if keys.nvm && keys.refresh_ms.is_some() {
            return Err(wrong(
                "refresh_ms",
                "a register in non-volatile memory must not be refreshed: each write wears it out"
                    .to_owned(),
            ));
        }
        if keys.quantity != Quantity::Word && keys.limits.is_none() {
            return Err(wrong(
                "quantity",
                "limits are missing (expected [lowest, highest] in the setpoint's unit)".to_owned(),
            ));
        }
        Ok(SetPoint {
            name: name.to_owned(),
            line: self.line(&span),
            location: Location {
                table: RegisterTable::Holding,
                address: found.address,
                layout,
            },
            function,
            si: demand_si(keys.quantity, keys.unit, per_turn),
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

    pub(super) fn watchdog(
        &self,
        spanned: &Spanned<WatchdogKeys>,
    ) -> Result<Supervision, ConfigError> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let wrong =
            |key: &str, message: String| self.at(&span, key, format!("watchdog: {message}"));
        let time = match &keys.time {
            None => None,
            Some(time) => {
                let found = resolve(time.written(), self.base, self.formula)
                    .map_err(|r| wrong("time", r))?;
                if !(time.unit_ms.is_finite() && time.unit_ms > 0.0) {
                    let message = format!(
                        "unit_ms {} is not allowed (expected more than 0)",
                        time.unit_ms
                    );
                    return Err(wrong("time", message));
                }
                let location = Location {
                    table: RegisterTable::Holding,
                    address: found.address,
                    layout: Layout::plain(Kind::U16),
                };
                if let Some(set_ms) = keys.set_ms {
                    time_fits(set_ms, time, location.layout).map_err(|r| wrong("set_ms", r))?;
                }
                Some((location, time.unit_ms * 1e-3))
            }
        };
        if keys.set_ms.is_some() && (time.is_none() || keys.nvm) {
            return Err(wrong(
                "set_ms",
                "set_ms needs a time register outside of non-volatile memory".to_owned(),
            ));
        }
        let times = [keys.default_ms, keys.set_ms, Some(keys.boot_delay_s)];
        if times
            .into_iter()
            .flatten()
            .any(|time| !(time.is_finite() && time >= 0.0))
        {
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
}

/// Shortest time in which a clock may come round, s: from one look to the next it must be known how often it did, also where
/// a reply was lost.
const SHORTEST_TURN_S: f64 = 2.0;

/// Whether a counter can be the time axis of the samples.
fn clock_fits(keys: &SignalKeys, layout: Layout) -> Result<(), (&'static str, String)> {
    if !matches!(keys.kind, Kind::U16 | Kind::U32) || keys.byte.is_some() || keys.bits.is_some() {
        return Err((
            "type",
            "a clock is a whole counter (expected type u16 or u32 without byte and bits)"
                .to_owned(),
        ));
    }
    if keys.poll != PollRate::Fast {
        return Err((
            "poll",
            "a clock stamps every sample (expected poll = \"fast\")".to_owned(),
        ));
    }
    for (key, is_there) in [
        ("valid", keys.valid.is_some()),
        ("invalid", !keys.invalid.is_empty()),
        ("scale_by", !keys.scale_by.is_empty()),
        ("offset", keys.offset.is_some()),
    ] {
        if is_there {
            return Err((
                key,
                format!("a clock has no {key}: each of its counts is a time"),
            ));
        }
    }
    let unit_s = match keys.unit {
        Unit::Microsecond => 1e-6,
        Unit::Millisecond => 1e-3,
        _ => 1.0,
    };
    let count_s = keys.scale.unwrap_or(1.0) * unit_s;
    let turn_s = count_s * 2.0_f64.powi(i32::from(layout.width()));
    if turn_s.is_nan() || turn_s < SHORTEST_TURN_S {
        return Err((
            "type",
            format!(
                "a clock of {} bits that counts {count_s} s comes round every {turn_s:.3} s (expected {SHORTEST_TURN_S} s or more: how often it did so between two readings would not be known)",
                layout.width()
            ),
        ));
    }
    Ok(())
}

/// Raw counts after which a position begins again.
fn wraps_at(keys: &SignalKeys, layout: Layout) -> Result<Option<f64>, String> {
    let is_position = keys.quantity == Quantity::Angle && keys.unit == Unit::Counts;
    let whole = keys.kind != Kind::F32;
    match keys.wraps_at {
        None => Ok((is_position && whole).then(|| 2.0_f64.powi(i32::from(layout.width())))),
        Some(_) if !is_position => Err(
            "wraps_at is for a position (expected quantity \"angle\", unit \"counts\")".to_owned(),
        ),
        Some(counts) if counts < 2 => Err(format!(
            "wraps_at {counts} is not allowed (expected 2 or more)"
        )),
        Some(counts) => Ok(Some(f64::from(counts))),
    }
}

/// Whether the register of the watchdog's time takes this one, ms.
fn time_fits(set_ms: f64, time: &WatchdogTime, layout: Layout) -> Result<(), String> {
    let [low, high] = time
        .range_ms
        .unwrap_or([time.unit_ms, f64::from(u16::MAX) * time.unit_ms]);
    let fits = layout.encode(set_ms / time.unit_ms).is_some() && set_ms > 0.0;
    if fits && (low..=high).contains(&set_ms) {
        return Ok(());
    }
    Err(format!(
        "set_ms {set_ms} is not allowed (expected {low} to {high}, which the register takes in steps of {} ms)",
        time.unit_ms
    ))
}

/// `"3..5"` within `width` bits.
fn bit_range(text: &str, width: u16) -> Option<(u8, u8)> {
    let (first, last) = text.split_once("..")?;
    let (first, last) = (first.parse::<u8>().ok()?, last.parse::<u8>().ok()?);
    (first <= last && u16::from(last) < width).then_some((first, last))
}

/// The range of a set-point. A drive is brought to rest with zero, which must not become something else on its way out.
fn check_limits(
    [low, high]: [f64; 2],
    quantity: Quantity,
    fits: impl Fn(f64) -> bool,
) -> Result<(), String> {
    let ordered = low.is_finite() && high.is_finite() && low < high;
    let moves = !matches!(quantity, Quantity::Word | Quantity::Other);
    let rests = !moves || (low <= 0.0 && high > 0.0);
    if ordered && rests && fits(low) && fits(high) {
        return Ok(());
    }
    Err(format!(
        "limits [{low:?}, {high:?}] is not allowed (expected [lowest, highest] that the raw type holds, 0 within for what moves the motor)"
    ))
}

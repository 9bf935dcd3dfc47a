//! From the keys of a profile file to the map: addresses, names and limits, each error at its line.
//!
//! ```text
//! keys -> link, then parts.rs (signals, set-points, watchdog) -> roles and references -> commands.rs -> profile.rs
//! ```

mod commands;
mod parts;
mod profile;

use std::collections::BTreeMap;
use std::ops::Range;

use self::profile::profile_of;
use super::address::{Base, Formula, Written, resolve};
use super::facts::{Commands, DeviceKind, PollRate, Quantity, RegisterMap, Signal, Unit};
use super::schema::ProfileFile;
use crate::config_text::{self, ConfigError, help_for_unknown};
use crate::drive::profile::DriveProfile;
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
        counts_per_turn: keys.device.counts_per_turn,
    };
    reader.map(&keys)
}

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
    base: Base,
    formula: Option<Formula>,
    functions: Vec<u8>,
    /// Of the device's encoder.
    counts_per_turn: Option<u32>,
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
            fault_codes: self.fault_codes(&file.fault_codes)?,
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
            self.known(name, RegisterMap::STATES, "state", &self.part("[state"))?;
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
            coast: self.declared("coast", file.commands.coast.as_deref(), &map)?,
            reset: self.declared("reset", file.commands.reset.as_deref(), &map)?,
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
        if !link
            .functions
            .iter()
            .any(|function| matches!(function, 3 | 4))
        {
            return wrong(
                "functions",
                "neither 3 nor 4 is there: nothing can be read".to_owned(),
            );
        }
        for (key, value, most) in [
            ("max_read", link.max_read, 125),
            ("max_write", link.max_write, 123),
        ] {
            if !(1..=most).contains(&value) {
                return wrong(
                    key,
                    format!("{key} {value} is not allowed (expected 1 to {most})"),
                );
            }
        }
        let (fc08, tcp) = (
            link.functions.contains(&8),
            link.protocol == crate::drive::Protocol::ModbusTcp,
        );
        match link.resync {
            super::Resync::Fc08 if !fc08 => {
                return wrong(
                    "resync",
                    "resync \"fc08\" needs function code 8 in functions".to_owned(),
                );
            }
            super::Resync::Tid if !tcp => {
                return wrong(
                    "resync",
                    "resync \"tid\" needs protocol \"modbus-tcp\"".to_owned(),
                );
            }
            super::Resync::Length if link.max_read < 2 => {
                return wrong(
                    "resync",
                    "resync \"length\" needs max_read 2 or more: reads of one length are all alike"
                        .to_owned(),
                );
            }
            _ => {}
        }
        if link.protocol == crate::drive::Protocol::Stream {
            return wrong(
                "protocol",
                "a register map is not spoken over \"stream\" (expected modbus-rtu or modbus-tcp)"
                    .to_owned(),
            );
        }
        self.base = base;
        self.formula = link.address_formula;
        self.functions.clone_from(&link.functions);
        Ok(())
    }

    /// Every required channel is mapped or declared missing, and none twice.
    fn roles(&self, file: &ProfileFile, map: &mut RegisterMap) -> Result<(), ConfigError> {
        for (key, reason) in &file.missing {
            self.known(
                key,
                Channel::ALL.map(Channel::key),
                "channel",
                &self.part("[missing"),
            )?;
            map.missing.insert(key.clone(), reason.get_ref().clone());
        }
        for channel in Channel::ALL {
            let mut fill = map
                .signals
                .iter()
                .filter(|s| s.channel.is_some_and(|(has, _)| has == channel));
            let (first, second) = (fill.next(), fill.next());
            let key = channel.key();
            if let (Some(first), Some(second)) = (first, second) {
                let message = format!(
                    "signals {} and {} are both {key} (expected one)",
                    first.name, second.name
                );
                return Err(self.at(&file.signals[&second.name].span(), "", message));
            }
            match (first, file.missing.get(key)) {
                (Some(signal), Some(reason)) => {
                    let message = format!(
                        "{key} is declared missing, and the signal {} is it",
                        signal.name
                    );
                    return Err(self.at(&reason.span(), "", message));
                }
                (None, None) if RegisterMap::REQUIRED.contains(&channel) => {
                    if let Some(error) = self.no_channel(file, key, map) {
                        return Err(error);
                    }
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

    /// A signal of the right quantity whose unit does not lead to the channel.
    fn no_channel(&self, file: &ProfileFile, key: &str, map: &RegisterMap) -> Option<ConfigError> {
        let would_be = |signal: &&Signal| match signal.quantity {
            Quantity::Current => key == Channel::Current.key(),
            Quantity::Voltage => key == Channel::Voltage.key(),
            Quantity::ShaftSpeed | Quantity::OutputSpeed => key == Channel::Speed.key(),
            _ => false,
        };
        let signal = map.signals.iter().find(would_be)?;
        let (unit, expected) = match signal.numbers.unit {
            Unit::Hertz => (
                "Hz without pole_pairs",
                "pole_pairs of the motor, for an electrical frequency",
            ),
            unit => (unit.name(), "a scale to an SI unit or rpm"),
        };
        let message = format!(
            "signal {}: in {unit} it is no {key}, which is neither mapped nor declared missing (expected {expected}; or {key} = \"why\" in [missing])",
            signal.name
        );
        Some(self.at(&file.signals[&signal.name].span(), "unit", message))
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
                self.known(
                    factor,
                    once.iter().copied(),
                    "signal with poll = \"once\"",
                    &span,
                )?;
            }
            let registers = signal.location.layout.registers();
            if registers > map.max_read {
                let message = format!(
                    "signal {} has {registers} registers, and max_read is {}",
                    signal.name, map.max_read
                );
                return Err(self.at(&span, "type", message));
            }
        }
        for point in &map.set_points {
            let span = file.setpoints[&point.name].span();
            for factor in &point.numbers.scale_by {
                self.known(
                    factor,
                    once.iter().copied(),
                    "signal with poll = \"once\"",
                    &span,
                )?;
            }
            let registers = point.location.layout.registers();
            if registers > map.max_write {
                let message = format!(
                    "setpoint {} has {registers} registers, and max_write is {}",
                    point.name, map.max_write
                );
                return Err(self.at(&span, "type", message));
            }
            if let Some(sign) = &point.sign {
                let words = map
                    .set_points
                    .iter()
                    .filter(|p| p.is_word())
                    .map(|p| p.name.as_str());
                let words: Vec<&str> = words.collect();
                self.known(
                    &sign.set_point,
                    words.iter().copied(),
                    "setpoint of quantity \"word\"",
                    &span,
                )?;
            }
        }
        let mut clocks = map.signals.iter().filter(|s| s.quantity == Quantity::Clock);
        if let (Some(first), Some(second)) = (clocks.next(), clocks.next()) {
            let message = format!(
                "signals {} and {} are both clocks (expected one)",
                first.name, second.name
            );
            return Err(self.at(&file.signals[&second.name].span(), "quantity", message));
        }
        self.position_is_followed(file, map)?;
        let thyristor = map.device.kind == DeviceKind::ThyristorDc;
        if thyristor != map.converter.is_some() {
            let message = "a drive of kind \"thyristor_dc\", and no other, needs [converter] with dead_time_ms and quadrants";
            return Err(self.whole("[device]", message.to_owned()));
        }
        if let (Some(converter), Some(spanned)) = (map.converter, &file.converter) {
            if ![1, 2, 4].contains(&converter.quadrants) {
                let message = format!(
                    "quadrants {} is not allowed (expected 1, 2 or 4)",
                    converter.quadrants
                );
                return Err(self.at(&spanned.span(), "quadrants", message));
            }
            if map.of_quantity(Quantity::FieldCurrent).is_none() {
                return Err(self.at(&spanned.span(), "", "a thyristor drive needs a signal of quantity \"field_current\": a lost field is a trip".to_owned()));
            }
        }
        let rates = map.rates;
        if !(rates.fast_hz > 0.0 && rates.slow_hz > 0.0 && rates.slow_hz <= rates.fast_hz) {
            return Err(self.at(
                &file.rates.span(),
                "fast_hz",
                "rates must be above 0, and slow_hz at most fast_hz".to_owned(),
            ));
        }
        Ok(())
    }

    /// A position that may go half of its way round between two readings cannot be followed without a speed.
    fn position_is_followed(
        &self,
        file: &ProfileFile,
        map: &RegisterMap,
    ) -> Result<(), ConfigError> {
        let Some(position) = map.of_channel(Channel::Angle) else {
            return Ok(());
        };
        let (Some(wraps_at), Some((_, count_rad)), Some(most_rpm), None) = (
            position.wraps_at,
            position.channel,
            file.limits.speed_rpm,
            map.of_channel(Channel::Speed),
        ) else {
            return Ok(());
        };
        let a_cycle_rad = rad_s_from_rpm(most_rpm) / map.rates.fast_hz;
        let half_way_rad = 0.5 * wraps_at * (count_rad * position.numbers.scale).abs();
        if a_cycle_rad < half_way_rad {
            return Ok(());
        }
        let message = format!(
            "signal {} begins again after {wraps_at} counts, and at limits.speed_rpm {most_rpm} the shaft turns by {:.0} % of that between two readings at {} Hz: which way cannot be told (expected less than 50 %, or a speed signal beside it)",
            position.name,
            50.0 * a_cycle_rad / half_way_rad,
            map.rates.fast_hz
        );
        Err(self.at(&file.signals[&position.name].span(), "unit", message))
    }

    fn knows(&self, function: u8) -> Result<(), String> {
        if self.functions.contains(&function) {
            Ok(())
        } else {
            Err(format!(
                "the drive does not know function code {function} (link.functions has {:?})",
                self.functions
            ))
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
        let offset = self.text[span.start..]
            .find(name)
            .map_or(span.start, |at| span.start + at);
        let message = format!("{name:?} is no {what} of this profile");
        Err(ConfigError::at(
            self.file,
            self.text,
            offset,
            message,
            help_for_unknown(name, allowed),
        ))
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

    /// The line in which a part begins, from 1.
    fn line(&self, span: &Range<usize>) -> usize {
        1 + self.text[..span.start].matches('\n').count()
    }

    /// The text from a header on.
    fn part(&self, header: &str) -> Range<usize> {
        self.text.find(header).unwrap_or(0)..self.text.len()
    }

    /// An error at the first place of a header.
    fn whole(&self, header: &str, message: String) -> ConfigError {
        let offset = self.text.find(header).unwrap_or(0);
        ConfigError::at(self.file, self.text, offset, message, HELP)
    }
}

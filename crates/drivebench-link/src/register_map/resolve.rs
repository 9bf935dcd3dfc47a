//! From the keys of a profile file to the map: addresses, names and limits, each error at its line.
//!
//! ```text
//! keys -> link -> signals, set-points, watchdog, each on its own -> roles and references -> commands.rs
//! ```

mod commands;
mod place;

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::ops::Range;
use std::sync::Arc;

use toml::Spanned;

use self::place::{Places, Requests, set_point_line, signal_line};
use super::address::{Base, Numbering};
use super::facts::{
    Commands, Formula, Location, Numbers, PerTurn, RegisterMap, SetPoint, Signal, Supervision,
    channel_of, demand_si,
};
use super::schema::{
    DerivedKeys, LinkKeys, ProfileFile, SetPointKeys, SignalKeys, WatchdogKeys, WatchdogTime,
    WholeDerived,
};
use super::terms::{DeviceKind, PollRate, Quantity, Unit};
use super::value::{CellSize, Kind, Layout};
use crate::cell_bus::CellTable;
use crate::framing::{Grammar, Line};
use crate::settings::{DriveLimits, LinkSettings, Protocol, check_ranges};
use drivebench_model::config_text::{self, ConfigError, help_for_unknown};
use drivebench_model::plant::effect::{Mistake, read_expression};
use drivebench_model::sample::Channel;
use drivebench_model::units::rad_s_from_rpm;

const HELP: &str = "see docs/drives.md for every key, its unit and its default";
const FUNCTIONS: [u8; 13] = [1, 2, 3, 4, 5, 6, 8, 11, 15, 16, 22, 23, 43];

/// What was read of a profile, or the first key or value that is not allowed.
type Checked<T> = Result<T, ConfigError>;

/// A profile, and what its file says of the link and of the drive's limits.
type WithSettings = (RegisterMap, LinkSettings, DriveLimits);

impl RegisterMap {
    /// Reads a profile file of this kind; `file` names it in errors.
    ///
    /// # Errors
    /// The first key or value that is not allowed, with its line.
    pub fn parse(file: &str, text: &str) -> Checked<Self> {
        Self::with_settings(file, text).map(|(map, ..)| map)
    }

    pub(crate) fn with_settings(file: &str, text: &str) -> Checked<WithSettings> {
        let keys: ProfileFile = config_text::parse(file, text)?;
        let reader = Reader {
            file,
            text,
            numbering: Numbering { base: Base::Zero, formula: None },
            link: keys.link.get_ref(),
            counts_per_turn: keys.device.counts_per_turn,
            lines: lines(&keys),
        };
        reader.map(&keys)
    }
}

/// Every line of the profile once, by what is sent and its answer.
fn lines(keys: &ProfileFile) -> Vec<(String, String)> {
    let signals = keys.signals.values().filter_map(|keys| signal_line(keys.get_ref()));
    let points = keys.setpoints.values().filter_map(|keys| set_point_line(keys.get_ref()));
    let all: BTreeSet<(String, String)> = signals.chain(points).collect();
    all.into_iter().collect()
}

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
    numbering: Numbering,
    link: &'a LinkKeys,
    counts_per_turn: Option<u32>,
    lines: Vec<(String, String)>,
}

/// A part of the file, for what is wrong in it.
struct Part<'a> {
    reader: &'a Reader<'a>,
    span: Range<usize>,
    /// What stands in front of each message: `signal speed: `.
    whose: String,
}

impl Part<'_> {
    fn wrong(&self, key: &str, message: impl Display) -> ConfigError {
        self.reader.at(&self.span, key, format!("{}{message}", self.whose))
    }

    fn require(&self, holds: bool, key: &str, message: impl Display) -> Checked<()> {
        if holds { Ok(()) } else { Err(self.wrong(key, message)) }
    }

    /// What went well, or the error at this key.
    fn of<T>(&self, key: &str, result: Result<T, String>) -> Checked<T> {
        result.map_err(|message| self.wrong(key, message))
    }

    /// The same where the key that is wrong comes with the reason.
    fn keyed<T>(&self, result: Result<T, (&'static str, String)>) -> Checked<T> {
        result.map_err(|(key, message)| self.wrong(key, message))
    }
}

impl Reader<'_> {
    fn map(mut self, file: &ProfileFile) -> Checked<WithSettings> {
        let requests = self.check_link(file)?;
        let mut signals = file
            .signals
            .iter()
            .map(|(name, keys)| self.signal(name, keys))
            .collect::<Result<Vec<_>, _>>()?;
        let derived = file.derived.iter().map(|(name, keys)| self.derived(name, keys, &signals));
        signals.extend(derived.collect::<Result<Vec<_>, _>>()?);
        let points = file.setpoints.iter().map(|(name, keys)| self.set_point(name, keys));
        let set_points = points.collect::<Result<_, _>>()?;
        let link = self.link;
        let mut map = RegisterMap {
            device: file.device.clone(),
            converter: file.converter.as_ref().map(|c| *c.get_ref()),
            protocol: link.protocol,
            lines: self.grammar(file)?,
            functions: link.functions.clone(),
            max_read: requests.max_read,
            max_write: requests.max_write,
            max_hole: link.max_hole,
            exact_reads: Vec::new(),
            resync: requests.resync,
            nvm_cycles: link.nvm_cycles,
            identity: Vec::new(),
            signals,
            missing: BTreeMap::new(),
            set_points,
            commands: Commands::default(),
            state: BTreeMap::new(),
            unmapped_states: BTreeMap::new(),
            fault_codes: self.fault_codes(&file.fault_codes)?,
            watchdog: self.watchdog(&file.watchdog)?,
            field_min_a: file.limits.field_min_a,
            rates: *file.rates.get_ref(),
        };
        let part = self.part(file.link.span(), "");
        for (first, count) in &link.exact_reads {
            let (address, _) = part.of("exact_reads", self.numbering.number(*first))?;
            map.exact_reads.push((address, *count));
        }
        self.roles(file, &mut map)?;
        self.cross_check(file, &map)?;
        for check in &file.identity {
            map.identity.push(self.identity(check, &map)?);
        }
        for (name, condition) in &file.state {
            self.known(name, RegisterMap::STATES, "state", &self.from("[state"))?;
            match self.state(condition, &map)? {
                Ok(condition) => drop(map.state.insert(name.clone(), condition)),
                Err(reason) => drop(map.unmapped_states.insert(name.clone(), reason)),
            }
        }
        for name in ["fault", "running"] {
            if !map.state.contains_key(name) && !map.unmapped_states.contains_key(name) {
                return Err(self.whole(
                    "[state",
                    format!("the state {name} is neither mapped nor declared untold (expected a condition, or none = \"why\")"),
                ));
            }
        }
        let commands = &file.commands;
        map.commands = Commands {
            enable: self.steps(&commands.enable, &map)?,
            stop: self.steps(&commands.stop, &map)?,
            coast: self.declared("coast", commands.coast.as_deref(), &map)?,
            reset: self.declared("reset", commands.reset.as_deref(), &map)?,
            quickstop: self.steps(&commands.quickstop, &map)?,
        };
        let settings = LinkSettings {
            protocol: link.protocol,
            baud: link.baud,
            unit: link.unit,
            framing: link.framing,
            reply_ms: link.reply_ms,
            gap_us: link.gap_us,
            deadline_ms: link.deadline_ms,
            emulated: false,
        };
        let limits = DriveLimits {
            current_a: file.limits.current_a,
            voltage_v: file.limits.voltage_v,
            speed_rad_s: file.limits.speed_rpm.map(rad_s_from_rpm),
        };
        let watchdog_ms = map.watchdog.keys.default_ms.filter(|ms| *ms > 0.0);
        check_ranges(&map.device.id, &settings, watchdog_ms, &limits)
            .map_err(|error| part.wrong("", error))?;
        Ok((map, settings, limits))
    }

    fn check_link(&mut self, file: &ProfileFile) -> Checked<Requests> {
        let schema = *file.schema.get_ref();
        let message = format_args!("schema {schema} is not allowed (expected 1)");
        self.part(file.schema.span(), "").require(schema == 1, "", message)?;
        let link = self.link;
        let part = self.part(file.link.span(), "");
        let holds = link.protocol != Protocol::Stream;
        let message = "a register map is not spoken over \"stream\" (expected modbus-rtu, modbus-tcp or modbus-rtu-over-tcp)";
        part.require(holds, "protocol", message)?;
        let requests = part.keyed(Requests::of(link))?;
        self.numbering = Numbering { base: requests.base, formula: link.address_formula };
        Ok(requests)
    }

    /// The language of lines, with the types of the numbers in them.
    fn grammar(&self, file: &ProfileFile) -> Checked<Option<Arc<Grammar>>> {
        let part = self.part(file.link.span(), "");
        let is_lines = self.link.protocol == Protocol::Lines;
        let message = "protocol \"lines\" needs [link.lines], and no other has one";
        part.require(is_lines == self.link.lines.is_some(), "protocol", message)?;
        let Some(keys) = &self.link.lines else { return Ok(None) };
        let line = |(send, answer): &(String, String)| {
            let set_points = file.setpoints.values().map(Spanned::get_ref);
            let mut set_points = set_points.filter(|keys| keys.request.as_ref() == Some(send));
            let set_point = set_points.next();
            let mut kinds = vec![Kind::F32; answer.matches("{}").count()];
            for keys in file.signals.values().map(Spanned::get_ref) {
                let is_of_it = signal_line(keys).as_ref() == Some(&(send.clone(), answer.clone()));
                if let Some(kind) =
                    kinds.get_mut(usize::from(keys.hole.unwrap_or(0))).filter(|_| is_of_it)
                {
                    *kind = keys.kind;
                }
            }
            kinds.splice(0..0, set_point.map(|keys| keys.kind));
            // As a drive prints its own floats.
            let digits = set_point.and_then(|keys| keys.digits).unwrap_or(6).into();
            Line { send: send.clone(), answer: answer.clone(), kinds, digits }
        };
        Ok(Some(Arc::new(Grammar {
            end: keys.end.clone().unwrap_or_else(|| "\n".to_owned()),
            checksum: keys.checksum,
            scratch: keys.scratch.clone(),
            ack: keys.ack.clone(),
            errors: keys.errors.clone(),
            cut_at: keys.cut_at,
            lines: self.lines.iter().map(line).collect(),
        })))
    }

    fn places(&self) -> Places<'_> {
        Places { link: self.link, numbering: self.numbering, lines: &self.lines }
    }

    fn signal(&self, name: &str, spanned: &Spanned<SignalKeys>) -> Checked<Signal> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let part = self.part(span.clone(), format!("signal {name}: "));
        part.of("quantity", keys.quantity.read())?;
        part.keyed(keys.quantity.given_in(keys.unit))?;
        let bits = keys.bits.as_deref().map(|text| {
            let width = if keys.byte.is_some() { 8 } else { 8 * keys.kind.bytes() };
            bit_range(text, width).ok_or_else(|| {
                format!("bits {text:?} is not allowed (expected \"FIRST..LAST\" within the type or the byte)")
            })
        });
        let bits = part.of("bits", bits.transpose())?;
        if let Some(valid @ [low, high]) = keys.valid {
            let holds = low < high;
            let message =
                format_args!("valid {valid:?} is not allowed (expected [lowest, highest])");
            part.require(holds, "valid", message)?;
        }
        let per_turn =
            part.keyed(self.per_turn(keys.unit, keys.pole_pairs, keys.counts_per_turn))?;
        let channel = channel_of(keys.quantity, keys.unit, per_turn);
        let holds = channel.is_none() || keys.origin.is_some();
        let message = "origin is missing (expected measured, estimated or commanded)";
        part.require(holds, "quantity", message)?;
        let layout = Layout {
            kind: keys.kind,
            cell: CellSize::Register,
            words: self.places().order(keys.word_order),
            bytes: self.places().order(keys.byte_order),
            byte: keys.byte,
            bits,
        };
        let location = part.keyed(self.places().signal(keys, layout))?;
        if keys.quantity == Quantity::Clock {
            part.keyed(clock_fits(keys, layout))?;
        }
        let wraps_at = part.of("wraps_at", wraps_at(keys, layout))?;
        let numbers = numbers(keys.scale, keys.offset, &keys.scale_by, keys.unit);
        Ok(Signal {
            name: name.to_owned(),
            line: self.line(&span),
            location,
            numbers: part.of("scale", numbers)?,
            channel,
            wraps_at,
            formula: None,
            keys: keys.clone(),
        })
    }

    /// A channel that is computed from signals, in SI.
    fn derived(
        &self,
        name: &str,
        spanned: &Spanned<DerivedKeys>,
        signals: &[Signal],
    ) -> Checked<Signal> {
        let whole = match spanned.get_ref() {
            DerivedKeys::Whole(whole) => whole.clone(),
            DerivedKeys::Expression(value) => {
                WholeDerived { value: value.clone(), ..WholeDerived::default() }
            }
        };
        let part = self.part(spanned.span(), format!("derived {name}: "));
        let (quantity, unit) = match Channel::from_key(name) {
            Some(Channel::Voltage) => (Quantity::Voltage, Unit::V),
            Some(Channel::Current) => (Quantity::Current, Unit::A),
            Some(Channel::Speed) => (Quantity::ShaftSpeed, Unit::RadS),
            Some(Channel::Angle) => (Quantity::Angle, Unit::Rad),
            Some(Channel::Torque) => (Quantity::Torque, Unit::NewtonMetre),
            Some(Channel::Bus) => (Quantity::BusVoltage, Unit::V),
            _ => {
                let message = "it cannot be derived (expected voltage_v, current_a, speed_rad_s, angle_rad, torque_n_m or bus_v)";
                return Err(part.wrong("", message));
            }
        };
        let used = RefCell::new(Vec::new());
        let position = |name: &str| {
            let names = signals.iter().map(|signal| signal.name.as_str());
            let known = signals.iter().position(|signal| signal.name == name);
            known.ok_or_else(|| help_for_unknown(name, names))
        };
        let names = |name: &str| {
            let index = position(name)?;
            let mut used = used.borrow_mut();
            Ok(used.iter().position(|known| *known == index).unwrap_or_else(|| {
                used.push(index);
                used.len() - 1
            }))
        };
        let tree = read_expression(&whole.value, &names);
        let wrong = |mistake: Mistake| format!("{}; {}", mistake.message, mistake.help);
        let tree = part.of("value", tree.map_err(wrong))?;
        let direction = whole.direction.as_deref().map(position).transpose();
        let direction = part.of("direction", direction)?;
        Ok(Signal {
            name: name.to_owned(),
            line: self.line(&spanned.span()),
            keys: SignalKeys::derived(quantity, unit, &whole),
            location: Location {
                table: CellTable::Computed,
                address: 0,
                layout: Layout::plain(Kind::F32),
            },
            numbers: part.of("value", numbers(None, None, &[], unit))?,
            channel: channel_of(quantity, unit, PerTurn::default()),
            wraps_at: None,
            formula: Some(Formula { tree, of: used.into_inner(), direction }),
        })
    }

    /// What a shaft's turn is in the unit; the encoder may be that of the device.
    fn per_turn(
        &self,
        unit: Unit,
        pole_pairs: Option<u8>,
        counts: Option<u32>,
    ) -> Result<PerTurn, (&'static str, String)> {
        let name = unit.name();
        if counts.is_some() && !unit.is_counts() {
            let message = format!(
                "counts_per_turn does not fit unit \"{name}\" (expected \"counts\" or \"counts/s\")"
            );
            return Err(("counts_per_turn", message));
        }
        match counts.or(self.counts_per_turn) {
            None if unit.is_counts() => Err((
                "unit",
                format!(
                    "unit \"{name}\" needs counts_per_turn, here or in [device] (expected the edges that are counted in one turn: four times the lines of an incremental encoder)"
                ),
            )),
            Some(0) => Err((
                "counts_per_turn",
                "counts_per_turn 0 is not allowed (expected 1 or more)".to_owned(),
            )),
            counts => Ok(PerTurn { pole_pairs, counts }),
        }
    }

    fn set_point(&self, name: &str, spanned: &Spanned<SetPointKeys>) -> Checked<SetPoint> {
        let (keys, span) = (spanned.get_ref(), spanned.span());
        let part = self.part(span.clone(), format!("setpoint {name}: "));
        part.of("quantity", keys.quantity.written())?;
        part.keyed(keys.quantity.given_in(keys.unit))?;
        let per_turn =
            part.keyed(self.per_turn(keys.unit, keys.pole_pairs, keys.counts_per_turn))?;
        let places = self.places();
        let orders = (places.order(keys.word_order), places.order(keys.byte_order));
        let layout = Layout { words: orders.0, bytes: orders.1, ..Layout::plain(keys.kind) };
        let (location, function) = part.keyed(places.set_point(keys, layout))?;
        let layout = location.layout;
        let numbers = numbers(keys.scale, keys.offset, &keys.scale_by, keys.unit);
        let numbers = part.of("scale", numbers)?;
        if let Some(limits) = keys.limits {
            // With a factor from the drive this can only be known when the factor is.
            let fits = |limit| {
                let raw = numbers.raw(limit, 1.0);
                !numbers.scale_by.is_empty() || layout.encode(raw).is_some()
            };
            part.of("limits", check_limits(limits, keys.quantity, fits))?;
        }
        for (key, value) in [
            ("refresh_ms", keys.refresh_ms),
            ("slew_per_s", keys.slew_per_s),
            ("ramp_per_s", keys.ramp_per_s),
            ("smallest", keys.smallest),
        ] {
            let is_allowed = value.is_none_or(|value| value.is_finite() && value > 0.0);
            let message = format_args!("{key} is not allowed (expected more than 0)");
            part.require(is_allowed, key, message)?;
        }
        let holds = keys.smallest.is_none() || keys.slew_per_s.is_none();
        let message = "with slew_per_s it is never left: a step of the slew may be smaller";
        part.require(holds, "smallest", message)?;
        let holds = !keys.nvm || keys.refresh_ms.is_none();
        let message =
            "a register in non-volatile memory must not be refreshed: each write wears it out";
        part.require(holds, "refresh_ms", message)?;
        let holds = keys.quantity == Quantity::Word || keys.limits.is_some();
        let message = "limits are missing (expected [lowest, highest] in the setpoint's unit)";
        part.require(holds, "quantity", message)?;
        Ok(SetPoint {
            name: name.to_owned(),
            line: self.line(&span),
            location,
            function,
            si: demand_si(keys.quantity, keys.unit, per_turn),
            numbers,
            keys: keys.clone(),
        })
    }

    fn watchdog(&self, spanned: &Spanned<WatchdogKeys>) -> Checked<Supervision> {
        let keys = spanned.get_ref();
        let part = self.part(spanned.span(), "watchdog: ");
        let mut found = None;
        if let Some(time) = &keys.time {
            let resolved = self.numbering.resolve(time.address, time.parameter.as_deref(), None);
            let (address, _) = part.of("time", resolved)?;
            let unit_ms = time.unit_ms;
            let holds = unit_ms.is_finite() && unit_ms > 0.0;
            let message = format_args!("unit_ms {unit_ms} is not allowed (expected more than 0)");
            part.require(holds, "time", message)?;
            let order = self.places().order(None);
            let layout = Layout::plain(time.kind.unwrap_or(Kind::U16));
            let layout = Layout { words: order, bytes: order, ..layout };
            let location = self.places().time(address, layout);
            if let Some(set_ms) = keys.set_ms {
                part.of("set_ms", time_fits(set_ms, time, location.layout))?;
            }
            found = Some((location, unit_ms * 1e-3));
        }
        let holds = keys.set_ms.is_none() || (found.is_some() && !keys.nvm);
        let message = "set_ms needs a time register outside of non-volatile memory";
        part.require(holds, "set_ms", message)?;
        let times = [keys.default_ms, keys.set_ms, Some(keys.boot_delay_s)];
        let mut times = times.into_iter().flatten();
        let are_times = times.all(|time| time.is_finite() && time >= 0.0);
        part.require(are_times, "default_ms", "times must be 0 or more")?;
        Ok(Supervision { keys: keys.clone(), time: found })
    }

    /// Every required channel is mapped or declared missing, and none twice.
    fn roles(&self, file: &ProfileFile, map: &mut RegisterMap) -> Checked<()> {
        for (key, reason) in &file.missing {
            let channels = Channel::ALL.map(Channel::key);
            self.known(key, channels, "channel", &self.from("[missing"))?;
            map.missing.insert(key.clone(), reason.get_ref().clone());
        }
        for channel in Channel::ALL {
            let is_it = |s: &&Signal| s.channel.is_some_and(|(has, _)| has == channel);
            let mut fill = map.signals.iter().filter(is_it);
            let (first, second) = (fill.next(), fill.next());
            let key = channel.key();
            if let (Some(first), Some(second)) = (first, second) {
                let names = (first.name.as_str(), second.name.as_str());
                return Err(self.twice(file, names, key, ""));
            }
            match (first, file.missing.get(key)) {
                (Some(signal), Some(reason)) => {
                    let name = &signal.name;
                    let message = format!("{key} is declared missing, and the signal {name} is it");
                    return Err(self.at(&reason.span(), "", message));
                }
                (None, None) if RegisterMap::REQUIRED.contains(&channel) => {
                    return Err(self.no_channel(file, key, map).unwrap_or_else(|| {
                        self.whole(
                            "[signals",
                            format!("{key} is neither mapped nor declared missing (expected a signal, or {key} = \"why\" in [missing])"),
                        )
                    }));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn twice(
        &self,
        file: &ProfileFile,
        (first, second): (&str, &str),
        what: &str,
        key: &str,
    ) -> ConfigError {
        let message = format!("signals {first} and {second} are both {what} (expected one)");
        self.at(&file.signals[second].span(), key, message)
    }

    /// A signal of the right quantity whose unit does not lead to the channel.
    fn no_channel(&self, file: &ProfileFile, key: &str, map: &RegisterMap) -> Option<ConfigError> {
        let would_be = |signal: &&Signal| match signal.keys.quantity {
            Quantity::Current => key == Channel::Current.key(),
            Quantity::Voltage => key == Channel::Voltage.key(),
            Quantity::ShaftSpeed | Quantity::OutputSpeed => key == Channel::Speed.key(),
            _ => false,
        };
        let signal = map.signals.iter().find(would_be)?;
        let (unit, expected) = match signal.numbers.unit {
            Unit::Hertz => {
                ("Hz without pole_pairs", "pole_pairs of the motor, for an electrical frequency")
            }
            unit => (unit.name(), "a scale to an SI unit or rpm"),
        };
        let message = format!(
            "signal {}: in {unit} it is no {key}, which is neither mapped nor declared missing (expected {expected}; or {key} = \"why\" in [missing])",
            signal.name
        );
        Some(self.at(&file.signals[&signal.name].span(), "unit", message))
    }

    /// Names that lead from one part to another, and lengths against the drive's limits.
    fn cross_check(&self, file: &ProfileFile, map: &RegisterMap) -> Checked<()> {
        let once = map.signals.iter().filter(|s| s.keys.poll == PollRate::Once);
        let once: Vec<&str> = once.map(|signal| signal.name.as_str()).collect();
        let fits = |kind, name: &str, numbers: &Numbers, location: &Location, (key, most), span| {
            for factor in &numbers.scale_by {
                let factors = once.iter().copied();
                let name = factor.strip_prefix('/').unwrap_or(factor);
                self.known(name, factors, "signal with poll = \"once\"", &span)?;
            }
            let registers = location.layout.cells();
            let message =
                format_args!("{kind} {name} has {registers} registers, and {key} is {most}");
            self.part(span, "").require(registers <= most, "type", message)
        };
        for Signal { name, numbers, location, keys, .. } in &map.signals {
            let Some(span) = file.signals.get(name).map(Spanned::span) else { continue };
            if let Some(by) = &keys.reply_by {
                let decides =
                    |s: &&Signal| s.keys.poll == PollRate::Once && s.keys.reply_by.is_none();
                let names: Vec<_> =
                    map.signals.iter().filter(decides).map(|s| s.name.as_str()).collect();
                let what = "signal with poll = \"once\" and a place of its own";
                self.known(&by.signal, names.iter().copied(), what, &span)?;
            }
            let most = ("max_read", map.max_read);
            fits("signal", name, numbers, location, most, span)?;
        }
        for SetPoint { name, numbers, location, keys, .. } in &map.set_points {
            let span = file.setpoints[name].span();
            let most = ("max_write", map.max_write);
            fits("setpoint", name, numbers, location, most, span.clone())?;
            if let Some(sign) = &keys.sign {
                let words = map.set_points.iter().filter(|p| p.is_word()).map(|p| p.name.as_str());
                self.known(&sign.set_point, words, "setpoint of quantity \"word\"", &span)?;
            }
        }
        let mut clocks = map.signals.iter().filter(|s| s.keys.quantity == Quantity::Clock);
        if let (Some(first), Some(second)) = (clocks.next(), clocks.next()) {
            return Err(self.twice(file, (&first.name, &second.name), "clocks", "quantity"));
        }
        self.position_is_followed(file, map)?;
        let thyristor = map.device.kind == DeviceKind::ThyristorDc;
        if thyristor != map.converter.is_some() {
            let message = "a drive of kind \"thyristor_dc\", and no other, needs [converter] with dead_time_ms and quadrants";
            return Err(self.whole("[device]", message.to_owned()));
        }
        let has_field = map.of_quantity(Quantity::FieldCurrent).is_some();
        if let Some(spanned) = &file.converter {
            let (part, quadrants) = (self.part(spanned.span(), ""), spanned.get_ref().quadrants);
            let holds = [1, 2, 4].contains(&quadrants);
            let message = format_args!("quadrants {quadrants} is not allowed (expected 1, 2 or 4)");
            part.require(holds, "quadrants", message)?;
            let message = "a thyristor drive needs a signal of quantity \"field_current\": a lost field is a trip";
            part.require(has_field, "", message)?;
            let dead_time_ms = spanned.get_ref().dead_time_ms;
            let holds = dead_time_ms.is_finite() && dead_time_ms >= 0.0;
            let message =
                format_args!("dead_time_ms {dead_time_ms} is not allowed (expected 0 or more)");
            part.require(holds, "dead_time_ms", message)?;
        }
        if let Some(least_a) = map.field_min_a {
            let part = self.part(self.from("[limits"), "");
            let holds = least_a.is_finite() && least_a > 0.0;
            let message =
                format_args!("field_min_a {least_a} is not allowed (expected more than 0)");
            part.require(holds, "field_min_a", message)?;
            let message = "field_min_a needs a signal of quantity \"field_current\": without one a loss of the field is not detected";
            part.require(has_field, "field_min_a", message)?;
        }
        let rates = map.rates;
        self.part(file.rates.span(), "").require(
            rates.fast_hz > 0.0 && rates.slow_hz > 0.0 && rates.slow_hz <= rates.fast_hz,
            "fast_hz",
            "rates must be above 0, and slow_hz at most fast_hz",
        )
    }

    /// A position that may go half of its way round between two readings cannot be followed without a speed.
    fn position_is_followed(&self, file: &ProfileFile, map: &RegisterMap) -> Checked<()> {
        let Some(position) = map.of_channel(Channel::Angle) else { return Ok(()) };
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
        self.part(file.signals[&position.name].span(), "").require(
            a_cycle_rad < half_way_rad,
            "unit",
            format_args!(
                "signal {} begins again after {wraps_at} counts, and at limits.speed_rpm {most_rpm} the shaft turns by {:.0} % of that between two readings at {} Hz: the direction is ambiguous (expected less than 50 %, or a speed signal in addition)",
                position.name,
                50.0 * a_cycle_rad / half_way_rad,
                map.rates.fast_hz
            ),
        )
    }

    fn part(&self, span: Range<usize>, whose: impl Into<String>) -> Part<'_> {
        let whose = whose.into();
        Part { reader: self, span, whose }
    }

    /// An error that names the nearest, unless `name` is one of `allowed`.
    fn known<'b>(
        &self,
        name: &str,
        allowed: impl IntoIterator<Item = &'b str> + Clone,
        what: &str,
        span: &Range<usize>,
    ) -> Checked<()> {
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

    /// The line in which a part begins, from 1.
    fn line(&self, span: &Range<usize>) -> usize {
        1 + self.text[..span.start].matches('\n').count()
    }

    /// The text from a header on.
    fn from(&self, header: &str) -> Range<usize> {
        self.text.find(header).unwrap_or(0)..self.text.len()
    }

    fn whole(&self, header: &str, message: String) -> ConfigError {
        let offset = self.from(header).start;
        ConfigError::at(self.file, self.text, offset, message, HELP)
    }
}

fn numbers(
    scale: Option<f64>,
    offset: Option<f64>,
    scale_by: &[String],
    unit: Unit,
) -> Result<Numbers, String> {
    let (scale, offset) = (scale.unwrap_or(1.0), offset.unwrap_or(0.0));
    if !(scale.is_finite() && scale != 0.0 && offset.is_finite()) {
        return Err(format!(
            "scale {scale}, offset {offset} is not allowed (expected finite numbers, scale other than 0)"
        ));
    }
    Ok(Numbers { scale, offset, scale_by: scale_by.to_vec(), unit })
}

/// Whether a counter can be the time axis of the samples.
fn clock_fits(keys: &SignalKeys, layout: Layout) -> Result<(), (&'static str, String)> {
    let is_whole = matches!(keys.kind, Kind::U16 | Kind::U32);
    if !is_whole || keys.byte.is_some() || keys.bits.is_some() {
        let message = "a clock is a whole counter (expected type u16 or u32 without byte and bits)";
        return Err(("type", message.to_owned()));
    }
    if keys.poll != PollRate::Fast {
        return Err(("poll", "a clock stamps every sample (expected poll = \"fast\")".to_owned()));
    }
    for (key, is_there) in [
        ("valid", keys.valid.is_some()),
        ("invalid", !keys.invalid.is_empty()),
        ("scale_by", !keys.scale_by.is_empty()),
        ("offset", keys.offset.is_some()),
    ] {
        if is_there {
            return Err((key, format!("a clock has no {key}: each of its counts is a time")));
        }
    }
    let count_s = keys.scale.unwrap_or(1.0) * keys.unit.seconds().unwrap_or(1.0);
    let counts = keys.wraps_at.map_or(2.0_f64.powi(i32::from(layout.width())), f64::from);
    let turn_s = count_s * counts;
    // Shorter than two readings with a lost reply between them, s: the number of wraps would be ambiguous.
    let shortest_s = 2.0;
    if turn_s.is_nan() || turn_s < shortest_s {
        return Err((
            "type",
            format!(
                "a clock of {} bits that counts {count_s} s comes round every {turn_s:.3} s (expected {shortest_s} s or more: how often it did so between two readings would not be known)",
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
        Some(counts) if keys.quantity == Quantity::Clock => {
            let holds = counts.is_power_of_two() && counts.ilog2() <= layout.width().into();
            holds.then_some(Some(f64::from(counts))).ok_or_else(|| {
                format!("wraps_at {counts} is not allowed for a clock (expected a power of two that its type holds)")
            })
        }
        Some(_) if !is_position => Err(
            "wraps_at is for a position (expected quantity \"angle\", unit \"counts\") or a clock"
                .to_owned(),
        ),
        Some(counts) if counts < 2 => {
            Err(format!("wraps_at {counts} is not allowed (expected 2 or more)"))
        }
        Some(counts) => Ok(Some(f64::from(counts))),
    }
}

fn time_fits(set_ms: f64, time: &WatchdogTime, layout: Layout) -> Result<(), String> {
    let unit_ms = time.unit_ms;
    let whole = [unit_ms, f64::from(u16::MAX) * unit_ms];
    let [low, high] = time.range_ms.unwrap_or(whole);
    let fits = layout.encode(set_ms / unit_ms).is_some() && set_ms > 0.0;
    if fits && (low..=high).contains(&set_ms) {
        return Ok(());
    }
    Err(format!(
        "set_ms {set_ms} is not allowed (expected {low} to {high}, which the register takes in steps of {unit_ms} ms)"
    ))
}

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
    let rests = !quantity.moves() || (low <= 0.0 && high > 0.0);
    if ordered && rests && fits(low) && fits(high) {
        return Ok(());
    }
    Err(format!(
        "limits [{low:?}, {high:?}] is not allowed (expected [lowest, highest] that the raw type holds, 0 within for what moves the motor)"
    ))
}

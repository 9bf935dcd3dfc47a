//! Candidates for each quantity of a map: single columns, and a duty times its supply.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::Confidence;
use super::known::{Factor, Known, Quantity};
use super::reading::{Reading, UnitFrom};
use crate::recording::Preview;
use drivebench_identify::sanity;
use drivebench_model::numerics::statistics::{extent, finite, largest_but_outliers};
use drivebench_model::sample::Channel;
use drivebench_model::text::number::shortest;

/// What may stand behind the `=` of one quantity.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub target: Channel,
    /// Factors of a product.
    pub columns: Vec<usize>,
    /// The column that has the sign which this one lacks.
    pub sign_of: Option<usize>,
    pub factor: f64,
    /// A factor with a number that the file does not contain.
    pub hole: Option<String>,
    pub unit_from: UnitFrom,
    pub rank: u8,
    pub confidence: Confidence,
    pub reasons: Vec<String>,
    pub doubts: Vec<String>,
    /// Words that tell one motor of the file from another.
    pub words: Vec<String>,
    /// In SI, but for a hole.
    pub values: Vec<f64>,
}

/// The rows that are looked at, and the numbers that the user knows.
pub(super) struct Table<'a> {
    pub preview: &'a Preview,
    pub rows: Vec<usize>,
    pub time_s: Vec<f64>,
    pub given: &'a BTreeMap<String, f64>,
}

#[derive(Default)]
pub(super) struct Sources {
    pub voltage: Vec<Source>,
    pub current: Vec<Source>,
    pub speed: Vec<Source>,
    pub angle: Vec<Source>,
    pub torque: Vec<Source>,
    /// Columns that have the direction of what the drive does, with the words of their headers.
    pub directions: Vec<(usize, Vec<String>)>,
    /// Columns that serve for nothing, and why.
    pub unused: Vec<(usize, String)>,
}

impl Table<'_> {
    /// A column at the rows that are looked at; a missing cell has the value before it.
    pub(super) fn values(&self, column: usize) -> Vec<f64> {
        let numbers = &self.preview.columns[column].numbers;
        let mut last = f64::NAN;
        let mut held = Vec::with_capacity(numbers.len());
        for number in numbers {
            last = if number.is_nan() { last } else { *number };
            held.push(last);
        }
        self.rows.iter().map(|row| held[*row]).collect()
    }

    fn header(&self, column: usize) -> &str {
        &self.preview.headers[column]
    }

    fn source(&self, target: Channel, reading: &Reading) -> Source {
        let (factor, hole) = self.resolved(&reading.factor);
        let mut reasons = vec![reading.reason.clone()];
        reasons.extend(reading.notes.iter().cloned());
        if reading.unit_from == UnitFrom::Stated && !reading.unit.is_empty() {
            reasons.push(format!("in {}", reading.unit));
        }
        let confidence = match (reading.unit_from, reading.is_named) {
            (UnitFrom::Stated, true) => Confidence::Sure,
            (UnitFrom::Open, _) => Confidence::Unsure,
            _ => Confidence::Likely,
        };
        let values = self.values(reading.column).iter().map(|value| value * factor).collect();
        Source {
            target,
            columns: vec![reading.column],
            sign_of: None,
            factor,
            hole,
            unit_from: reading.unit_from,
            rank: reading.rank,
            confidence,
            reasons,
            doubts: Vec::new(),
            words: reading.words.clone(),
            values,
        }
    }

    /// The factor, and the hole in it where its number is not given.
    pub(super) fn resolved(&self, factor: &Factor) -> (f64, Option<String>) {
        match factor {
            Factor::Known(factor) => (*factor, None),
            Factor::Hole(hole) => {
                filled(hole, self.given).map_or((1.0, Some(hole.clone())), |value| (value, None))
            }
        }
    }

    pub(super) fn sources(&self, readings: &[Reading]) -> Sources {
        let mut sources = Sources::default();
        let of = |quantity| readings.iter().filter(move |reading| reading.quantity == quantity);
        let duty = of(Quantity::Duty).min_by_key(|reading| reading.rank);
        let mut supplies: Vec<&Reading> = of(Quantity::SupplyVoltage).collect();
        for reading in of(Quantity::Voltage) {
            if sanity::is_of_a_supply(&self.values(reading.column)) {
                supplies.push(reading);
                sources.unused.push((reading.column, self.sags(reading.column)));
            } else {
                sources.voltage.push(self.source(Channel::Voltage, reading));
            }
        }
        for reading in of(Quantity::VoltageCommand) {
            sources.voltage.push(self.source(Channel::VoltageCmd, reading));
        }
        // A voltage at the input of the motor, and not that of a supply, has the name of one.
        for reading in of(Quantity::SupplyVoltage).filter(|_| duty.is_none()) {
            let values = finite(&self.values(reading.column));
            let (least, most) = extent(&values);
            if least < 0.5 * most && !sanity::is_of_a_supply(&values) {
                let mut source = self.source(Channel::Voltage, reading);
                source.rank += 1;
                source.confidence = Confidence::Unsure;
                source.doubts.push(
                    "its name is that of a supply, but it changes like that of a motor".into(),
                );
                sources.voltage.push(source);
            }
        }
        supplies.sort_by_key(|reading| reading.rank);
        sources.voltage.extend(duty.map(|duty| self.duty(duty, supplies.first().copied())));
        for reading in of(Quantity::Command) {
            let mut source = self.source(Channel::VoltageCmd, reading);
            (source.factor, source.hole) = self.resolved(&Factor::Hole("VOLTS_PER_COUNT".into()));
            source
                .doubts
                .push("a command of no quantity: only the drive's program has its unit".into());
            source.rank += 2;
            sources.voltage.push(source);
        }
        let commands = [
            Quantity::VoltageCommand,
            Quantity::Duty,
            Quantity::Command,
            Quantity::SpeedReference,
            Quantity::Voltage,
        ];
        let directions = commands.into_iter().flat_map(of);
        sources.directions = directions.map(|it| (it.column, it.words.clone())).collect();
        let plain = |quantity, channel| {
            of(quantity).map(move |reading| self.source(channel, reading)).collect::<Vec<_>>()
        };
        sources.current = plain(Quantity::Current, Channel::Current);
        sources.torque = plain(Quantity::Torque, Channel::Torque);
        sources.angle = plain(Quantity::Angle, Channel::Angle);
        sources.speed = plain(Quantity::Speed, Channel::Speed);
        for reading in of(Quantity::ElectricalSpeed) {
            sources.speed.push(self.electrical_speed(reading));
        }
        self.channels(readings, &mut sources);
        for list in
            [&mut sources.current, &mut sources.speed, &mut sources.angle, &mut sources.torque]
        {
            self.leave_out_constants(list, &mut sources.unused);
        }
        self.list_unused(readings, &mut sources);
        sources
    }

    /// A column that never changes gives way to another.
    fn leave_out_constants(&self, list: &mut Vec<Source>, unused: &mut Vec<(usize, String)>) {
        let changes = |source: &Source| {
            let (least, most) = extent(finite(&source.values));
            least < most
        };
        if list.iter().any(changes) {
            list.retain(|source| {
                let keeps = changes(source);
                if !keeps {
                    let column = source.columns[0];
                    unused.push((column, format!("{:?} never changes", self.header(column))));
                }
                keeps
            });
        }
    }

    fn sags(&self, column: usize) -> String {
        let (least, most) = extent(finite(&self.values(column)));
        format!(
            "{:?} stays between {} and {} V whatever the motor does: it is the voltage of the supply, not of the motor",
            self.header(column),
            shortest(least, 4),
            shortest(most, 4)
        )
    }

    /// The voltage that a bridge applies: a share of its supply.
    fn duty(&self, duty: &Reading, supply: Option<&Reading>) -> Source {
        let mut source = self.source(Channel::Voltage, duty);
        let most = largest_but_outliers(&source.values);
        source.reasons.push(format!("it reaches {}", shortest(most, 3)));
        let mut hole = None;
        if duty.unit_from != UnitFrom::Stated {
            if most > 105.0 {
                hole = Some("1/FULL_SCALE");
            } else if most > 1.05 {
                source.factor = 0.01;
                source.doubts.push("taken as per cent".into());
                source.confidence = source.confidence.max(Confidence::Unsure);
            }
        }
        let of_supply = match (supply, hole) {
            (Some(supply), _) => {
                source.columns.push(supply.column);
                source.reasons.push(format!(
                    "a bridge applies this share of its supply, {:?}",
                    self.header(supply.column)
                ));
                if let Factor::Known(factor) = supply.factor {
                    source.factor *= factor;
                }
                self.values(supply.column)
            }
            (None, hole_of_scale) => {
                hole = Some(hole_of_scale.map_or("SUPPLY_V", |_| "VOLTS_PER_COUNT"));
                vec![1.0; self.rows.len()]
            }
        };
        let known = hole.map(|hole| self.resolved(&Factor::Hole(hole.to_owned())));
        if let Some((factor, hole)) = known {
            source.factor *= factor;
            source.hole = hole;
        }
        let raw = self.values(duty.column);
        source.values =
            raw.iter().zip(of_supply).map(|(duty, supply)| duty * supply * source.factor).collect();
        source.rank += 1;
        source
    }

    /// The speed of the shaft is that of the field over the pole pairs.
    fn electrical_speed(&self, reading: &Reading) -> Source {
        let factor = match &reading.factor {
            Factor::Known(factor) => *factor,
            Factor::Hole(_) => 1.0,
        };
        let with_pairs = Factor::Hole(format!("{}/POLE_PAIRS", decimal(factor)));
        let mut source = self.source(Channel::Speed, reading);
        let raw = self.values(reading.column);
        (source.factor, source.hole) = self.resolved(&with_pairs);
        let scale = if source.hole.is_some() { factor } else { source.factor };
        source.values = raw.iter().map(|value| value * scale).collect();
        source.reasons.push("the shaft turns slower by the pole pairs".into());
        source.confidence = Confidence::Sure;
        source
    }

    /// Channels of an oscilloscope, and all columns where none has a name: each may be any quantity that its unit allows.
    fn channels(&self, readings: &[Reading], sources: &mut Sources) {
        let channels = readings.iter().filter(|reading| reading.quantity == Quantity::Channel);
        for reading in channels.cloned() {
            let by_unit = Known::get().unit(&reading.unit).map(|unit| unit.quantity);
            let header = self.header(reading.column).to_owned();
            let mut add = |target: Channel, quantity: Quantity| {
                let is_own_unit = by_unit == Some(quantity);
                let mut own = reading.clone();
                if by_unit == Some(Quantity::Voltage) && !is_own_unit {
                    let note = "a channel in V".to_owned();
                    own = Reading::of_sensor(reading.column, quantity, &header, note);
                }
                own.reason = format!("{header:?} is a channel");
                let mut source = self.source(target, &own);
                if by_unit.is_none() && target != Channel::Voltage {
                    source.doubts.push("no unit is written: taken as SI".into());
                }
                source.confidence = Confidence::Unsure;
                match target {
                    Channel::Voltage => sources.voltage.push(source),
                    Channel::Current => sources.current.push(source),
                    _ => sources.speed.push(source),
                }
            };
            match by_unit {
                Some(Quantity::Current) => add(Channel::Current, Quantity::Current),
                Some(Quantity::Speed) => add(Channel::Speed, Quantity::Speed),
                _ => {
                    add(Channel::Voltage, Quantity::Voltage);
                    add(Channel::Current, Quantity::Current);
                    add(Channel::Speed, Quantity::Speed);
                }
            }
        }
    }

    /// Gives speeds and currents without a sign that of a command of the same motor.
    pub(super) fn give_directions(&self, sources: &mut Sources) {
        let both: Vec<(usize, &[String], Vec<f64>)> = sources
            .directions
            .iter()
            .map(|(column, words)| (*column, words.as_slice(), self.values(*column)))
            .filter(|(.., values)| turns(values))
            .collect();
        let give = |source: &mut Source| {
            let same = both.iter().find(|(_, words, _)| *words == source.words);
            let Some((column, _, direction)) = same.or_else(|| both.first()) else { return };
            let is_free = !source.columns.contains(column);
            if is_free && is_unsigned(&source.values) {
                source.take_sign(*column, direction, self.header(*column));
            }
        };
        sources.speed.iter_mut().for_each(give);
        // Where the shaft turns one way only, a current of one sign is right.
        if sources.speed.iter().any(|speed| turns(&speed.values)) {
            sources.current.iter_mut().for_each(give);
        }
    }

    fn list_unused(&self, readings: &[Reading], sources: &mut Sources) {
        for reading in readings {
            let why = match reading.quantity {
                Quantity::SupplyCurrent => {
                    "it is the current of the supply, not of the motor: the bridge chops between them"
                }
                Quantity::SupplyVoltage => "it is the voltage of the supply, not of the motor",
                _ => continue,
            };
            let header = format!("{:?}: {why}", self.header(reading.column));
            let notes = reading.notes.iter().cloned();
            let sentence: Vec<String> = [header].into_iter().chain(notes).collect();
            sources.unused.push((reading.column, sentence.join("; ")));
        }
    }
}

/// The value of an expression whose number is given.
pub(super) fn filled(hole: &str, given: &BTreeMap<String, f64>) -> Option<f64> {
    let number = Known::get().number_in(hole)?;
    let value = given.get(&number.name)?;
    let (head, tail) = hole.split_once(number.name.as_str())?;
    if !tail.is_empty() {
        return None;
    }
    match head.split_at(head.len().saturating_sub(1)) {
        ("", "") => Some(*value),
        (factor, "/") => Some(factor.parse::<f64>().ok()? / value),
        (factor, "*") => Some(factor.parse::<f64>().ok()? * value),
        _ => None,
    }
}

/// Both directions are there.
fn turns(values: &[f64]) -> bool {
    let (least, most) = extent(finite(values));
    let most_size = most.max(-least);
    least < -0.1 * most_size && most > 0.1 * most_size
}

/// Never clearly negative, and not constant.
fn is_unsigned(values: &[f64]) -> bool {
    let (least, most) = extent(finite(values));
    most > 0.0 && most > least && least > -0.02 * most
}

impl Source {
    /// The sign is the last of the command that was not zero.
    fn take_sign(&mut self, column: usize, direction: &[f64], header: &str) {
        let mut sign = 1.0;
        for (value, direction) in self.values.iter_mut().zip(direction) {
            if direction.abs() > 0.0 {
                sign = direction.signum();
            }
            *value *= sign;
        }
        self.sign_of = Some(column);
        self.confidence = self.confidence.max(Confidence::Likely);
        self.reasons.push(format!(
            "it is never negative while {header:?} has both directions: it takes that sign"
        ));
        self.doubts.push("its sign is wrong while the drive brakes".to_owned());
    }

    /// As it stands in a map.
    pub(super) fn text(&self, headers: &[String]) -> String {
        let names: Vec<String> =
            self.columns.iter().map(|column| quoted(&headers[*column])).collect();
        let mut text = names.join("*");
        let plain = self.columns.len() == 1 && self.sign_of.is_none() && self.hole.is_none();
        let header = &headers[self.columns[0]];
        let doubted = plain && sanity::of_header(self.target.key(), header, false).is_some();
        let is_one = (self.factor - 1.0).abs() < 1e-12;
        if !is_one || doubted {
            let _ = write!(text, "*{}", decimal(self.factor));
        }
        if let Some(hole) = &self.hole {
            let _ = write!(text, "*{{{hole}}}");
        }
        if let Some(column) = self.sign_of {
            let _ = write!(text, "*sign({})", quoted(&headers[column]));
        }
        text
    }

    pub(super) fn reverse(&mut self) {
        self.factor = -self.factor;
        for value in &mut self.values {
            *value = -*value;
        }
    }

    pub(super) fn scale(&mut self, factor: f64) {
        self.factor *= factor;
        for value in &mut self.values {
            *value *= factor;
        }
    }
}

/// A factor with ten figures and without an exponent.
pub(super) fn decimal(factor: f64) -> String {
    shortest(factor, 10).parse().unwrap_or(factor).to_string()
}

/// A header as a map takes it.
pub(super) fn quoted(header: &str) -> String {
    let is_plain = !header.contains([',', '*', '+', '"', '='])
        && !header.starts_with("sign(")
        && !header.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first))
        && header.parse::<f64>().is_err();
    if is_plain { header.to_owned() } else { format!("\"{}\"", header.replace('"', "\"\"")) }
}

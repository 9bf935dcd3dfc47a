//! Candidates for each quantity of a map: single columns, and a duty times its supply.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::Confidence;
use super::finding::{Doubt, Reason, Unused};
use super::known::{Factor, Quantity};
use super::reading::{Reading, UnitFrom};
use crate::recording::Preview;
use drivebench_identify::sanity;
use drivebench_model::numerics::statistics::{extent, finite, largest_but_outliers};
use drivebench_model::sample::Channel;

pub(super) const VOLTAGES: [Channel; 2] = [Channel::Voltage, Channel::VoltageCmd];

/// What may stand behind the `=` of one quantity.
#[derive(Clone, Debug)]
pub(super) struct Source {
    /// `None`: the time.
    pub target: Option<Channel>,
    /// Factors of a product; of the time, date and clock.
    pub columns: Vec<usize>,
    /// The column that has the sign which this one lacks.
    pub sign_of: Option<usize>,
    pub factor: Factor,
    pub unit_from: UnitFrom,
    pub rank: u8,
    pub confidence: Confidence,
    pub reasons: Vec<Reason>,
    pub doubts: Vec<Doubt>,
    /// Words that distinguish the motors of the file.
    pub words: Vec<String>,
    /// In SI, but for a number that the file does not contain.
    pub values: Vec<f64>,
}

/// The rows that are looked at, and the numbers that the user gives.
pub(super) struct Table<'a> {
    pub preview: &'a Preview,
    pub rows: Vec<usize>,
    pub time_s: Vec<f64>,
    pub given: &'a BTreeMap<String, f64>,
}

#[derive(Default)]
pub(super) struct Sources {
    pub all: Vec<Source>,
    /// Columns that have the direction of what the drive does, with the words of their headers.
    directions: Vec<(usize, Vec<String>)>,
    pub unused: Vec<Unused>,
}

impl Sources {
    pub(super) fn of<'a>(&'a self, channels: &'a [Channel]) -> impl Iterator<Item = &'a Source> {
        self.all.iter().filter(|source| source.is_of(channels))
    }

    /// That of the first rank.
    pub(super) fn first(&self, channel: Channel) -> Option<Source> {
        self.of(&[channel]).min_by_key(|source| source.rank).cloned()
    }
}

impl Table<'_> {
    /// A column at the rows that are looked at; a missing cell has the value before it.
    pub(super) fn values(&self, column: usize) -> Vec<f64> {
        let mut last = f64::NAN;
        let hold = |number: &f64| {
            last = if number.is_nan() { last } else { *number };
            last
        };
        let held: Vec<f64> = self.preview.columns[column].numbers.iter().map(hold).collect();
        self.rows.iter().map(|row| held[*row]).collect()
    }

    fn header(&self, column: usize) -> String {
        self.preview.headers[column].clone()
    }

    fn source(&self, target: Channel, reading: &Reading) -> Source {
        let unit = reading.unit.filter(|_| reading.unit_from == UnitFrom::Stated);
        let own = reading.reasons.iter().cloned();
        let confidence = match (reading.unit_from, reading.is_named) {
            (UnitFrom::Stated, true) => Confidence::Sure,
            (UnitFrom::Open, _) => Confidence::Unsure,
            _ => Confidence::Likely,
        };
        let reasons = own.chain(unit.map(|unit| Reason::Unit(unit.name))).collect();
        self.valued(Source {
            target: Some(target),
            factor: reading.factor,
            unit_from: reading.unit_from,
            rank: reading.rank,
            confidence,
            words: reading.words.clone(),
            ..Source::new(reading.column, reasons)
        })
    }

    /// Fills in a number that is given, and the values.
    fn valued(&self, source: Source) -> Source {
        let factor = source.factor.filled(self.given);
        let mut values = vec![factor.value; self.rows.len()];
        for column in &source.columns {
            values.iter_mut().zip(self.values(*column)).for_each(|(value, cell)| *value *= cell);
        }
        Source { factor, values, ..source }
    }

    pub(super) fn sources(&self, readings: &[Reading]) -> Sources {
        let mut found = Sources::default();
        let of = |quantity| readings.iter().filter(move |reading| reading.quantity == quantity);
        let duty = of(Quantity::Duty).min_by_key(|reading| reading.rank);
        let mut supplies: Vec<&Reading> = of(Quantity::SupplyVoltage).collect();
        for reading in of(Quantity::Voltage) {
            let values = self.values(reading.column);
            if sanity::is_of_a_supply(&values) {
                supplies.push(reading);
                let header = self.header(reading.column);
                let volts = extent(finite(&values)).into();
                found.unused.push(Unused::SupplyVoltage { header, volts });
            } else {
                found.all.push(self.source(Channel::Voltage, reading));
            }
        }
        // A voltage at the input of the motor, and not that of a supply, has the name of one.
        for reading in of(Quantity::SupplyVoltage).filter(|_| duty.is_none()) {
            let values = finite(&self.values(reading.column));
            let (least, most) = extent(&values);
            if least < 0.5 * most && !sanity::is_of_a_supply(&values) {
                let mut source = self.source(Channel::Voltage, reading);
                source.rank += 1;
                source.doubts.push(Doubt::NotOfSupply);
                source.confidence = Confidence::Unsure;
                found.all.push(source);
            }
        }
        supplies.sort_by_key(|reading| reading.rank);
        found.all.extend(duty.map(|duty| self.duty(duty, supplies.first().copied())));
        for reading in of(Quantity::Command) {
            let source = self.source(Channel::VoltageCmd, reading);
            let (rank, factor) = (source.rank + 2, Factor::ONE.times("VOLTS_PER_COUNT"));
            let doubts = vec![Doubt::Command];
            found.all.push(self.valued(Source { factor, rank, doubts, ..source }));
        }
        let commands = [
            Quantity::VoltageCommand,
            Quantity::Duty,
            Quantity::Command,
            Quantity::SpeedReference,
            Quantity::Voltage,
        ];
        let directions = commands.into_iter().flat_map(of);
        found.directions = directions.map(|it| (it.column, it.words.clone())).collect();
        for (quantity, channel) in [
            (Quantity::VoltageCommand, Channel::VoltageCmd),
            (Quantity::Current, Channel::Current),
            (Quantity::Torque, Channel::Torque),
            (Quantity::Angle, Channel::Angle),
            (Quantity::Speed, Channel::Speed),
        ] {
            found.all.extend(of(quantity).map(|reading| self.source(channel, reading)));
        }
        for reading in of(Quantity::ElectricalSpeed) {
            // The speed of the shaft is that of the field over the pole pairs.
            let mut source = self.source(Channel::Speed, reading);
            source.factor = Factor::of(reading.factor.value).over("POLE_PAIRS");
            source.reasons.push(Reason::Electrical);
            found.all.push(self.valued(Source { confidence: Confidence::Sure, ..source }));
        }
        for reading in of(Quantity::Channel) {
            self.channel(reading, &mut found.all);
        }
        self.leave_out_constants(&mut found);
        let is_of_supply = |reading: &&Reading| {
            matches!(reading.quantity, Quantity::SupplyCurrent | Quantity::SupplyVoltage)
        };
        let of_supply = |reading: &Reading| Unused::OfSupply {
            header: self.header(reading.column),
            quantity: reading.quantity,
            reasons: reading.reasons[1..].to_vec(),
        };
        found.unused.extend(readings.iter().filter(is_of_supply).map(of_supply));
        found
    }

    /// A column that never changes gives way to another; a voltage is that of a step, unless the motor turns both ways.
    fn leave_out_constants(&self, found: &mut Sources) {
        let range = |source: &Source| extent(finite(&source.values));
        let speeds = found.all.iter().filter(|source| source.is_of(&[Channel::Speed]));
        let turns_both_ways = speeds.map(range).any(|(least, most)| {
            let larger = most.max(-least);
            most.min(-least) > 0.05 * larger
        });
        let changes = |source: &Source| {
            let (least, most) = range(source);
            least < most || source.is_of(&VOLTAGES) && !turns_both_ways
        };
        let (mut kept, constant): (Vec<_>, Vec<_>) = found.all.drain(..).partition(changes);
        for source in constant {
            let gives_way = kept.iter().any(|other| other.target == source.target);
            if gives_way || source.is_of(&VOLTAGES) {
                found.unused.push(Unused::Constant { header: self.header(source.columns[0]) });
            } else {
                kept.push(source);
            }
        }
        found.all = kept;
    }

    /// The voltage that a bridge applies: a share of its supply.
    fn duty(&self, duty: &Reading, supply: Option<&Reading>) -> Source {
        let mut source = self.source(Channel::Voltage, duty);
        let most = largest_but_outliers(&source.values);
        source.reasons.push(Reason::Reaches(most));
        let is_open = duty.unit_from != UnitFrom::Stated;
        let in_counts = is_open && most > 105.0;
        if is_open && most > 1.05 && !in_counts {
            source.factor.value *= 0.01;
            source.doubts.push(Doubt::Percent);
            source.confidence = Confidence::Unsure;
        }
        if let Some(supply) = supply {
            source.columns.push(supply.column);
            source.factor.value *= supply.factor.value;
            source.reasons.push(Reason::ShareOf { supply: self.header(supply.column) });
        }
        source.factor = match (supply, in_counts) {
            (Some(_), false) => source.factor,
            (Some(_), true) => source.factor.over("FULL_SCALE"),
            (None, true) => source.factor.times("VOLTS_PER_COUNT"),
            (None, false) => source.factor.times("SUPPLY_V"),
        };
        source.rank += 1;
        self.valued(source)
    }

    /// A channel of an oscilloscope, or any column where none has a name: it may be any quantity that its unit allows.
    fn channel(&self, reading: &Reading, all: &mut Vec<Source>) {
        let by_unit = reading.unit.map(|unit| unit.quantity);
        let targets = [
            (Channel::Voltage, Quantity::Voltage),
            (Channel::Current, Quantity::Current),
            (Channel::Speed, Quantity::Speed),
        ];
        let is_open = !matches!(by_unit, Some(Quantity::Current | Quantity::Speed));
        let is_possible = |quantity| is_open || by_unit == Some(quantity);
        for (target, quantity) in targets.into_iter().filter(|own| is_possible(own.1)) {
            let is_sensor = by_unit == Some(Quantity::Voltage) && quantity != Quantity::Voltage;
            let own = reading.clone();
            let own = if is_sensor { own.of_sensor(quantity) } else { own };
            let mut source = self.source(target, &own);
            if by_unit.is_none() && target == Channel::Current {
                source.doubts.push(Doubt::TakenAsSi);
            }
            let confidence = if is_open { Confidence::Unsure } else { Confidence::Likely };
            all.push(Source { confidence, ..source });
        }
    }

    /// Gives speeds and currents without a sign that of a command of the same motor.
    pub(super) fn give_directions(&self, sources: &mut Sources) {
        let directions = std::mem::take(&mut sources.directions).into_iter();
        let valued = directions.map(|(column, words)| (column, words, self.values(column)));
        let both: Vec<_> = valued.filter(|(.., values)| turns(values)).collect();
        // Where the shaft turns one way only, a current of one sign is right.
        for channel in [Channel::Speed, Channel::Current] {
            let turns = sources.of(&[Channel::Speed]).any(|speed| turns(&speed.values));
            if channel == Channel::Current && !turns {
                return;
            }
            for source in sources.all.iter_mut().filter(|source| source.is_of(&[channel])) {
                let same = both.iter().find(|(_, words, _)| *words == source.words);
                let Some((column, _, direction)) = same.or_else(|| both.first()) else { return };
                if !source.columns.contains(column) && is_unsigned(&source.values) {
                    source.take_sign(*column, direction, self.header(*column));
                }
            }
        }
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
    /// The time, in s.
    pub(super) fn new(column: usize, reasons: Vec<Reason>) -> Self {
        Self {
            target: None,
            columns: vec![column],
            sign_of: None,
            factor: Factor::ONE,
            unit_from: UnitFrom::Stated,
            rank: 0,
            confidence: Confidence::Sure,
            reasons,
            doubts: Vec::new(),
            words: Vec::new(),
            values: Vec::new(),
        }
    }

    pub(super) fn is_of(&self, channels: &[Channel]) -> bool {
        self.target.is_some_and(|target| channels.contains(&target))
    }

    pub(super) fn key(&self) -> &'static str {
        self.target.map_or("time_s", Channel::key)
    }

    pub(super) fn at_least(&mut self, confidence: Confidence) {
        self.confidence = self.confidence.max(confidence);
    }

    /// The sign is the last of the command that was not zero.
    fn take_sign(&mut self, column: usize, direction: &[f64], command: String) {
        let mut sign = 1.0;
        for (value, direction) in self.values.iter_mut().zip(direction) {
            if direction.abs() > 0.0 {
                sign = direction.signum();
            }
            *value *= sign;
        }
        self.sign_of = Some(column);
        self.at_least(Confidence::Likely);
        self.reasons.push(Reason::TakesSign { command });
        self.doubts.push(Doubt::Braking);
    }

    /// As it stands in a map.
    pub(super) fn text(&self, headers: &[String]) -> String {
        let names: Vec<String> =
            self.columns.iter().map(|column| quoted(&headers[*column])).collect();
        let mut text = names.join(if self.target.is_none() { "+" } else { "*" });
        let is_plain = self.columns.len() == 1 && self.sign_of.is_none();
        let header = &headers[self.columns[0]];
        // The reader of the file refuses such a header without a factor.
        let needs_one = is_plain && sanity::of_header(self.key(), header, false).is_some();
        if needs_one || !self.factor.is_one() {
            let _ = write!(text, "*{}", self.factor.text());
        }
        if let Some(column) = self.sign_of {
            let _ = write!(text, "*sign({})", quoted(&headers[column]));
        }
        text
    }

    pub(super) fn scale(&mut self, factor: f64) {
        self.factor.value *= factor;
        for value in &mut self.values {
            *value *= factor;
        }
    }
}

/// A header as a map takes it.
fn quoted(header: &str) -> String {
    let is_plain = !header.contains([',', '*', '+', '"', '='])
        && !header.starts_with("sign(")
        && !header.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first))
        && header.parse::<f64>().is_err();
    if is_plain { header.to_owned() } else { format!("\"{}\"", header.replace('"', "\"\"")) }
}

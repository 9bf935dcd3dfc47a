//! The likely map of a foreign log: which column is which quantity, in which unit, and how sure that is.
//!
//! ```text
//! Preview -> known (program or instrument, words, units) -> reading: what each column may hold
//!         -> time_column
//!         -> source: candidates of each quantity -> choice: which belong together, and their signs  <- both balances
//!         -> units: speed against angle
//!         -> Proposal: a map, each column with its reasons and doubts, holes, what is missing; findings are codes with figures
//! ```
//!
//! Nothing is taken without a reason. A number that the file does not contain, as the pole pairs, is a hole in the map.

mod choice;
mod finding;
mod header;
mod known;
mod reading;
mod source;
mod time_column;
mod units;

pub use finding::{Doubt, Missing, Reason, Unused};
pub use known::Quantity;

use std::collections::BTreeMap;

use serde::Serialize;

use self::choice::{choose, settle_torque};
use self::known::{Known, Tool};
use self::reading::{Reading, readings};
use self::source::{Source, Sources, Table};
use self::time_column::{rising_rows, time_column};
use self::units::settle_units;
use crate::recording::Preview;
use drivebench_identify::sanity::{self, Fault, Kind};
use drivebench_model::findings;
use drivebench_model::plant::{Model, Scenario};
use drivebench_model::sample::{Channel, Origin, Run};

findings! {
    /// How far a part of a map is to be trusted.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Confidence {
        Sure = "sure",
        Likely = "likely",
        Unsure = "unsure",
    }
}

/// One quantity of the map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Item {
    pub target: &'static str,
    /// As it stands in the map behind the `=`.
    pub source: String,
    pub confidence: Confidence,
    pub reasons: Vec<Reason>,
    pub doubts: Vec<Doubt>,
    /// The number that has to be filled in.
    pub hole: Option<Hole>,
}

/// A number that the file does not contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Hole {
    pub name: &'static str,
    /// How to find it.
    pub how: &'static str,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Proposal {
    /// The program or instrument that writes such headers.
    pub tool: Option<&'static str>,
    /// The headers are those of this program: no map is needed.
    pub is_own: bool,
    /// The map, with its holes in braces; `None` where it lacks a quantity without which nothing is identified.
    pub map: Option<String>,
    pub items: Vec<Item>,
    /// What no map can do without.
    pub missing: Vec<Missing>,
    /// Faults of the record with the columns as they are mapped.
    pub doubts: Vec<Fault>,
    /// Columns that may hold something but are not in the map.
    pub unused: Vec<Unused>,
}

impl Proposal {
    pub fn holes(&self) -> impl Iterator<Item = Hole> {
        self.items.iter().filter_map(|item| item.hole)
    }

    /// That of the least certain quantity; a hole is not certain.
    pub fn confidence(&self) -> Confidence {
        let is_open = self.map.is_none() || !self.doubts.is_empty() || self.holes().count() > 0;
        let least = self.items.iter().map(|item| item.confidence).max();
        least.filter(|_| !is_open).unwrap_or(Confidence::Unsure)
    }

    /// A map that is complete and of which no quantity is unsure.
    pub fn is_settled(&self) -> bool {
        self.confidence() != Confidence::Unsure
    }
}

/// The numbers that may be given, as the pole pairs.
pub fn numbers() -> impl Iterator<Item = &'static str> + Clone {
    Known::get().numbers.keys().map(String::as_str)
}

/// Headers of a line, where they are those of a program or an instrument: for [`crate::recording::preview`].
pub fn known_headers(headers: &[String]) -> usize {
    Known::get().tool(headers).map_or(0, |_| headers.len())
}

/// Proposes a map; `given`: numbers that the file does not contain, under their names.
pub fn propose(preview: &Preview, given: &BTreeMap<String, f64>) -> Proposal {
    let tool = Known::get().tool(&preview.headers);
    let mut proposal = Proposal {
        tool: tool.map(|tool| tool.name.as_str()),
        is_own: is_own(&preview.headers),
        ..Proposal::default()
    };
    if proposal.is_own {
        return proposal;
    }
    let mut readings = all_readings(preview, tool);
    let time = time_column(preview, &readings, given);
    let stamps: Vec<f64> = match &time {
        Ok(time) => time.values.clone(),
        Err(_) => (0_u32..).map(f64::from).take(preview.columns[0].numbers.len()).collect(),
    };
    let rows = rising_rows(&stamps);
    let time_s = rows.iter().map(|row| stamps[*row]).collect();
    let table = Table { preview, rows, time_s, given };
    if let Ok(time) = &time {
        readings.retain(|reading| !time.columns.contains(&reading.column));
    }
    let mut sources = table.sources(&readings);
    table.give_directions(&mut sources);
    let mut chosen = choose(&table.time_s, &sources, &preview.headers);
    settle_torque(&table.time_s, &mut chosen);
    let mut angle = sources.first(Channel::Angle);
    settle_units(&table.time_s, &mut chosen, angle.as_mut());
    match time {
        Ok(time) => chosen.insert(0, time),
        Err(missing) => proposal.missing.push(missing),
    }
    finish(&mut proposal, &table, sources, (chosen, angle));
    proposal
}

/// The headers of a file of this program.
fn is_own(headers: &[String]) -> bool {
    let has = |name: &str| headers.iter().any(|header| header == name);
    has("time_s") && Channel::ALL.iter().any(|channel| has(channel.key()))
}

/// Without a name that is known, every column is a channel that may hold anything.
fn all_readings(preview: &Preview, tool: Option<&'static Tool>) -> Vec<Reading> {
    let mut found = readings(preview, tool);
    let is_named = |column: &usize| !preview.headers[*column].is_empty();
    let columns = (0..preview.headers.len()).filter(is_named);
    for column in columns.clone().filter(|column| preview.columns[*column].is_clock) {
        let mut own = found.iter().filter(|reading| reading.column == column);
        if own.all(|reading| reading.quantity != Quantity::Time) {
            found.retain(|reading| reading.column != column);
            found.push(Reading::new(column, Quantity::Time, None, None, Reason::Clocks));
        }
    }
    let is_useful = |reading: &Reading| {
        !matches!(reading.quantity, Quantity::Time | Quantity::Index | Quantity::Other)
    };
    if !found.iter().any(is_useful) {
        let is_free = |column: &usize| found.iter().all(|reading| reading.column != *column);
        let unknown =
            |column| Reading::new(column, Quantity::Channel, None, None, Reason::NameUnknown);
        let free: Vec<Reading> = columns.filter(is_free).map(unknown).collect();
        found.extend(free);
    }
    keep_group_words(&mut found);
    found
}

/// Keeps the words that distinguish motors: those of headers of several quantities, and not of all headers.
fn keep_group_words(readings: &mut [Reading]) {
    let named = readings.iter().filter(|reading| !reading.words.is_empty()).count();
    let mut quantities: BTreeMap<String, Vec<Quantity>> = BTreeMap::new();
    for reading in readings.iter() {
        for word in &reading.words {
            quantities.entry(word.clone()).or_default().push(reading.quantity);
        }
    }
    quantities.retain(|_, of| of.len() < named && of.iter().any(|quantity| *quantity != of[0]));
    for reading in readings {
        reading.words.retain(|word| quantities.contains_key(word));
    }
}

fn finish(
    proposal: &mut Proposal,
    table: &Table<'_>,
    sources: Sources,
    (mut chosen, angle): (Vec<Source>, Option<Source>),
) {
    let headers = &table.preview.headers;
    let has = |chosen: &[Source], channels: &[Channel]| chosen.iter().any(|it| it.is_of(channels));
    let text = |source: &Source| format!("{}={}", source.key(), source.text(headers));
    match angle {
        Some(angle) if has(&chosen, &[Channel::Speed]) => {
            proposal.unused.push(Unused::Angle { source: text(&angle) });
        }
        angle => chosen.extend(angle),
    }
    let used: Vec<usize> =
        chosen.iter().flat_map(|source| source.columns.iter().copied()).collect();
    // A torque that a drive calculates from its current adds nothing to that current.
    if has(&chosen, &[Channel::Current]) {
        let calculated = |source: &mut Source| source.is_of(&[Channel::Torque]) && source.rank > 0;
        let left_out = chosen.extract_if(.., calculated);
        let unused = |it: Source| Unused::Torque { source: text(&it), reasons: it.reasons };
        proposal.unused.extend(left_out.map(unused));
    }
    if !has(&chosen, &[Channel::Speed, Channel::Angle]) {
        proposal.missing.push(Missing::Speed);
    }
    if !has(&chosen, &[Channel::Voltage, Channel::VoltageCmd, Channel::Current, Channel::Torque]) {
        proposal.missing.push(Missing::Input);
    }
    // A supply voltage serves as a factor of a duty.
    let is_used = |of: &str| used.iter().any(|column| headers[*column] == of);
    proposal.unused.extend(sources.unused.into_iter().filter(|unused| match unused {
        Unused::SupplyVoltage { header, .. } | Unused::OfSupply { header, .. } => !is_used(header),
        _ => true,
    }));
    let is_other =
        |source: &&Source| !source.is_of(&[Channel::Angle]) && !used.contains(&source.columns[0]);
    let others = sources.all.iter().filter(is_other);
    proposal.unused.extend(others.map(|source| Unused::Other { source: text(source) }));
    proposal.unused.dedup();
    proposal.items.extend(chosen.iter().map(|source| item(source, headers)));
    for source in &chosen {
        for column in &source.columns {
            let header = headers[*column].clone();
            let count = headers.iter().filter(|other| **other == header).count();
            if count > 1 {
                proposal.missing.push(Missing::OwnHeader { target: source.key(), header, count });
            }
        }
    }
    proposal.missing.dedup();
    if proposal.missing.is_empty() {
        let parts: Vec<String> = chosen.iter().map(text).collect();
        proposal.map = Some(parts.join(","));
        proposal.doubts = doubts_of_record(table, &chosen, proposal.holes().count() > 0);
    }
}

fn doubts_of_record(table: &Table<'_>, chosen: &[Source], has_hole: bool) -> Vec<Fault> {
    let Ok(mut run) = Run::new("preview", table.time_s.clone()) else { return Vec::new() };
    for source in chosen {
        let Some(target) = source.target else { continue };
        if run.set_column(target, source.values.clone(), Origin::Unknown).is_err() {
            return Vec::new();
        }
    }
    let Ok(scenario) = Scenario::from_run(&run) else { return Vec::new() };
    let is_of_map = |kind: Kind| match kind {
        Kind::Swapped | Kind::Reversed | Kind::Unsigned => true,
        Kind::Unit | Kind::Magnitude => !has_hole,
        _ => false,
    };
    let findings = sanity::examine(&run, &scenario, &Model::default());
    let of_map = findings.into_iter().filter(|finding| is_of_map(finding.kind));
    of_map.map(|finding| finding.fault).collect()
}

fn item(source: &Source, headers: &[String]) -> Item {
    let hole = source.factor.number.and_then(|(name, _)| {
        let (name, how) = Known::get().numbers.get_key_value(name)?;
        Some(Hole { name, how })
    });
    Item {
        target: source.key(),
        source: source.text(headers),
        confidence: source.confidence,
        reasons: source.reasons.clone(),
        doubts: source.doubts.clone(),
        hole,
    }
}

#[cfg(test)]
mod tests;

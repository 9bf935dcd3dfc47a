//! The likely map of a foreign log: which column is which quantity, in which unit, and how sure that is.
//!
//! ```text
//! Preview -> known (program or instrument, words, units) -> reading: what each column may hold
//!         -> time_column
//!         -> source: candidates of each quantity -> choice: which belong together, and their signs  <- both balances
//!         -> units: speed against angle
//!         -> Proposal: a map, each column with its reasons and doubts, holes, what is missing
//! ```
//!
//! Nothing is believed without a reason. A number that the file does not contain, as the pole pairs, is a hole in the map.

mod choice;
mod header;
mod known;
mod reading;
mod source;
mod time_column;
mod units;

pub use known::Quantity;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;

use self::choice::{Chosen, choose, settle_torque};
use self::known::{Factor, Known, Tool};
use self::reading::{Reading, readings};
use self::source::{Source, Sources, Table, decimal, filled, quoted};
use self::time_column::{TimeColumn, rising_rows, time_column};
use self::units::settle_units;
use crate::recording::Preview;
use drivebench_identify::sanity::{self, Fault, Kind};
use drivebench_model::plant::{Model, Scenario};
use drivebench_model::sample::{Channel, Origin, Run};

/// How far a part of a map is to be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Confidence {
    Sure,
    Likely,
    Unsure,
}

impl Confidence {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sure => "sure",
            Self::Likely => "likely",
            Self::Unsure => "unsure",
        }
    }
}

/// One quantity of the map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Item {
    pub target: &'static str,
    /// As it stands in the map behind the `=`.
    pub source: String,
    pub confidence: Confidence,
    pub reasons: Vec<String>,
    pub doubts: Vec<String>,
    /// The number that has to be filled in.
    pub hole: Option<Hole>,
}

/// A number that the file does not contain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Hole {
    pub name: String,
    /// How to find it.
    pub how: String,
}

/// The likely map of a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Proposal {
    /// The program or instrument that writes such headers.
    pub tool: Option<String>,
    /// The headers are those of this program: no map is needed.
    pub is_own: bool,
    /// The map, with its holes in braces; `None` where it lacks a quantity without which nothing is identified.
    pub map: Option<String>,
    pub items: Vec<Item>,
    /// What no map can do without.
    pub missing: Vec<String>,
    /// What the judge of records finds wrong with the columns as they are mapped.
    pub doubts: Vec<Fault>,
    /// Columns that look like something but are not in the map.
    pub unused: Vec<String>,
}

impl Proposal {
    /// That of the least certain quantity; a hole is not certain.
    pub fn confidence(&self) -> Confidence {
        let has_hole = self.items.iter().any(|item| item.hole.is_some());
        let is_doubted = self.map.is_none() || has_hole || !self.doubts.is_empty();
        let least = self.items.iter().map(|item| item.confidence).max();
        if is_doubted { Confidence::Unsure } else { least.unwrap_or(Confidence::Unsure) }
    }

    /// A map that is complete and of which no quantity is unsure.
    pub fn is_believed(&self) -> bool {
        self.confidence() != Confidence::Unsure
    }
}

/// The numbers that may be given, as the pole pairs.
pub fn numbers() -> impl Iterator<Item = &'static str> + Clone {
    Known::get().numbers().map(|number| number.name.as_str())
}

/// Headers of a line, where they are those of a program or an instrument: for [`crate::recording::preview`].
pub fn known_headers(headers: &[String]) -> usize {
    Known::get().tool(headers).map_or(0, |_| headers.len())
}

/// Proposes a map; `given`: numbers that the file does not contain, under their names.
pub fn propose(preview: &Preview, given: &BTreeMap<String, f64>) -> Proposal {
    let tool = Known::get().tool(&preview.headers);
    let mut proposal = Proposal {
        tool: tool.map(|tool| tool.name.clone()),
        is_own: is_own(&preview.headers),
        map: None,
        items: Vec::new(),
        missing: Vec::new(),
        doubts: Vec::new(),
        unused: Vec::new(),
    };
    if proposal.is_own {
        return proposal;
    }
    let readings = all_readings(preview, tool);
    let time = match time_column(preview, &readings) {
        Ok(time) => Some(time),
        Err(why) => {
            proposal.missing.push(why);
            None
        }
    };
    let stamps: Vec<f64> = match &time {
        Some(time) => {
            let period = match &time.factor {
                Factor::Hole(hole) => filled(hole, given),
                Factor::Known(_) => None,
            };
            time.time_s.iter().map(|stamp| stamp * period.unwrap_or(1.0)).collect()
        }
        None => (0_u32..).map(f64::from).take(preview.columns[0].numbers.len()).collect(),
    };
    let rows = rising_rows(&stamps);
    let time_s = rows.iter().map(|row| stamps[*row]).collect();
    let table = Table { preview, rows, time_s, given };
    if let Some(time) = &time {
        proposal.items.push(time_item(time, &table));
    }
    let is_time =
        |reading: &&Reading| time.as_ref().is_none_or(|time| time.column != reading.column);
    let others: Vec<Reading> = readings.iter().filter(is_time).cloned().collect();
    let mut sources = table.sources(&others);
    let chosen = settled(&table, &mut sources);
    finish(&mut proposal, &table, sources, chosen);
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
    for (column, cells) in preview.columns.iter().enumerate() {
        let is_time =
            |reading: &Reading| reading.column == column && reading.quantity == Quantity::Time;
        let is_named = !preview.headers[column].is_empty();
        if cells.is_clock && is_named && !found.iter().any(is_time) {
            found.retain(|reading| reading.column != column);
            found.push(Reading::of_clock(column, &preview.headers[column]));
        }
    }
    let is_useful = |reading: &Reading| {
        !matches!(reading.quantity, Quantity::Time | Quantity::Index | Quantity::Other)
    };
    if !found.iter().any(is_useful) {
        let is_free = |column: &usize| found.iter().all(|reading| reading.column != *column);
        let is_named = |column: &usize| !preview.headers[*column].is_empty();
        let columns = (0..preview.headers.len()).filter(is_named);
        let free: Vec<usize> = columns.filter(is_free).collect();
        found.extend(free.into_iter().map(Reading::of_unknown));
    }
    group_words(&mut found);
    found
}

/// Keeps the words that tell motors apart: those that stand beside several quantities, and not in all headers.
fn group_words(readings: &mut [Reading]) {
    let tells = |word: &String| {
        let with: Vec<Quantity> = readings
            .iter()
            .filter(|reading| reading.words.contains(word))
            .map(|reading| reading.quantity)
            .collect();
        let several = with.iter().any(|quantity| *quantity != with[0]);
        several && with.len() < readings.iter().filter(|r| !r.words.is_empty()).count()
    };
    let telling: Vec<Vec<String>> = readings
        .iter()
        .map(|reading| reading.words.iter().filter(|word| tells(word)).cloned().collect())
        .collect();
    for (reading, words) in readings.iter_mut().zip(telling) {
        reading.words = words;
    }
}

/// The candidates that belong together, with signs and units.
fn settled(table: &Table<'_>, sources: &mut Sources) -> Chosen {
    table.give_directions(sources);
    let mut chosen = choose(&table.time_s, sources, &table.preview.headers);
    settle_torque(&table.time_s, &mut chosen);
    sources.angle.sort_by_key(|source| source.rank);
    settle_units(&table.time_s, &mut chosen, sources.angle.first_mut());
    chosen
}

fn finish(proposal: &mut Proposal, table: &Table<'_>, mut sources: Sources, mut chosen: Chosen) {
    let headers = &table.preview.headers;
    let has_speed = chosen.get(&[Channel::Speed]).is_some();
    let angle = (!sources.angle.is_empty()).then(|| sources.angle.remove(0));
    if let Some(angle) = angle {
        if has_speed {
            let text = format!("angle_rad={}", angle.text(headers));
            proposal.unused.push(format!("{text}: the speed is there, and serves alone"));
        } else {
            chosen.sources.push(angle);
        }
    }
    // A torque that a drive calculates from its current says nothing beside it.
    let has_current = chosen.get(&[Channel::Current]).is_some();
    chosen.sources.retain(|source| {
        let keeps = source.target != Channel::Torque || source.rank == 0 || !has_current;
        if !keeps {
            let text = format!("torque_n_m={}", source.text(headers));
            proposal.unused.push(format!("{text}: {}", source.reasons.join("; ")));
        }
        keeps
    });
    let has = |channels: &[Channel]| chosen.get(channels).is_some();
    if !has(&[Channel::Speed, Channel::Angle]) {
        proposal.missing.push("a speed or an angle of the shaft".to_owned());
    }
    let inputs = [Channel::Voltage, Channel::VoltageCmd, Channel::Current, Channel::Torque];
    if !has(&inputs) {
        proposal.missing.push("a voltage at the motor, its current, or a torque".to_owned());
    }
    proposal.unused.extend(sources.unused.drain(..).map(|(_, why)| why));
    let used: Vec<usize> =
        chosen.sources.iter().flat_map(|source| source.columns.clone()).collect();
    let lists = [&sources.voltage, &sources.current, &sources.speed, &sources.torque];
    let others = lists.into_iter().flatten().filter(|source| !used.contains(&source.columns[0]));
    proposal.unused.extend(others.map(|source| {
        format!("{}={}: another column was taken", source.target.key(), source.text(headers))
    }));
    proposal.items.extend(chosen.sources.iter().map(|source| item(source, headers)));
    for source in &chosen.sources {
        for column in &source.columns {
            let header = &headers[*column];
            let count = headers.iter().filter(|other| *other == header).count();
            if count > 1 {
                let target = source.target.key();
                proposal.missing.push(format!(
                    "a header of its own for {target}: {count} columns are called {header:?}; rename them in the file"
                ));
            }
        }
    }
    proposal.missing.dedup();
    if proposal.missing.is_empty() {
        let parts: Vec<String> =
            proposal.items.iter().map(|item| format!("{}={}", item.target, item.source)).collect();
        proposal.map = Some(parts.join(","));
        proposal.doubts = doubts_of_record(table, &chosen, &proposal.items);
    }
}

fn doubts_of_record(table: &Table<'_>, chosen: &Chosen, items: &[Item]) -> Vec<Fault> {
    let has_hole = items.iter().any(|item| item.hole.is_some());
    let Ok(mut run) = Run::new("preview", table.time_s.clone()) else { return Vec::new() };
    for source in &chosen.sources {
        if run.set_column(source.target, source.values.clone(), Origin::Unknown).is_err() {
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

fn time_item(time: &TimeColumn, table: &Table<'_>) -> Item {
    let header = &table.preview.headers[time.column];
    let (factor, hole) = table.resolved(&time.factor);
    let mut source = quoted(header);
    if let Some(date) = time.date {
        source = format!("{}+{source}", quoted(&table.preview.headers[date]));
    }
    let doubted = sanity::of_header("time_s", header, false).is_some();
    if (factor - 1.0).abs() > 1e-12 || doubted && hole.is_none() {
        let _ = write!(source, "*{}", decimal(factor));
    }
    if let Some(hole) = &hole {
        let _ = write!(source, "*{{{hole}}}");
    }
    Item {
        target: "time_s",
        source,
        confidence: time.confidence,
        reasons: time.reasons.clone(),
        doubts: time.doubts.clone(),
        hole: hole.as_deref().and_then(Hole::of),
    }
}

fn item(source: &Source, headers: &[String]) -> Item {
    Item {
        target: source.target.key(),
        source: source.text(headers),
        confidence: source.confidence,
        reasons: source.reasons.clone(),
        doubts: source.doubts.clone(),
        hole: source.hole.as_deref().and_then(Hole::of),
    }
}

impl Hole {
    fn of(expression: &str) -> Option<Self> {
        let number = Known::get().number_in(expression)?;
        Some(Self { name: number.name.clone(), how: number.how.clone() })
    }
}

#[cfg(test)]
mod tests;

//! Which cells of a line are the time and the quantities: by a map, or by our own headers.

use super::csv_head::Head;
use super::{ColumnMap, Factor, Mapping, RecordingError};
use drivebench_identify::sanity::{ColumnUnit, unit_of};
use drivebench_model::config_text::nearest;
use drivebench_model::sample::Channel;

/// Own columns that are no quantity.
const BOOKKEEPING: [&str; 4] = ["host_time_s", "seq", "status", QUALITY];
/// The one of them that is kept.
pub(super) const QUALITY: &str = "quality";

/// One column of the run: the product of some cells and `factor`, plus `offset`.
pub(super) struct Column {
    /// `None` is the time axis.
    pub target: Option<Channel>,
    pub cells: Vec<Cell>,
    pub factor: f64,
    pub offset: f64,
    /// The map gives a factor or an offset.
    pub scaled: bool,
    /// The cells are a date and a clock.
    pub is_date_and_clock: bool,
}

impl Default for Column {
    fn default() -> Self {
        let (cells, is_date_and_clock) = (Vec::new(), false);
        Self { target: None, cells, factor: 1.0, offset: 0.0, scaled: false, is_date_and_clock }
    }
}

impl Column {
    /// The time, and not a product of cells.
    pub(super) fn is_clock(&self) -> bool {
        self.target.is_none() && (self.cells.len() == 1 || self.is_date_and_clock)
    }

    pub(super) fn key(&self) -> &'static str {
        self.target.map_or("time_s", Channel::key)
    }
}

pub(super) struct Cell {
    pub field: usize,
    /// Only the sign of the cell counts: that of its last value that was not zero, +1 before there is one.
    pub sign: Option<f64>,
}

/// How many of the wanted columns are among the headers; 0 where the time is not. Without a map our own are wanted.
pub(super) fn wanted(map: Option<&ColumnMap>, headers: &[String]) -> usize {
    let has = |name: &str| headers.iter().any(|header| header == name);
    let Some(map) = map else {
        let channels = headers.iter().filter(|name| Channel::from_key(name).is_some()).count();
        return if has("time_s") { 1 + channels } else { 0 };
    };
    let is_there = |item: &Mapping| {
        has(&item.header)
            || item.columns.iter().all(|factor| match factor {
                Factor::Column(name) | Factor::SignOf(name) => has(name),
            })
            || item.target.is_none() && date_and_clock(&item.header, headers).is_some()
    };
    let (times, others): (Vec<&Mapping>, Vec<_>) =
        map.items().iter().partition(|item| item.target.is_none());
    let has_time = times.into_iter().all(is_there);
    let others = others.into_iter().filter(|item| is_there(item)).count();
    if has_time { 1 + others } else { 0 }
}

/// The columns of a date and a clock that are named together, as `Date+Time`.
fn date_and_clock<'a>(header: &'a str, headers: &[String]) -> Option<[&'a str; 2]> {
    let name = |part: &'a str| {
        let name = part.trim().trim_matches('"');
        headers.iter().any(|header| header == name).then_some(name)
    };
    let mut places = header.match_indices('+').map(|(at, _)| (&header[..at], &header[at + 1..]));
    places.find_map(|(date, clock)| Some([name(date)?, name(clock)?]))
}

pub(super) fn columns_by_map(
    head: &Head,
    map: &ColumnMap,
    file: &str,
) -> Result<Vec<Column>, RecordingError> {
    let headers = &head.headers;
    let cell = |name: &str, sign| -> Result<Cell, RecordingError> {
        Ok(Cell { field: field_of(head, name, file)?, sign })
    };
    let columns = map.items().iter().map(|item| {
        let pair = date_and_clock(&item.header, headers).filter(|_| item.target.is_none());
        // A header may contain a star or a plus itself.
        let is_one = headers.contains(&item.header);
        let is_date_and_clock = !is_one && pair.is_some();
        let cells = if is_one {
            vec![cell(&item.header, None)?]
        } else if let Some([date, clock]) = pair {
            vec![cell(date, None)?, cell(clock, None)?]
        } else {
            let cells = item.columns.iter().map(|factor| match factor {
                Factor::Column(name) => cell(name, None),
                Factor::SignOf(name) => cell(name, Some(1.0)),
            });
            cells.collect::<Result<_, RecordingError>>()?
        };
        let Mapping { target, factor, offset, scaled, .. } = *item;
        Ok(Column { target, cells, factor, offset, scaled, is_date_and_clock })
    });
    columns.collect()
}

/// Converts the columns to the units of their targets by a row of units, where the map has no factor; a factor that differs
/// and an unknown unit are warned of. Returns a sentence for each.
pub(super) fn convert(columns: &mut [Column], head: &Head) -> Vec<String> {
    let mut sentences = Vec::new();
    for column in columns {
        let [Cell { field, sign: None }] = column.cells[..] else { continue };
        let (Some(unit), header) = (head.units.get(field), &head.headers[field]) else { continue };
        let target = column.key();
        let known = unit_of(target, unit);
        let factor = known.map_or(1.0, |unit| unit.factor.parse().unwrap_or(1.0));
        sentences.push(match known {
            // A clock has no unit.
            None if unit.is_empty() || column.target.is_none() => continue,
            None => format!(
                "the row of units under the headers names {unit:?} for column {header:?}, which is no known unit of {target}: the column is read as it stands"
            ),
            Some(ColumnUnit { name, factor: text }) if column.scaled => {
                if (column.factor.abs() / factor - 1.0).abs() < 0.01 {
                    continue;
                }
                format!(
                    "the row of units under the headers names {name} for column {header:?}, that is a factor {text} to {target}, and the map gives {}: the map is followed",
                    column.factor
                )
            }
            Some(unit) if unit.factor == "1" => continue,
            Some(ColumnUnit { name, factor: text }) => {
                column.factor *= factor;
                format!(
                    "the row of units under the headers names {name} for column {header:?}: {target} is the column times {text}"
                )
            }
        });
    }
    sentences
}

pub(super) fn columns_of_our_own(
    head: &Head,
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<Vec<Column>, RecordingError> {
    let headers = &head.headers;
    let plain = |header, target| {
        let field = field_of(head, header, file)?;
        let cells = vec![Cell { field, sign: None }];
        Ok(Column { target, cells, ..Column::default() })
    };
    let mut columns = vec![plain("time_s", None)?];
    let mut ignored = Vec::new();
    for header in headers {
        if let Some(channel) = Channel::from_key(header) {
            columns.push(plain(header, Some(channel))?);
        } else if header != "time_s" && !BOOKKEEPING.contains(&header.as_str()) {
            ignored.push(format!("{header:?}"));
        }
    }
    if columns.len() == 1 {
        let (file, help) = (file.to_owned(), map_help(headers));
        return Err(RecordingError::NoKnownColumn { file, help });
    }
    if !ignored.is_empty() {
        warnings.push(format!("{file}: unknown columns were ignored: {}", ignored.join(", ")));
    }
    Ok(columns)
}

fn field_of(head: &Head, header: &str, file: &str) -> Result<usize, RecordingError> {
    let headers = &head.headers;
    let fields: Vec<usize> = (0..headers.len()).filter(|field| headers[*field] == header).collect();
    let (file, header) = (file.to_owned(), header.to_owned());
    match (fields.first(), fields.len()) {
        (Some(field), 1) => Ok(*field),
        (Some(_), count) => Err(RecordingError::AmbiguousHeader { file, header, count }),
        (None, _) => {
            head.refuse_numbers(&file)?;
            let names = headers.iter().map(String::as_str).filter(|name| !name.is_empty());
            let near = nearest(&header, names)
                .map_or_else(String::new, |name| format!("did you mean {name:?}? "));
            Err(RecordingError::HeaderNotFound { file, header, help: near + &map_help(headers) })
        }
    }
}

fn map_help(headers: &[String]) -> String {
    let there: Vec<String> = headers.iter().map(|name| format!("{name:?}")).collect();
    format!("the file has {}; name them with --map 'time_s=HEADER,...'", there.join(", "))
}

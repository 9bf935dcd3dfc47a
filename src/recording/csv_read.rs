//! Any CSV into a [`Run`], one line at a time.

use std::io::BufRead;

use super::{ColumnMap, RecordingError, csv_line};
use crate::config_text::nearest;
use crate::sample::{Channel, Origin, Run};

/// How a file is to be read.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReadOptions<'a> {
    /// Columns of a foreign file; without it the headers must be our own.
    pub map: Option<&'a ColumnMap>,
    /// The writer ends every row with a line feed, so a last row without one is torn even if it can be read: `1.2` may
    /// have been `1.25`. True for our own run folders.
    pub whole_lines_only: bool,
}

/// Columns of ours that are no quantity; they are read past.
const BOOKKEEPING: [&str; 4] = ["host_time_s", "seq", "status", "quality"];

/// One column that is wanted: where it stands and what is made of it.
struct Wanted {
    field: usize,
    target: Option<Channel>,
    factor: f64,
    offset: f64,
}

/// Reads a CSV: header row, comma, decimal point; a byte order mark is skipped; empty and `NaN` cells are missing; in
/// foreign files lines that begin with `#` are left out.
///
/// Returns the run and warnings for the reader. A torn last row is left out, counted in `rows_dropped` and warned of; a
/// row that cannot be read anywhere else is an error with its number. `file` names the run and stands in errors.
pub fn read_csv(
    mut reader: impl BufRead,
    file: &str,
    options: ReadOptions<'_>,
) -> Result<(Run, Vec<String>), RecordingError> {
    let mut warnings = Vec::new();
    let mut line = Line::default();
    let headers = find_headers(&mut reader, &mut line, file, options.map)?;
    let wanted = match options.map {
        Some(map) => wanted_by_map(&headers, map, file)?,
        None => wanted_of_our_own(&headers, file, &mut warnings)?,
    };
    let mut table = Table {
        file,
        headers,
        columns: vec![Vec::new(); wanted.len()],
        wanted,
        time_s: Vec::new(),
        fields: Vec::new(),
    };

    let mut row = 0;
    let mut rows_dropped = 0;
    let mut comments = 0;
    while line.read(&mut reader, file)? {
        if line.is_blank() {
            continue;
        }
        if line.is_comment() && !options.whole_lines_only {
            comments += 1;
            continue;
        }
        row += 1;
        let surely_torn = options.whole_lines_only && !line.complete;
        let taken = if surely_torn {
            None
        } else {
            Some(table.take(&line, row))
        };
        match taken {
            Some(Ok(())) => {}
            Some(Err(error)) if line.complete => return Err(error),
            _ => {
                rows_dropped += 1;
                warnings.push(format!(
                    "{file}: the last row (line {}) is torn and was left out",
                    line.number
                ));
            }
        }
    }
    if comments > 0 {
        warnings.push(format!(
            "{file}: {comments} lines that begin with # were left out"
        ));
    }
    if table.time_s.is_empty() {
        return Err(RecordingError::NoRows {
            file: file.to_owned(),
        });
    }
    let mut run = table.into_run(options.map.is_none())?;
    run.rows_dropped = rows_dropped;
    if run.column(Channel::Speed).is_none() && run.column(Channel::Angle).is_some() {
        run.notes.push(format!(
            "{file}: speed_rad_s is absent, angle_rad is there: speed has to be derived from it"
        ));
    }
    Ok((run, warnings))
}

/// A line of the file without its line end.
#[derive(Default)]
struct Line {
    bytes: Vec<u8>,
    number: usize,
    /// It ended with a line feed.
    complete: bool,
}

impl Line {
    /// False at the end of the file.
    fn read(&mut self, reader: &mut impl BufRead, file: &str) -> Result<bool, RecordingError> {
        self.bytes.clear();
        let count =
            reader
                .read_until(b'\n', &mut self.bytes)
                .map_err(|error| RecordingError::Io {
                    path: file.to_owned(),
                    doing: "read",
                    reason: error.to_string(),
                })?;
        self.number += 1;
        self.complete = self.bytes.last() == Some(&b'\n');
        if self.complete {
            self.bytes.pop();
            if self.bytes.last() == Some(&b'\r') {
                self.bytes.pop();
            }
        }
        if self.number == 1 && self.bytes.starts_with(b"\xef\xbb\xbf") {
            self.bytes.drain(..3);
        }
        Ok(count > 0)
    }

    fn is_blank(&self) -> bool {
        self.bytes.iter().all(u8::is_ascii_whitespace)
    }

    /// Foreign files carry remarks before and behind the data; our own never do.
    fn is_comment(&self) -> bool {
        self.bytes.trim_ascii_start().first() == Some(&b'#')
    }

    fn text(&self, file: &str) -> Result<&str, RecordingError> {
        std::str::from_utf8(&self.bytes).map_err(|_| RecordingError::NotUtf8 {
            file: file.to_owned(),
            line: self.number,
        })
    }
}

/// The header row: the first line that is neither blank nor a remark. A line that begins with `#` but has the time column
/// is a header, as some tools write it.
fn find_headers(
    reader: &mut impl BufRead,
    line: &mut Line,
    file: &str,
    map: Option<&ColumnMap>,
) -> Result<Vec<String>, RecordingError> {
    let time = map
        .and_then(|map| map.items().iter().find(|item| item.target.is_none()))
        .map_or("time_s", |item| item.header.as_str());
    while line.read(reader, file)? {
        if line.is_blank() {
            continue;
        }
        let found = headers(line, file);
        let is_remark = line.is_comment()
            && !matches!(&found, Ok(names) if names.iter().any(|name| name == time));
        if !is_remark {
            return found;
        }
    }
    Err(RecordingError::Empty {
        file: file.to_owned(),
    })
}

fn headers(line: &Line, file: &str) -> Result<Vec<String>, RecordingError> {
    let text = line.text(file)?;
    let mut fields = Vec::new();
    csv_line::split(text, &mut fields).ok_or_else(|| RecordingError::Quote {
        file: file.to_owned(),
        line: line.number,
    })?;
    Ok(fields
        .iter()
        .map(|(from, to)| csv_line::text(&text[*from..*to]).into_owned())
        .collect())
}

fn wanted_by_map(
    headers: &[String],
    map: &ColumnMap,
    file: &str,
) -> Result<Vec<Wanted>, RecordingError> {
    let mut wanted = Vec::new();
    for item in map.items() {
        wanted.push(Wanted {
            field: field_of(headers, &item.header, file)?,
            target: item.target,
            factor: item.factor,
            offset: item.offset,
        });
    }
    Ok(wanted)
}

fn wanted_of_our_own(
    headers: &[String],
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<Vec<Wanted>, RecordingError> {
    let plain = |field, target| Wanted {
        field,
        target,
        factor: 1.0,
        offset: 0.0,
    };
    let mut wanted = vec![plain(field_of(headers, "time_s", file)?, None)];
    let mut ignored = Vec::new();
    for header in headers {
        if let Some(channel) = Channel::from_key(header) {
            wanted.push(plain(field_of(headers, header, file)?, Some(channel)));
        } else if header != "time_s" && !BOOKKEEPING.contains(&header.as_str()) {
            ignored.push(format!("{header:?}"));
        }
    }
    if wanted.len() == 1 {
        return Err(RecordingError::NoKnownColumn {
            file: file.to_owned(),
            help: map_help(headers),
        });
    }
    if !ignored.is_empty() {
        warnings.push(format!(
            "{file}: columns that drivebench does not know were ignored: {}",
            ignored.join(", ")
        ));
    }
    Ok(wanted)
}

fn field_of(headers: &[String], header: &str, file: &str) -> Result<usize, RecordingError> {
    let count = headers.iter().filter(|other| *other == header).count();
    if count > 1 {
        return Err(RecordingError::AmbiguousHeader {
            file: file.to_owned(),
            header: header.to_owned(),
            count,
        });
    }
    headers
        .iter()
        .position(|other| other == header)
        .ok_or_else(|| {
            let near = nearest(
                header,
                headers
                    .iter()
                    .map(String::as_str)
                    .filter(|name| !name.is_empty()),
            );
            let near = near.map_or_else(String::new, |name| format!("did you mean {name:?}? "));
            RecordingError::HeaderNotFound {
                file: file.to_owned(),
                header: header.to_owned(),
                help: near + &map_help(headers),
            }
        })
}

/// What is in the file, and how to say which column is which.
fn map_help(headers: &[String]) -> String {
    if let [only] = headers
        && let Some(separator) = [';', '\t']
            .into_iter()
            .find(|letter| only.contains(*letter))
    {
        return format!("the separator must be a comma; this file seems to use {separator:?}");
    }
    let there: Vec<String> = headers.iter().map(|name| format!("{name:?}")).collect();
    format!(
        "the file has {}; name them with --map 'time_s=HEADER,...'",
        there.join(", ")
    )
}

struct Table<'a> {
    file: &'a str,
    headers: Vec<String>,
    wanted: Vec<Wanted>,
    time_s: Vec<f64>,
    columns: Vec<Vec<f64>>,
    /// Scratch: byte ranges of the cells of the present line.
    fields: Vec<(usize, usize)>,
}

impl Table<'_> {
    /// Adds one row, or nothing at all.
    fn take(&mut self, line: &Line, row: usize) -> Result<(), RecordingError> {
        let file = || self.file.to_owned();
        let text = line.text(self.file)?;
        csv_line::split(text, &mut self.fields).ok_or_else(|| RecordingError::Quote {
            file: file(),
            line: line.number,
        })?;
        if self.fields.len() != self.headers.len() {
            return Err(RecordingError::FieldCount {
                file: file(),
                row,
                line: line.number,
                found: self.fields.len(),
                expected: self.headers.len(),
            });
        }
        let mut time_s = f64::NAN;
        let mut time_column = 0;
        let mut empty = true;
        let mut values = [f64::NAN; Channel::COUNT + 1];
        for (value, wanted) in values.iter_mut().zip(&self.wanted) {
            let (from, to) = self.fields[wanted.field];
            let cell = text[from..to].trim();
            let parsed = parse_cell(cell).ok_or_else(|| RecordingError::NotANumber {
                file: file(),
                row,
                line: line.number,
                column: self.headers[wanted.field].clone(),
                text: cell.to_owned(),
            })?;
            *value = parsed * wanted.factor + wanted.offset;
            if wanted.target.is_none() {
                time_s = *value;
                time_column = wanted.field;
            } else {
                empty &= value.is_nan();
            }
        }
        if time_s.is_nan() {
            // A row of separators only, as spreadsheets leave them behind.
            if empty {
                return Ok(());
            }
            return Err(RecordingError::TimeMissing {
                file: file(),
                row,
                line: line.number,
                column: self.headers[time_column].clone(),
            });
        }
        if let Some(before_s) = self.time_s.last().copied()
            && time_s <= before_s
        {
            return Err(RecordingError::TimeNotIncreasing {
                file: file(),
                row,
                line: line.number,
                time_s,
                before_s,
            });
        }
        self.time_s.push(time_s);
        for (column, value) in self.columns.iter_mut().zip(values) {
            column.push(value);
        }
        Ok(())
    }

    /// A column without a single value is no column. Commands are commands in our own files; in a foreign one nobody
    /// has said where a signal comes from.
    fn into_run(self, our_own: bool) -> Result<Run, RecordingError> {
        let file = self.file;
        let wrap = |source| RecordingError::Run {
            file: file.to_owned(),
            source,
        };
        let mut run = Run::new(file, self.time_s).map_err(wrap)?;
        for (wanted, column) in self.wanted.iter().zip(self.columns) {
            let Some(channel) = wanted.target else {
                continue;
            };
            if column.iter().all(|value| value.is_nan()) {
                continue;
            }
            let origin = if our_own && channel.is_commanded() {
                Origin::Commanded
            } else {
                Origin::Unknown
            };
            run.set_column(channel, column, origin).map_err(wrap)?;
        }
        Ok(run)
    }
}

/// NaN for a missing cell; `None` for what is neither missing nor a finite number.
fn parse_cell(cell: &str) -> Option<f64> {
    if cell.is_empty() {
        return Some(f64::NAN);
    }
    cell.parse::<f64>()
        .ok()
        .filter(|value| !value.is_infinite())
}

#[cfg(test)]
#[path = "csv_read_tests.rs"]
mod tests;

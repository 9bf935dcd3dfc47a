//! Any CSV, one row at a time: the rules of reading are here, and the memory does not grow with the file.

use std::io::BufRead;

use super::{ColumnMap, ReadOptions, RecordingError, Row, csv_line};
use crate::config_text::nearest;
use crate::sample::Channel;

/// Columns of ours that are no quantity; they are read past.
const BOOKKEEPING: [&str; 4] = ["host_time_s", "seq", "status", QUALITY];
/// The one of them whose remarks are kept.
const QUALITY: &str = "quality";

/// One column that is wanted: where it stands and what is made of it.
struct Wanted {
    field: usize,
    target: Option<Channel>,
    factor: f64,
    offset: f64,
}

/// The rows of a CSV in order: header row, comma, decimal point; a byte order mark is skipped; empty and `NaN` cells are
/// missing; in foreign files lines that begin with `#` are left out.
///
/// A torn last row is left out, counted and warned of; a row that cannot be read anywhere else is an error with its
/// number.
pub struct CsvRows<R> {
    reader: R,
    file: String,
    headers: Vec<String>,
    wanted: Vec<Wanted>,
    /// Where our own remarks stand; a foreign column of that name is none of ours.
    quality_field: Option<usize>,
    whole_lines_only: bool,
    line: Line,
    /// Scratch: byte ranges of the cells of the present line.
    fields: Vec<(usize, usize)>,
    last_s: Option<f64>,
    /// Lines with data, counted as errors count them.
    lines: usize,
    rows: usize,
    rows_dropped: usize,
    comments: usize,
    warnings: Vec<String>,
}

impl<R: BufRead> CsvRows<R> {
    /// Reads the header. `file` names the run and stands in errors.
    pub fn new(
        mut reader: R,
        file: &str,
        options: ReadOptions<'_>,
    ) -> Result<Self, RecordingError> {
        let mut warnings = Vec::new();
        let mut line = Line::default();
        let headers = find_headers(&mut reader, &mut line, file, options.map)?;
        let wanted = match options.map {
            Some(map) => wanted_by_map(&headers, map, file)?,
            None => wanted_of_our_own(&headers, file, &mut warnings)?,
        };
        let quality_field = match options.map {
            Some(_) => None,
            None => headers.iter().position(|header| header == QUALITY),
        };
        Ok(Self {
            reader,
            file: file.to_owned(),
            quality_field,
            headers,
            wanted,
            whole_lines_only: options.whole_lines_only,
            line,
            fields: Vec::new(),
            last_s: None,
            lines: 0,
            rows: 0,
            rows_dropped: 0,
            comments: 0,
            warnings,
        })
    }

    /// The next row, with its quantities and, in our own files, the remarks on them; `None` at the end of the file.
    pub fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        while self.line.read(&mut self.reader, &self.file)? {
            if self.line.is_blank() {
                continue;
            }
            if self.line.is_comment() && !self.whole_lines_only {
                self.comments += 1;
                continue;
            }
            self.lines += 1;
            let surely_torn = self.whole_lines_only && !self.line.complete;
            let taken = if surely_torn { None } else { Some(self.take()) };
            match taken {
                Some(Ok(None)) => {}
                Some(Ok(Some(row))) => {
                    self.rows += 1;
                    return Ok(Some(row));
                }
                Some(Err(error)) if self.line.complete => return Err(error),
                _ => {
                    self.rows_dropped += 1;
                    self.warnings.push(format!(
                        "{}: the last row (line {}) is torn and was left out",
                        self.file, self.line.number
                    ));
                }
            }
        }
        if self.comments > 0 {
            self.warnings.push(format!(
                "{}: {} lines that begin with # were left out",
                self.file, self.comments
            ));
            self.comments = 0;
        }
        if self.rows == 0 {
            return Err(RecordingError::NoRows {
                file: self.file.clone(),
            });
        }
        Ok(None)
    }

    /// The channels that the file has a column for; each cell of it may still be missing.
    pub fn channels(&self) -> impl Iterator<Item = Channel> + '_ {
        self.wanted.iter().filter_map(|wanted| wanted.target)
    }

    /// Rows given out so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Torn rows that were left out.
    pub fn rows_dropped(&self) -> usize {
        self.rows_dropped
    }

    /// Sentences for the reader; complete after the last row.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The present line as a row; `None` for a row of separators only, as spreadsheets leave them behind.
    fn take(&mut self) -> Result<Option<Row>, RecordingError> {
        let (line, row) = (&self.line, self.lines);
        let file = || self.file.clone();
        let text = line.text(&self.file)?;
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
        let mut out = Row::at(f64::NAN);
        let mut time_column = 0;
        let mut empty = true;
        for wanted in &self.wanted {
            let (from, to) = self.fields[wanted.field];
            let cell = text[from..to].trim();
            let parsed = parse_cell(cell).ok_or_else(|| RecordingError::NotANumber {
                file: file(),
                row,
                line: line.number,
                column: self.headers[wanted.field].clone(),
                text: cell.to_owned(),
            })?;
            let value = parsed * wanted.factor + wanted.offset;
            if let Some(channel) = wanted.target {
                empty &= value.is_nan();
                out.set(channel, Some(value));
            } else {
                out.time_s = value;
                time_column = wanted.field;
            }
        }
        if out.time_s.is_nan() {
            if empty {
                return Ok(None);
            }
            return Err(RecordingError::TimeMissing {
                file: file(),
                row,
                line: line.number,
                column: self.headers[time_column].clone(),
            });
        }
        if let Some(before_s) = self.last_s
            && out.time_s <= before_s
        {
            return Err(RecordingError::TimeNotIncreasing {
                file: file(),
                row,
                line: line.number,
                time_s: out.time_s,
                before_s,
            });
        }
        self.last_s = Some(out.time_s);
        if let Some(field) = self.quality_field {
            let (from, to) = self.fields[field];
            text[from..to].clone_into(&mut out.quality);
        }
        Ok(Some(out))
    }
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

/// NaN for a missing cell; `None` for what is neither missing nor a finite number.
fn parse_cell(cell: &str) -> Option<f64> {
    if cell.is_empty() {
        return Some(f64::NAN);
    }
    cell.parse::<f64>()
        .ok()
        .filter(|value| !value.is_infinite())
}

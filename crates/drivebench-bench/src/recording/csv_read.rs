//! Any CSV (RFC 4180, with dialects) row by row into rows and runs.
//!
//! ```text
//! text -> csv_head: Head (separator, headers) -> csv_columns: which cell is what
//!      -> csv_cells: cells of one line -> csv_number -> time_axis -> Row -> Run
//! ```

use std::io::BufRead;

use super::csv_cells::{Cells, at_line};
use super::csv_columns::{Cell, Column, QUALITY, columns_by_map, columns_of_our_own};
use super::csv_head::{Head, read_head};
use super::csv_number::NumberFormat;
use super::error::RowProblem;
use super::time_axis::Stamps;
use super::{ColumnMap, RecordingError, Row};
use drivebench_model::sample::{Channel, LARGEST, Origin, Run};

/// How a file is to be read.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReadOptions<'a> {
    /// Columns of a foreign file; without it the headers must be our own.
    pub map: Option<&'a ColumnMap>,
    /// Of a run folder: every row ends with a line feed, and there are no comments.
    pub in_run_folder: bool,
}

/// Reads a whole CSV by the rules of [`CsvRows`]. Returns the run and warnings for the reader.
pub fn read_csv(
    reader: impl BufRead,
    file: &str,
    options: ReadOptions<'_>,
) -> Result<(Run, Vec<String>), RecordingError> {
    let mut rows = CsvRows::new(reader, file, options)?;
    Ok((collect(&mut rows, file, options.map.is_none())?, rows.warnings()))
}

/// All rows as columns, without those that have no value. In our own files commands are commands; in a foreign one the origin
/// of a signal is unknown.
pub(super) fn collect(
    rows: &mut CsvRows<impl BufRead>,
    file: &str,
    our_own: bool,
) -> Result<Run, RecordingError> {
    let channels: Vec<Channel> = rows.channels().collect();
    let mut columns = vec![Vec::new(); channels.len()];
    let mut time_s = Vec::new();
    let mut limited_rows = Vec::new();
    while let Some(row) = rows.next_row()? {
        if row.is_limited() {
            limited_rows.push(time_s.len());
        }
        time_s.push(row.time_s);
        for (column, channel) in columns.iter_mut().zip(&channels) {
            column.push(row.get(*channel).unwrap_or(f64::NAN));
        }
    }
    let wrap = |source| RecordingError::Run { file: file.to_owned(), source };
    let mut run = Run::new(file, time_s).map_err(wrap)?;
    for (channel, column) in channels.into_iter().zip(columns) {
        if column.iter().all(|value| value.is_nan()) {
            continue;
        }
        let origin =
            if our_own && channel.is_commanded() { Origin::Commanded } else { Origin::Unknown };
        run.set_column(channel, column, origin).map_err(wrap)?;
    }
    run.set_limited_rows(limited_rows);
    run.rows_dropped = rows.rows_dropped;
    run.notes.extend(rows.dialect());
    run.notes.extend(rows.stamps.sentence(file));
    if run.column(Channel::Speed).is_none() && run.column(Channel::Angle).is_some() {
        run.notes.push(format!(
            "{file}: speed_rad_s is absent, angle_rad is there: speed has to be derived from it"
        ));
    }
    Ok(run)
}

/// The rows of a CSV in order. Empty and `NaN` cells are missing; in foreign files lines that begin with `#` are comments.
///
/// A torn last row is left out, counted and warned of, and so are rows of a foreign file whose time is not after that of
/// the row before; any other row that cannot be read is an error with its number.
pub struct CsvRows<R> {
    cells: Cells<R>,
    file: String,
    head: Head,
    columns: Vec<Column>,
    /// The `quality` column, of our own files only.
    quality_field: Option<usize>,
    is_mapped: bool,
    in_run_folder: bool,
    numbers: NumberFormat,
    last_s: Option<f64>,
    /// Lines with data, counted as errors count them.
    lines: usize,
    rows: usize,
    rows_dropped: usize,
    ends_torn: bool,
    comments: usize,
    stamps: Stamps,
    warnings: Vec<String>,
}

impl<R: BufRead> CsvRows<R> {
    /// Reads the header. `file` names the run and stands in errors.
    pub fn new(reader: R, file: &str, options: ReadOptions<'_>) -> Result<Self, RecordingError> {
        let mut items = options.map.map_or(&[][..], ColumnMap::items).iter();
        let time = items.find(|item| item.target.is_none());
        let time = time.map_or("time_s", |item| item.header.as_str());
        let (head, cells) = read_head(reader, file, time)?;
        let mut warnings = Vec::new();
        let columns = match options.map {
            Some(map) => columns_by_map(&head.headers, map, file)?,
            None => columns_of_our_own(&head.headers, file, &mut warnings)?,
        };
        let quality_field = head.headers.iter().position(|header| header == QUALITY);
        Ok(Self {
            cells,
            file: file.to_owned(),
            quality_field: quality_field.filter(|_| options.map.is_none()),
            numbers: NumberFormat::new(head.separator),
            head,
            columns,
            is_mapped: options.map.is_some(),
            in_run_folder: options.in_run_folder,
            last_s: None,
            lines: 0,
            rows: 0,
            rows_dropped: 0,
            ends_torn: false,
            comments: 0,
            stamps: Stamps::default(),
            warnings,
        })
    }

    /// A torn last row was cut off before.
    pub(super) fn set_ends_torn(&mut self, ends_torn: bool) {
        self.ends_torn = ends_torn;
    }

    /// The next row, in our own files with its quality; `None` at the end of the file.
    pub fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        loop {
            let taken = match self.cells.next_line() {
                Ok(false) => break,
                Ok(true) => self.take(),
                Err(error) => Err(at_line(&error, &self.file, self.cells.line())),
            };
            match taken {
                Ok(None) => {}
                Ok(row) => {
                    self.rows += 1;
                    return Ok(row);
                }
                Err(error) => {
                    if !self.cells.is_open() {
                        return Err(error);
                    }
                    self.leave_out_torn();
                }
            }
        }
        if std::mem::take(&mut self.ends_torn) {
            self.leave_out_torn();
        }
        let (file, comments) = (&self.file, std::mem::take(&mut self.comments));
        if comments > 0 {
            self.warnings.push(format!("{file}: {comments} lines that begin with # were left out"));
        }
        if self.rows == 0 {
            return Err(RecordingError::NoRows { file: self.file.clone() });
        }
        // Then the column is no time.
        let too_many = self.stamps.backwards as f64 > 0.1 * self.rows as f64;
        match self.stamps.first.take() {
            Some(error) if too_many => Err(error),
            _ => Ok(None),
        }
    }

    /// The channels that the file has a column for; each cell of it may still be missing.
    pub fn channels(&self) -> impl Iterator<Item = Channel> + '_ {
        self.columns.iter().filter_map(|column| column.target)
    }

    /// Rows read so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Rows that were left out because they are torn or for their time.
    pub fn rows_dropped(&self) -> usize {
        self.rows_dropped
    }

    /// Sentences for the reader; complete after the last row.
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.iter().cloned().chain(self.stamps.sentence(&self.file)).collect()
    }

    /// How the file differs from comma and decimal point; complete after the last row.
    pub fn dialect(&self) -> Option<String> {
        let separator = self.head.separator;
        let name = match separator {
            b'\t' => "a tab".to_owned(),
            other => format!("{:?}", char::from(other)),
        };
        let differences = [
            (separator != b',', &*format!("{name} separates the cells")),
            (self.numbers.has_decimal_comma(), "numbers have a decimal comma"),
            (self.head.has_sep_line, "a sep= line names the separator"),
            (self.head.has_mark, "it begins with a byte order mark"),
        ];
        let texts: Vec<&str> =
            differences.iter().filter(|(applies, _)| *applies).map(|(_, text)| *text).collect();
        (!texts.is_empty()).then(|| format!("{}: {}", self.file, texts.join(", ")))
    }

    fn leave_out_torn(&mut self) {
        self.rows_dropped += 1;
        let (file, line) = (&self.file, self.cells.line());
        self.warnings.push(format!("{file}: the last row (line {line}) is torn and was left out"));
    }

    /// The present line as a row; `None` for a blank line, a comment, a row of separators only, as spreadsheets write them,
    /// and one that is left out for its time.
    fn take(&mut self) -> Result<Option<Row>, RecordingError> {
        let line = self.cells.line();
        let first = self.cells.get(0);
        // With its carriage return a blank line is one cell.
        if self.cells.count() == 1 && first.is_empty() {
            return Ok(None);
        }
        if first.starts_with('#') && !self.in_run_folder {
            self.comments += 1;
            return Ok(None);
        }
        self.lines += 1;
        let (file, row, headers) = (&self.file, self.lines, &self.head.headers);
        let wrong = |problem| RecordingError::Row { file: file.clone(), row, line, problem };
        if self.cells.count() != headers.len() {
            return Err(wrong(RowProblem::FieldCount {
                found: self.cells.count(),
                expected: headers.len(),
            }));
        }
        let mut out = Row::at(f64::NAN);
        let mut time_column = 0;
        let mut empty = true;
        for column in &mut self.columns {
            let mut value = column.factor;
            for Cell { field, sign } in &mut column.cells {
                let cell = self.cells.get(*field);
                let Some(number) = self.numbers.number(cell) else {
                    return Err(wrong(RowProblem::NotANumber {
                        column: headers[*field].clone(),
                        text: cell.to_owned(),
                    }));
                };
                value *= match sign {
                    None => number,
                    Some(sign) => {
                        if number.abs() > 0.0 {
                            *sign = number.signum();
                        }
                        *sign
                    }
                };
            }
            value += column.offset;
            if value.abs() > LARGEST {
                let column = headers[column.cells[0].field].clone();
                return Err(wrong(RowProblem::TooLarge { column, value }));
            }
            if let Some(channel) = column.target {
                empty &= value.is_nan();
                out.set(channel, Some(value));
            } else {
                out.time_s = value;
                time_column = column.cells[0].field;
            }
        }
        if out.time_s.is_nan() {
            if empty {
                return Ok(None);
            }
            return Err(wrong(RowProblem::TimeMissing { column: headers[time_column].clone() }));
        }
        if let Some(before_s) = self.last_s
            && out.time_s <= before_s
        {
            let error = wrong(RowProblem::TimeNotIncreasing { time_s: out.time_s, before_s });
            if !self.is_mapped {
                return Err(error);
            }
            self.rows_dropped += 1;
            if out.time_s < before_s {
                self.stamps.backwards += 1;
                self.stamps.first.get_or_insert(error);
            } else {
                self.stamps.repeated += 1;
            }
            return Ok(None);
        }
        self.last_s = Some(out.time_s);
        if let Some(field) = self.quality_field {
            self.cells.get(field).clone_into(&mut out.quality);
        }
        Ok(Some(out))
    }
}

#[cfg(test)]
#[path = "csv_read_tests.rs"]
mod tests;

//! Any CSV (RFC 4180, with dialects) row by row into rows and runs.
//!
//! ```text
//! text -> csv_head: Head (separator, headers, units) -> csv_columns: which cell is what
//!      -> csv_cells: cells of one line -> csv_number, csv_time: values -> time_axis: order -> Row -> Run
//! ```

use std::borrow::Cow;
use std::io::{self, BufRead, Read};

use super::csv_cells::{Cells, at_line};
use super::csv_columns::{
    Cell, Column, QUALITY, columns_by_map, columns_of_our_own, convert, wanted,
};
use super::csv_head::{Head, read_head};
use super::csv_number::{NoNumber, NumberFormat};
use super::csv_time::{Clock, NumberClock, TextClock};
use super::error::{Remedy, RowProblem};
use super::time_axis::{Counter, Fall, Stamp, TimeAxis};
use super::{ColumnMap, MissingValues, RecordingError, Row};
use drivebench_identify::sanity::unit_of_stamps;
use drivebench_model::numerics::statistics::median;
use drivebench_model::sample::{Channel, LARGEST, Origin, Run};

#[derive(Clone, Copy, Debug, Default)]
pub struct ReadOptions<'a> {
    /// Columns of a foreign file; without it the headers must be our own.
    pub map: Option<&'a ColumnMap>,
    /// Lines before the header row; without it they are found.
    pub skip: Option<usize>,
    /// Texts and numbers that stand for a missing value.
    pub missing: Option<&'a MissingValues>,
    /// Of a run folder: every row ends with a line feed, there are no comments, and the time increases strictly.
    pub in_run_folder: bool,
}

impl<'a> ReadOptions<'a> {
    /// Of a foreign file with these columns.
    pub fn mapped(map: &'a ColumnMap) -> Self {
        Self { map: Some(map), ..Self::default() }
    }
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
    let (mut limited_rows, mut unconfirmed_rows) = (Vec::new(), Vec::new());
    while let Some(row) = rows.next_row()? {
        if row.is_limited() {
            limited_rows.push(time_s.len());
        }
        if row.is_unconfirmed() {
            unconfirmed_rows.push(time_s.len());
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
    run.set_unconfirmed_rows(unconfirmed_rows);
    run.rows_dropped = rows.rows_dropped();
    run.notes.extend(rows.dialect());
    run.notes.extend(rows.conversions());
    if run.column(Channel::Speed).is_none() && run.column(Channel::Angle).is_some() {
        run.notes.push(format!(
            "{file}: speed_rad_s is absent, angle_rad is there: speed has to be derived from it"
        ));
    }
    Ok(run)
}

/// The rows of a CSV in order. Empty and `NaN` cells are missing; in foreign files lines that begin with `#` are comments.
///
/// A torn last row is left out, counted and warned of. In a run folder the time must be strictly increasing; elsewhere it is
/// put in order, with a sentence, where that is certain. Any other row that cannot be read is an error with its number.
pub struct CsvRows<R> {
    cells: Cells<R>,
    file: String,
    head: Head,
    columns: Vec<Column>,
    /// The `quality` column, of our own files only.
    quality_field: Option<usize>,
    in_run_folder: bool,
    missing: MissingValues,
    numbers: NumberFormat,
    clock: Clock,
    axis: TimeAxis<Row>,
    last_s: Option<f64>,
    /// Lines with data, counted as errors count them.
    lines: usize,
    rows: usize,
    torn: usize,
    ends_torn: bool,
    is_over: bool,
    comments: usize,
    /// Header rows among the data, and the line of the first.
    headers_again: (usize, usize),
    /// Conversions by the row of units.
    conversions: Vec<String>,
    warnings: Vec<String>,
}

impl<R: BufRead> CsvRows<R> {
    /// Reads the header. `file` names the run and stands in errors.
    pub fn new(reader: R, file: &str, options: ReadOptions<'_>) -> Result<Self, RecordingError> {
        let is_mapped = options.map.is_some();
        let (head, cells) =
            read_head(reader, file, options.skip, |headers| wanted(options.map, headers))?;
        let mut warnings = Vec::new();
        let mut columns = match options.map {
            Some(map) => columns_by_map(&head, map, file)?,
            None => columns_of_our_own(&head, file, &mut warnings)?,
        };
        let conversions = convert(&mut columns, &head);
        let mut numbers = NumberFormat::new();
        learn(&cells, &head, &columns, &mut numbers);
        let quality_field = head.headers.iter().position(|header| header == QUALITY);
        Ok(Self {
            cells,
            file: file.to_owned(),
            quality_field: quality_field.filter(|_| !is_mapped),
            head,
            columns,
            in_run_folder: options.in_run_folder,
            missing: options.missing.cloned().unwrap_or_default(),
            numbers,
            clock: Clock::default(),
            axis: TimeAxis::default(),
            last_s: None,
            lines: 0,
            rows: 0,
            torn: 0,
            ends_torn: false,
            is_over: false,
            comments: 0,
            headers_again: (0, 0),
            conversions,
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
            if let Some((time_s, mut row)) = self.axis.pop() {
                row.time_s = time_s;
                self.rows += 1;
                return Ok(Some(row));
            }
            if self.is_over {
                return self.end();
            }
            let mut row = Row::at(f64::NAN);
            let taken = match self.cells.next_line() {
                Ok(false) => {
                    self.is_over = true;
                    if std::mem::take(&mut self.ends_torn) {
                        self.leave_out_torn();
                    }
                    self.axis.finish().map_err(|fall| self.refused(&fall))?;
                    continue;
                }
                Ok(true) => self.take(&mut row),
                Err(error) => Err(at_line(&error, &self.file, self.cells.line())),
            };
            match taken {
                Ok(None) => {}
                Ok(Some(_)) if self.in_run_folder => {
                    self.rows += 1;
                    return Ok(Some(row));
                }
                Ok(Some(stamp)) => {
                    if let Some(time_s) = self.axis.next_in_order(stamp) {
                        row.time_s = time_s;
                        self.rows += 1;
                        return Ok(Some(row));
                    }
                    let (clock, columns) = (&self.clock, &self.columns);
                    let pushed = self.axis.push(stamp, row, || counters(clock, columns));
                    pushed.map_err(|fall| self.refused(&fall))?;
                }
                Err(error @ RecordingError::TimeUnit { .. }) => return Err(error),
                Err(_) if self.cells.is_open() => self.leave_out_torn(),
                Err(error) => self.explain(error)?,
            }
        }
    }

    /// The channels that the file has a column for; each cell of it may still be missing.
    pub fn channels(&self) -> impl Iterator<Item = Channel> + '_ {
        self.columns.iter().filter_map(|column| column.target)
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Rows that were left out because they are torn or for their time.
    pub fn rows_dropped(&self) -> usize {
        self.torn + self.axis.left_out()
    }

    /// Sentences for the reader; complete after the last row.
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.iter().cloned().chain(self.conversions()).collect()
    }

    /// What the reader did to the values by itself, for the notes of the run; complete after the last row.
    fn conversions(&self) -> impl Iterator<Item = String> {
        let column = self.time_column();
        let clock = match &self.clock {
            Clock::Open => None,
            Clock::Numbers(clock) => clock.origin().map(|origin| {
                format!("time_s counts from the first row, at {origin} in column {column:?}")
            }),
            Clock::Text(clock) => Some(format!(
                "column {column:?} is a date or a clock: time_s counts the seconds since {}",
                clock.origin()
            )),
        };
        let (count, line) = self.headers_again;
        let again = (count > 0).then(|| {
            format!(
                "the header row stands again {count} times, first in line {line}, and was left out"
            )
        });
        let axis = self.axis.sentences(&column);
        let all = self.conversions.iter().cloned().chain(clock).chain(again).chain(axis);
        all.map(|sentence| format!("{}: {sentence}", self.file))
    }

    /// How the file differs from comma and decimal point; complete after the last row.
    pub fn dialect(&self) -> Option<String> {
        let head = &self.head;
        let name = match head.separator {
            b'\t' => "a tab".to_owned(),
            other => format!("{:?}", char::from(other)),
        };
        let texts: Vec<String> = [(head.separator != b',', format!("{name} separates the cells"))]
            .into_iter()
            .chain(self.numbers.differences().map(|text| (true, text)))
            .chain([
                (head.has_sep_line, "a sep= line names the separator".to_owned()),
                (head.has_mark, "it begins with a byte order mark".to_owned()),
                (head.has_carriage_returns, "carriage returns end its lines".to_owned()),
                (
                    head.lines_before > 0,
                    format!("{} lines with text stand before the header row", head.lines_before),
                ),
                (!head.units.is_empty(), "a row of units stands under the headers".to_owned()),
            ])
            .filter_map(|(applies, text)| applies.then_some(text))
            .collect();
        (!texts.is_empty()).then(|| format!("{}: {}", self.file, texts.join(", ")))
    }

    fn end(&mut self) -> Result<Option<Row>, RecordingError> {
        let (file, comments) = (&self.file, std::mem::take(&mut self.comments));
        if comments > 0 {
            self.warnings.push(format!("{file}: {comments} lines that begin with # were left out"));
        }
        if self.rows == 0 {
            return Err(RecordingError::NoRows { file: self.file.clone() });
        }
        Ok(None)
    }

    fn leave_out_torn(&mut self) {
        self.torn += 1;
        let (file, line) = (&self.file, self.cells.line());
        self.warnings.push(format!("{file}: the last row (line {line}) is torn and was left out"));
    }

    fn time_column(&self) -> String {
        let names = time_of(&self.columns)
            .map(|column| column.cells.iter().map(|cell| &*self.head.headers[cell.field]));
        names.map_or_else(String::new, |names| names.collect::<Vec<_>>().join("+"))
    }

    /// Fills a row with the present line, and returns its stamp; `None` for a blank line, a comment, and a row of separators only, as
    /// spreadsheets write them.
    fn take(&mut self, out: &mut Row) -> Result<Option<Stamp>, RecordingError> {
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
        if self.cells.count() != self.head.headers.len() && !self.fits() {
            let (found, expected) = (self.cells.count(), self.head.headers.len());
            if self.cells.iter().all(str::is_empty) {
                return Ok(None);
            }
            return Err(self.wrong(RowProblem::FieldCount { found, expected }));
        }
        let mut checksum = 0_u64;
        let mut empty = true;
        let mut problem = None;
        let Self { cells, columns, head, numbers, missing, clock, .. } = self;
        let mut present = Line { cells, head, numbers, missing };
        for column in columns {
            let value = if column.is_clock() {
                present.stamp(column, clock)
            } else {
                present.product(column)
            };
            let value = match value {
                Ok(value) => value,
                Err(found) => {
                    problem = Some(found);
                    break;
                }
            };
            checksum =
                (checksum.rotate_left(5) ^ value.to_bits()).wrapping_mul(0x517c_c1b7_2722_0a95);
            if let Some(channel) = column.target {
                empty &= value.is_nan();
                out.set(channel, Some(value));
            } else {
                out.time_s = value;
            }
        }
        if let Some(problem) = problem {
            return Err(self.wrong(problem));
        }
        if out.time_s.is_nan() {
            if empty {
                return Ok(None);
            }
            return Err(self.wrong(RowProblem::TimeMissing { column: self.time_column() }));
        }
        if self.in_run_folder {
            if let Some(before_s) = self.last_s
                && out.time_s <= before_s
            {
                let remedy = cut(self.rows, line);
                let time_s = out.time_s;
                return Err(self.wrong(RowProblem::TimeNotIncreasing { time_s, before_s, remedy }));
            }
            self.last_s = Some(out.time_s);
        }
        if let Some(field) = self.quality_field {
            self.cells.get(field).clone_into(&mut out.quality);
        }
        self.check_unit()?;
        Ok(Some(Stamp { time_s: out.time_s, checksum, line, row: self.lines }))
    }

    /// Whether the cells that are more or fewer than the headers are empty or have no name, as where each line ends with a
    /// separator.
    fn fits(&self) -> bool {
        let (cells, headers) = (self.cells.count(), &self.head.headers);
        self.cells.iter().skip(headers.len()).all(str::is_empty)
            && headers.iter().skip(cells).all(String::is_empty)
    }

    fn wrong(&self, problem: RowProblem) -> RecordingError {
        let (file, row, line) = (self.file.clone(), self.lines, self.cells.line());
        RecordingError::Row { file, row, line, problem }
    }

    /// Stamps that can be no seconds, although no factor is given.
    fn check_unit(&self) -> Result<(), RecordingError> {
        let Clock::Numbers(clock) = &self.clock else { return Ok(()) };
        let time = time_of(&self.columns).filter(|column| {
            clock.count == 2 && !column.scaled && (column.factor - 1.0).abs() <= 0.0
        });
        let Some(column) = time else { return Ok(()) };
        let first = clock.first();
        let Some(unit) = unit_of_stamps(first[0], first[1] - first[0]) else { return Ok(()) };
        let column = self.head.headers[column.cells[0].field].clone();
        Err(RecordingError::TimeUnit { file: self.file.clone(), column, first, unit })
    }

    /// A line that cannot be read: left out where the header row stands again, else the error with the reason that the
    /// lines around it show.
    fn explain(&mut self, error: RecordingError) -> Result<(), RecordingError> {
        let RecordingError::Row { file, row, line, problem } = error else { return Err(error) };
        if !self.in_run_folder && self.cells.iter().eq(self.head.headers.iter().map(|name| &**name))
        {
            self.lines -= 1;
            self.headers_again.0 += 1;
            if self.headers_again.0 == 1 {
                self.headers_again.1 = line;
            }
            return Ok(());
        }
        let problem = if self.cells.iter().any(|cell| cell.contains('\0')) {
            RowProblem::Nul
        } else if self.has_stamp() || matches!(problem, RowProblem::TimeMissing { .. }) {
            problem
        } else if self.lines == 1 && !self.has_numbers() {
            RowProblem::SecondHeader
        } else if self.rows > 0 && !self.data_follow() {
            RowProblem::Footer
        } else {
            problem
        };
        Err(RecordingError::Row { file, row, line, problem })
    }

    /// Whether the time of the present line can be read.
    fn has_stamp(&self) -> bool {
        let time = time_of(&self.columns);
        let text = time.map(|column| stamp_text(&self.cells, column)).unwrap_or_default();
        match &self.clock {
            Clock::Text(clock) => clock.clone().seconds(&text).is_some(),
            // An infinite or missing number is a fault of its row.
            _ => {
                text.parse::<f64>().is_ok()
                    || !text.is_empty() && self.numbers.clone().number(&text).is_ok()
            }
        }
    }

    /// Whether a quantity on the present line is a number.
    fn has_numbers(&self) -> bool {
        let mut numbers = self.numbers.clone();
        let mut cells = self.columns.iter().flat_map(|column| &column.cells);
        cells.any(|cell| {
            cell.field < self.cells.count()
                && numbers.number(self.cells.get(cell.field)).is_ok_and(f64::is_finite)
        })
    }

    /// Whether a line behind this one has a time; far enough to tell a block of text from a torn row.
    fn data_follow(&mut self) -> bool {
        for _ in 0..10_000 {
            match self.cells.next_line() {
                Ok(false) => return false,
                Ok(true) if self.has_stamp() => return true,
                Ok(true) | Err(_) => {}
            }
        }
        true
    }

    /// The error of a fall of the time, with what mends it.
    fn refused(&mut self, fall: &Fall) -> RecordingError {
        let Fall { time_s, before_s, line, row, in_order } = *fall;
        let remedy = if self.sorting_mends() {
            Remedy::Sort { column: self.time_column() }
        } else {
            cut(in_order, line)
        };
        let problem = RowProblem::TimeNotIncreasing { time_s, before_s, remedy };
        RecordingError::Row { file: self.file.clone(), row, line, problem }
    }

    /// Whether the stamps of the whole file rise in usual steps once they are sorted; not known where there are many.
    fn sorting_mends(&mut self) -> bool {
        let Some(mut stamps) = self.axis.stamps() else { return false };
        let mut row = Row::at(f64::NAN);
        while !self.is_over && stamps.len() < 1 << 20 {
            match self.cells.next_line() {
                Ok(false) => self.is_over = true,
                Ok(true) => {
                    stamps.extend(self.take(&mut row).ok().flatten().map(|stamp| stamp.time_s));
                }
                Err(_) => return false,
            }
        }
        stamps.sort_by(f64::total_cmp);
        let steps: Vec<f64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let most_s = 8.0 * median(&steps);
        self.is_over && steps.len() > 2 && steps.iter().all(|step| *step > 0.0 && *step <= most_s)
    }
}

/// The present line with what its cells are read by.
struct Line<'a, R> {
    cells: &'a Cells<R>,
    head: &'a Head,
    numbers: &'a mut NumberFormat,
    missing: &'a MissingValues,
}

impl<R: Read> Line<'_, R> {
    /// A cell as a number, NaN where it is missing.
    #[inline]
    fn number(&mut self, text: &str) -> Result<f64, NoNumber> {
        if self.missing.is_empty() {
            return self.numbers.number(text);
        }
        if self.missing.has_text(text) {
            return Ok(f64::NAN);
        }
        let value = self.numbers.number(text)?;
        Ok(if self.missing.has_number(value) { f64::NAN } else { value })
    }

    /// The product of the cells of a column.
    fn product(&mut self, column: &mut Column) -> Result<f64, RowProblem> {
        let (line, head) = (self.cells, self.head);
        let mut value = column.factor;
        for Cell { field, sign } in &mut column.cells {
            let text = line.get(*field);
            let number = self
                .number(text)
                .map_err(|form| RowProblem::not_a_number(&head.headers[*field], text, form))?;
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
        let value = value + column.offset;
        if value.abs() > LARGEST {
            return Err(too_large(value, &head.headers[column.cells[0].field]));
        }
        Ok(value)
    }

    /// The time of the present line, from a number or a text.
    fn stamp(&mut self, column: &Column, clock: &mut Clock) -> Result<f64, RowProblem> {
        let (cells, head) = (self.cells, self.head);
        let text = stamp_text(cells, column);
        let name = &head.headers[column.cells[0].field];
        let not_a_time = || RowProblem::not_a_time(name, &text);
        if let Clock::Text(clock) = clock {
            if text.is_empty() || self.missing.has_text(&text) {
                return Ok(f64::NAN);
            }
            return Ok(clock.seconds(&text).ok_or_else(not_a_time)? + column.offset);
        }
        let number = if column.is_date_and_clock && !text.is_empty() {
            Err(NoNumber::Text)
        } else {
            self.number(&text)
        };
        match number {
            Ok(value) if value.is_nan() => Ok(value),
            Ok(value) => {
                if matches!(clock, Clock::Open) {
                    *clock = Clock::Numbers(NumberClock::default());
                }
                let value = match clock {
                    // An offset gives the origin.
                    Clock::Numbers(clock) if column.offset.abs() <= 0.0 => {
                        clock.relative(&text, value, column.factor)
                    }
                    _ => value,
                };
                let value = value * column.factor + column.offset;
                if value.abs() > LARGEST { Err(too_large(value, name)) } else { Ok(value) }
            }
            Err(form) => {
                let mut texts = TextClock::default();
                match texts.seconds(&text).filter(|_| matches!(clock, Clock::Open)) {
                    Some(_) if (column.factor - 1.0).abs() > 0.0 => {
                        Err(RowProblem::FactorOfStamp {
                            column: name.clone(),
                            text: text.into_owned(),
                        })
                    }
                    Some(seconds) => {
                        *clock = Clock::Text(texts);
                        Ok(seconds + column.offset)
                    }
                    None if matches!(clock, Clock::Open) || form == NoNumber::Text => {
                        Err(not_a_time())
                    }
                    None => Err(RowProblem::not_a_number(name, &text, form)),
                }
            }
        }
    }
}

fn time_of(columns: &[Column]) -> Option<&Column> {
    columns.iter().find(|column| column.target.is_none())
}

/// The time cells of the present line, joined by a blank.
#[inline]
fn stamp_text<'a, R: Read>(cells: &'a Cells<R>, column: &Column) -> Cow<'a, str> {
    let cell = |cell: &Cell| if cell.field < cells.count() { cells.get(cell.field) } else { "" };
    match &column.cells[..] {
        [date, clock] => Cow::Owned(format!("{} {}", cell(date), cell(clock)).trim().to_owned()),
        cells => Cow::Borrowed(cells.first().map_or("", cell)),
    }
}

/// The rows before a fall, if they are worth it.
fn cut(in_order: usize, line: usize) -> Remedy {
    if in_order < 16 { Remedy::Column } else { Remedy::Cut { line: line - 1 } }
}

#[cold]
fn too_large(value: f64, column: &str) -> RowProblem {
    RowProblem::TooLarge { column: column.to_owned(), value }
}

/// Counters that the stamps may be.
fn counters(clock: &Clock, columns: &[Column]) -> Vec<Counter> {
    let (factor, offset) = time_of(columns).map_or((1.0, 0.0), |time| (time.factor, time.offset));
    let mut counters = match clock {
        Clock::Numbers(clock) if clock.origin().is_none() => Counter::all(factor),
        Clock::Text(clock) => clock.counters(),
        _ => Vec::new(),
    };
    for counter in &mut counters {
        counter.least_s += offset;
    }
    counters
}

/// Takes the decimal mark from the first rows: a comma may stand before the number that shows what it is.
fn learn<R: BufRead>(
    cells: &Cells<R>,
    head: &Head,
    columns: &[Column],
    numbers: &mut NumberFormat,
) {
    let ahead = cells.ahead();
    let is_comma_possible = ahead.contains(&if head.separator == b',' { b'"' } else { b',' });
    let Some(end) = ahead.iter().rposition(|byte| *byte == b'\n').filter(|_| is_comma_possible)
    else {
        return;
    };
    let mut rows = Cells::new(ahead[..=end].to_vec(), io::empty(), head.lines());
    while let Ok(true) = rows.next_line() {
        if rows.get(0).starts_with('#') {
            continue;
        }
        for cell in columns.iter().flat_map(|column| &column.cells) {
            if cell.field < rows.count() {
                numbers.learn(rows.get(cell.field));
            }
        }
    }
}

#[cfg(test)]
#[path = "csv_read_tests.rs"]
mod tests;

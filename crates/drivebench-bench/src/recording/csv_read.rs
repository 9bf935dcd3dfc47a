//! Any CSV (RFC 4180, with dialects) row by row into rows and runs.
//!
//! ```text
//! text -> head (byte order mark, sep= line, header row) -> Dialect, Columns
//!      -> csv::Reader: cells of one line -> rules of a row -> Row -> Run
//! ```
//!
//! The memory does not grow with the file. A quoted cell holds no line break, so that a torn line never swallows others:
//! the csv reader ignores quotes, and a line with quotes is split once more.

use std::io::{self, BufRead, Read, Seek, SeekFrom};

use super::error::RowProblem;
use super::{ColumnMap, Factor, RecordingError, Row};
use drivebench_model::config_text::nearest;
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

/// The length of the whole rows of a record, and whether a torn one follows. Every row ends with a line feed, so a last row
/// without one is torn even if it can be read: `1.2` may have been `1.25`.
pub(super) fn whole_rows(text: &mut (impl Read + Seek)) -> io::Result<(u64, bool)> {
    let end = text.seek(SeekFrom::End(0))?;
    let mut whole = end;
    let mut block = Vec::new();
    while whole > 0 {
        let from = whole.saturating_sub(4096);
        text.seek(SeekFrom::Start(from))?;
        block.clear();
        text.by_ref().take(whole - from).read_to_end(&mut block)?;
        let line_end = block.iter().rposition(|byte| *byte == b'\n');
        whole = from + line_end.map_or(0, |at| at as u64 + 1);
        if line_end.is_some() {
            break;
        }
    }
    text.seek(SeekFrom::Start(0))?;
    Ok((whole, whole < end))
}

/// Own columns that are no quantity.
const BOOKKEEPING: [&str; 4] = ["host_time_s", "seq", "status", QUALITY];
/// The one of them that is kept.
const QUALITY: &str = "quality";
/// Longest row, bytes: it bounds the memory.
const LONGEST_LINE: u64 = 1 << 20;

/// One column of the run: the product of some cells and `factor`, plus `offset`.
struct Column {
    target: Option<Channel>,
    cells: Vec<Cell>,
    factor: f64,
    offset: f64,
}

struct Cell {
    field: usize,
    /// Only the sign of the cell counts: that of its last value that was not zero, +1 before there is one.
    sign: Option<f64>,
}

/// The lines after the header, each split into its cells.
struct Cells<R> {
    reader: csv::Reader<Bounded<R>>,
    separator: u8,
    record: csv::StringRecord,
    /// Lines up to the header.
    lines_before: u64,
}

/// Fails where a line is too long.
struct Bounded<R> {
    inner: R,
    /// Bytes since the last line feed.
    length: u64,
    is_over: bool,
}

impl<R: Read> Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = loop {
            match self.inner.read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => break read?,
            }
        };
        let feed = buffer[..count].iter().rposition(|byte| *byte == b'\n');
        let open = count - feed.map_or(0, |at| at + 1);
        self.length = open as u64 + if feed.is_some() { 0 } else { self.length };
        self.is_over = count == 0;
        if self.length > LONGEST_LINE {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        Ok(count)
    }
}

/// A line that cannot be split into cells.
enum LineError {
    Io(io::Error),
    TooLong,
    NotUtf8,
    Quote,
}

impl From<csv::Error> for LineError {
    fn from(error: csv::Error) -> Self {
        match error.into_kind() {
            csv::ErrorKind::Io(error) if error.kind() == io::ErrorKind::FileTooLarge => {
                Self::TooLong
            }
            csv::ErrorKind::Io(error) => Self::Io(error),
            csv::ErrorKind::Utf8 { .. } => Self::NotUtf8,
            // Rows of any length are allowed.
            _ => Self::Quote,
        }
    }
}

impl<R: BufRead> Cells<R> {
    fn behind_header(inner: R, separator: u8, lines_before: u64) -> Self {
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .quoting(false)
            .delimiter(separator)
            .terminator(csv::Terminator::Any(b'\n'))
            .buffer_capacity(1 << 16)
            .from_reader(Bounded { inner, length: 0, is_over: false });
        Self { reader, separator, record: csv::StringRecord::new(), lines_before }
    }

    /// Reads the next line that is not blank; `false` at the end of the file.
    fn next_line(&mut self) -> Result<bool, LineError> {
        if !self.reader.read_record(&mut self.record)? {
            return Ok(false);
        }
        if self.record.as_slice().contains('"') {
            let separator = char::from(self.separator).to_string();
            let line = self.record.iter().collect::<Vec<_>>().join(&separator);
            let (cells, is_joined) = quoted_cells(&line, self.separator)?;
            if is_joined {
                return Err(LineError::Quote);
            }
            self.record = cells.into();
        }
        Ok(true)
    }

    /// The line is the last and has no line feed.
    fn is_open(&self) -> bool {
        self.reader.get_ref().is_over
    }

    /// Number of the line in the file; at its end of the one that would follow.
    fn line(&self) -> usize {
        let line = self.lines_before + self.reader.position().line() - u64::from(!self.is_open());
        usize::try_from(line).unwrap_or(usize::MAX)
    }

    /// A cell without blanks at its ends.
    fn get(&self, field: usize) -> &str {
        self.record[field].trim()
    }
}

/// The next line with its line end; 0 at the end of the file.
fn read_line(reader: &mut impl BufRead, line: &mut Vec<u8>) -> Result<usize, LineError> {
    let mut limited = reader.take(LONGEST_LINE);
    let count = limited.read_until(b'\n', line).map_err(LineError::Io)?;
    if limited.limit() == 0 && line.last() != Some(&b'\n') {
        return Err(LineError::TooLong);
    }
    Ok(count)
}

/// The cells of a line with quotes, and whether text follows a closed quote, which belongs to the cell then: `"1"2`.
fn quoted_cells(line: &str, separator: u8) -> Result<(Vec<String>, bool), LineError> {
    let separator = char::from(separator);
    let (mut cells, mut is_joined) = (Vec::new(), false);
    let mut rest = line;
    loop {
        let mut cell = String::new();
        if let Some(mut quoted) = rest.strip_prefix('"') {
            loop {
                let (part, behind) = quoted.split_once('"').ok_or(LineError::Quote)?;
                cell.push_str(part);
                let Some(more) = behind.strip_prefix('"') else {
                    rest = behind;
                    break;
                };
                (cell, quoted) = (cell + "\"", more);
            }
            let behind = rest.split(separator).next().unwrap_or_default();
            is_joined |= !behind.trim_matches([' ', '\t', '\r']).is_empty();
        }
        let end = rest.find(separator);
        cell.push_str(&rest[..end.unwrap_or(rest.len())]);
        cells.push(cell);
        match end {
            Some(at) => rest = &rest[at + 1..],
            None => return Ok((cells, is_joined)),
        }
    }
}

/// Separator and decimal mark of a file.
struct Dialect {
    separator: u8,
    /// The decimal mark, once a number has one; always a point where the comma is the separator.
    decimal: Option<u8>,
    has_mark: bool,
    has_sep_line: bool,
}

impl Dialect {
    /// NaN for a missing cell; `None` for what is neither missing nor a finite number.
    fn number(&mut self, cell: &str) -> Option<f64> {
        let finite = |text: &str| text.parse().ok().filter(|value: &f64| !value.is_infinite());
        if cell.is_empty() {
            return Some(f64::NAN);
        }
        if self.separator != b','
            && let Some(mark) = cell.bytes().find(|byte| matches!(byte, b',' | b'.'))
        {
            if *self.decimal.get_or_insert(mark) != mark {
                return None;
            }
            if mark == b',' {
                return finite(&cell.replacen(',', ".", 1));
            }
        }
        finite(cell)
    }
}

/// Rows of a foreign file that were left out for their time.
#[derive(Default)]
struct Stamps {
    repeated: usize,
    backwards: usize,
    /// Of the first row that goes back.
    first: Option<RecordingError>,
}

impl Stamps {
    fn sentence(&self, file: &str) -> Option<String> {
        let (repeated, backwards) = (self.repeated, self.backwards);
        let all = repeated + backwards;
        (all > 0).then(|| {
            format!(
                "{file}: {all} rows whose time is not after that of the row before were left out: {repeated} repeat it, {backwards} go back"
            )
        })
    }
}

/// The rows of a CSV in order. Empty and `NaN` cells are missing; in foreign files lines that begin with `#` are comments.
///
/// A torn last row is left out, counted and warned of, and so are rows of a foreign file whose time is not after that of
/// the row before; any other row that cannot be read is an error with its number.
pub struct CsvRows<R> {
    cells: Cells<R>,
    file: String,
    headers: Vec<String>,
    columns: Vec<Column>,
    /// The `quality` column, of our own files only.
    quality_field: Option<usize>,
    is_mapped: bool,
    in_run_folder: bool,
    dialect: Dialect,
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
    pub fn new(
        mut reader: R,
        file: &str,
        options: ReadOptions<'_>,
    ) -> Result<Self, RecordingError> {
        let mut items = options.map.map_or(&[][..], ColumnMap::items).iter();
        let time = items.find(|item| item.target.is_none());
        let time = time.map_or("time_s", |item| item.header.as_str());
        let (headers, dialect, lines_before) = head(&mut reader, file, time)?;
        let mut warnings = Vec::new();
        let columns = match options.map {
            Some(map) => columns_by_map(&headers, map, file)?,
            None => columns_of_our_own(&headers, file, &mut warnings)?,
        };
        let quality_field = headers.iter().position(|header| header == QUALITY);
        Ok(Self {
            cells: Cells::behind_header(reader, dialect.separator, lines_before),
            file: file.to_owned(),
            quality_field: quality_field.filter(|_| options.map.is_none()),
            headers,
            columns,
            is_mapped: options.map.is_some(),
            in_run_folder: options.in_run_folder,
            dialect,
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
        let Dialect { separator, decimal, .. } = self.dialect;
        let name = match separator {
            b'\t' => "a tab".to_owned(),
            other => format!("{:?}", char::from(other)),
        };
        let differences = [
            (separator != b',', &*format!("{name} separates the cells")),
            (decimal == Some(b','), "numbers have a decimal comma"),
            (self.dialect.has_sep_line, "a sep= line names the separator"),
            (self.dialect.has_mark, "it begins with a byte order mark"),
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
        if self.cells.record.len() == 1 && first.is_empty() {
            return Ok(None);
        }
        if first.starts_with('#') && !self.in_run_folder {
            self.comments += 1;
            return Ok(None);
        }
        self.lines += 1;
        let (file, row, headers) = (&self.file, self.lines, &self.headers);
        let wrong = |problem| RecordingError::Row { file: file.clone(), row, line, problem };
        if self.cells.record.len() != headers.len() {
            return Err(wrong(RowProblem::FieldCount {
                found: self.cells.record.len(),
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
                let Some(number) = self.dialect.number(cell) else {
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

fn at_line(error: &LineError, file: &str, line: usize) -> RecordingError {
    let file = file.to_owned();
    match error {
        LineError::Io(error) => {
            RecordingError::Io { path: file, doing: "read", reason: error.to_string() }
        }
        // It has not been counted.
        LineError::TooLong => {
            RecordingError::LineTooLong { file, line: line + 1, most: LONGEST_LINE }
        }
        LineError::NotUtf8 => RecordingError::NotUtf8 { file, line },
        LineError::Quote => RecordingError::Quote { file, line },
    }
}

/// Headers, dialect, and number of the header row: the first line that is neither blank nor a comment. A line that begins with
/// `#` but has the time column is a header, as some tools write it.
fn head(
    reader: &mut impl BufRead,
    file: &str,
    time: &str,
) -> Result<(Vec<String>, Dialect, u64), RecordingError> {
    let mut dialect =
        Dialect { separator: b',', decimal: None, has_mark: false, has_sep_line: false };
    // The first with which the file has its time column.
    let mut separators = vec![b',', b';', b'\t'];
    let mut bytes = Vec::new();
    for lines in 1.. {
        bytes.clear();
        let before = usize::try_from(lines - 1).unwrap_or(usize::MAX);
        let count = read_line(reader, &mut bytes).map_err(|error| at_line(&error, file, before))?;
        if count == 0 {
            break;
        }
        if lines == 1 && bytes.starts_with(b"\xef\xbb\xbf") {
            bytes.drain(..3);
            dialect.has_mark = true;
        }
        let text = bytes.trim_ascii();
        if text.is_empty() {
            continue;
        }
        if lines == 1
            && text.len() == 5
            && text[..4].eq_ignore_ascii_case(b"sep=")
            && text[4].is_ascii_punctuation()
        {
            separators = vec![text[4]];
            dialect.has_sep_line = true;
            continue;
        }
        let is_comment = text[0] == b'#';
        let split = |separator: &u8| headers(text, *separator, lines, file);
        let found = match separators.iter().map(split).collect::<Result<Vec<_>, _>>() {
            Err(_) if is_comment => continue,
            found => found?,
        };
        let with_time = found.iter().position(|names| names.iter().any(|name| name == time));
        if is_comment && with_time.is_none() {
            continue;
        }
        let longest = found.iter().map(Vec::len).max();
        let most = found.iter().position(|names| Some(names.len()) == longest);
        let chosen = with_time.or(most).unwrap_or_default();
        dialect.separator = separators[chosen];
        return Ok((found.into_iter().nth(chosen).unwrap_or_default(), dialect, lines));
    }
    Err(RecordingError::Empty { file: file.to_owned() })
}

fn headers(
    text: &[u8],
    separator: u8,
    line: u64,
    file: &str,
) -> Result<Vec<String>, RecordingError> {
    let line = usize::try_from(line).unwrap_or(usize::MAX);
    // With a separator that is not that of the file, text may follow a closed quote.
    let (cells, _) = std::str::from_utf8(text)
        .map_err(|_| LineError::NotUtf8)
        .and_then(|text| quoted_cells(text, separator))
        .map_err(|error| at_line(&error, file, line))?;
    Ok(cells.iter().map(|name| name.trim().to_owned()).collect())
}

fn columns_by_map(
    headers: &[String],
    map: &ColumnMap,
    file: &str,
) -> Result<Vec<Column>, RecordingError> {
    let cell = |name: &str, sign| -> Result<Cell, RecordingError> {
        Ok(Cell { field: field_of(headers, name, file)?, sign })
    };
    let columns = map.items().iter().map(|item| {
        // A header may contain a star itself.
        let cells = if headers.contains(&item.header) {
            vec![cell(&item.header, None)?]
        } else {
            let cells = item.columns.iter().map(|factor| match factor {
                Factor::Column(name) => cell(name, None),
                Factor::SignOf(name) => cell(name, Some(1.0)),
            });
            cells.collect::<Result<_, RecordingError>>()?
        };
        Ok(Column { target: item.target, cells, factor: item.factor, offset: item.offset })
    });
    columns.collect()
}

fn columns_of_our_own(
    headers: &[String],
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<Vec<Column>, RecordingError> {
    let plain = |header, target| {
        let field = field_of(headers, header, file)?;
        Ok(Column { target, cells: vec![Cell { field, sign: None }], factor: 1.0, offset: 0.0 })
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

fn field_of(headers: &[String], header: &str, file: &str) -> Result<usize, RecordingError> {
    let fields: Vec<usize> = (0..headers.len()).filter(|field| headers[*field] == header).collect();
    let (file, header) = (file.to_owned(), header.to_owned());
    match (fields.first(), fields.len()) {
        (Some(field), 1) => Ok(*field),
        (Some(_), count) => Err(RecordingError::AmbiguousHeader { file, header, count }),
        (None, _) => {
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

#[cfg(test)]
#[path = "csv_read_tests.rs"]
mod tests;

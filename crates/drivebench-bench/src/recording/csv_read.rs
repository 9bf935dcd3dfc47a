//! Any CSV, row by row, into rows and runs.
//!
//! ```text
//! text -> head (byte order mark, sep= line, header row) -> Dialect, Wanted columns
//!      -> csv::Reader: cells of one line -> rules of a row -> Row -> Run
//! ```
//!
//! The memory does not grow with the file. A quoted cell holds no line break, so that a torn line never swallows others:
//! the reader takes quotes as they are, and only a line that has some is parted once more.

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
    /// It stands in a run folder: the writer ended every row with a line feed and wrote no remarks.
    pub in_run_folder: bool,
}

/// Reads a whole CSV by the rules of [`CsvRows`]. Returns the run and warnings for the reader.
pub fn read_csv(
    reader: impl BufRead,
    file: &str,
    options: ReadOptions<'_>,
) -> Result<(Run, Vec<String>), RecordingError> {
    let mut rows = CsvRows::new(reader, file, options)?;
    let run = collect(&mut rows, file, options.map.is_none())?;
    Ok((run, rows.warnings()))
}

/// All rows as columns. A column without a single value is no column. Commands are commands in our own files; in a
/// foreign one nobody has said where a signal comes from.
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

/// Looks at the end of a record first: the length of its whole rows, and whether a torn one follows. Its writer ends every
/// row with a line feed, so a last row without one is torn even if it can be read: `1.2` may have been `1.25`.
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

/// Columns of ours that are no quantity; they are read past.
const BOOKKEEPING: [&str; 4] = ["host_time_s", "seq", "status", QUALITY];
/// The one of them whose remarks are kept.
const QUALITY: &str = "quality";
/// Between the cells of a file; the first with which the file has its time column.
const SEPARATORS: [u8; 3] = [b',', b';', b'\t'];
/// A line that is longer is no row, bytes: the memory stays small whatever a file holds.
const LONGEST_LINE: u64 = 1 << 20;
/// Of the reader, bytes.
const BUFFER: usize = 1 << 16;
/// Share of the rows of a foreign file that may go back in time; beyond it the column is no time.
const MOST_BACKWARDS_SHARE: f64 = 0.1;

/// One column that is wanted: the product of some cells, `factor` and `offset`.
struct Wanted {
    target: Option<Channel>,
    cells: Vec<Cell>,
    factor: f64,
    offset: f64,
}

struct Cell {
    field: usize,
    /// Only the sign counts: that of the last value that was not zero, until there is one +1.
    sign: Option<f64>,
}

/// The lines behind the header, one at a time, each parted into its cells.
struct Cells<R> {
    reader: csv::Reader<Bounded<R>>,
    separator: u8,
    record: csv::StringRecord,
    /// Lines up to the header.
    lines_before: u64,
}

/// Ends with an error where a file goes on without a line feed.
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

/// Why a line has no cells.
enum Unparted {
    Io(io::Error),
    TooLong,
    NotUtf8,
    Quote,
}

impl From<csv::Error> for Unparted {
    fn from(error: csv::Error) -> Self {
        match error.into_kind() {
            csv::ErrorKind::Io(error) if error.kind() == io::ErrorKind::FileTooLarge => {
                Self::TooLong
            }
            csv::ErrorKind::Io(error) => Self::Io(error),
            csv::ErrorKind::Utf8 { .. } => Self::NotUtf8,
            // A reader of rows of any length has no other.
            _ => Self::Quote,
        }
    }
}

impl<R: BufRead> Cells<R> {
    fn behind_header(inner: R, separator: u8, lines_before: u64) -> Self {
        let bounded = Bounded { inner, length: 0, is_over: false };
        let mut builder = csv::ReaderBuilder::new();
        builder.has_headers(false).flexible(true).quoting(false);
        builder.delimiter(separator);
        builder.terminator(csv::Terminator::Any(b'\n'));
        builder.buffer_capacity(BUFFER);
        Self {
            reader: builder.from_reader(bounded),
            separator,
            record: csv::StringRecord::new(),
            lines_before,
        }
    }

    /// Goes to the next line that is not blank; `false` at the end of the file.
    fn next_line(&mut self) -> Result<bool, Unparted> {
        if !self.reader.read_record(&mut self.record)? {
            return Ok(false);
        }
        if self.record.as_slice().contains('"') {
            let separator = char::from(self.separator).to_string();
            let line = self.record.iter().collect::<Vec<_>>().join(&separator);
            let (cells, is_joined) = quoted_cells(&line, self.separator)?;
            if is_joined {
                return Err(Unparted::Quote);
            }
            self.record = cells.into();
        }
        Ok(true)
    }

    /// The line does not end with a line feed: the file ends with it.
    fn is_open(&self) -> bool {
        self.reader.get_ref().is_over
    }

    /// Number of the line in the file; at its end of the one that would follow.
    fn line(&self) -> u64 {
        self.lines_before + self.reader.position().line() - u64::from(!self.is_open())
    }

    /// A cell without the blanks around it.
    fn get(&self, field: usize) -> &str {
        self.record[field].trim()
    }
}

/// The next line with its line end; 0 at the end of the file.
fn read_line(reader: &mut impl BufRead, line: &mut Vec<u8>) -> Result<usize, Unparted> {
    let mut limited = reader.take(LONGEST_LINE);
    let count = limited.read_until(b'\n', line).map_err(Unparted::Io)?;
    if limited.limit() == 0 && line.last() != Some(&b'\n') {
        return Err(Unparted::TooLong);
    }
    Ok(count)
}

/// The cells of a line with quotes, and whether text follows a closed quote, which belongs to the cell then: `"1"2`.
fn quoted_cells(line: &str, separator: u8) -> Result<(Vec<String>, bool), Unparted> {
    let separator = char::from(separator);
    let (mut cells, mut is_joined) = (Vec::new(), false);
    let mut rest = line;
    loop {
        let mut cell = String::new();
        if let Some(mut quoted) = rest.strip_prefix('"') {
            loop {
                let (part, behind) = quoted.split_once('"').ok_or(Unparted::Quote)?;
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

/// How a file departs from comma and decimal point.
struct Dialect {
    separator: u8,
    /// What stands before the decimals, once a number has shown it; always a point where the comma parts the cells.
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
    /// What is wrong with the first that goes back.
    first: Option<RecordingError>,
}

impl Stamps {
    fn sentence(&self, file: &str) -> Option<String> {
        let (repeated, backwards) = (self.repeated, self.backwards);
        (repeated + backwards > 0).then(|| {
            format!(
                "{file}: {} rows whose time is not after that of the row before were left out: {repeated} repeat it, {backwards} go back",
                repeated + backwards
            )
        })
    }
}

/// The rows of a CSV in order. Empty and `NaN` cells are missing; in foreign files lines that begin with `#` are left out.
///
/// A torn last row is left out, counted and warned of, and so are rows of a foreign file whose time is not after that of
/// the row before; a row that cannot be read anywhere else is an error with its number.
pub struct CsvRows<R> {
    cells: Cells<R>,
    file: String,
    headers: Vec<String>,
    wanted: Vec<Wanted>,
    /// Where our own remarks stand; a foreign column of that name is none of ours.
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
        let wanted = match options.map {
            Some(map) => wanted_by_map(&headers, map, file)?,
            None => wanted_of_our_own(&headers, file, &mut warnings)?,
        };
        let quality_field = headers.iter().position(|header| header == QUALITY);
        Ok(Self {
            cells: Cells::behind_header(reader, dialect.separator, lines_before),
            file: file.to_owned(),
            quality_field: quality_field.filter(|_| options.map.is_none()),
            headers,
            wanted,
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

    /// The next row, with its quantities and, in our own files, the remarks on them; `None` at the end of the file.
    pub fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        loop {
            let taken = match self.cells.next_line() {
                Ok(false) => break,
                Ok(true) => self.take(),
                Err(why) => Err(unparted(&why, &self.file, self.line())),
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
                    self.leave_out_torn(self.line());
                }
            }
        }
        if std::mem::take(&mut self.ends_torn) {
            self.leave_out_torn(self.line());
        }
        let comments = std::mem::take(&mut self.comments);
        if comments > 0 {
            let file = &self.file;
            let text = format!("{file}: {comments} lines that begin with # were left out");
            self.warnings.push(text);
        }
        if self.rows == 0 {
            return Err(RecordingError::NoRows { file: self.file.clone() });
        }
        let too_many = self.stamps.backwards as f64 > MOST_BACKWARDS_SHARE * self.rows as f64;
        match self.stamps.first.take() {
            Some(error) if too_many => Err(error),
            _ => Ok(None),
        }
    }

    /// The channels that the file has a column for; each cell of it may still be missing.
    pub fn channels(&self) -> impl Iterator<Item = Channel> + '_ {
        self.wanted.iter().filter_map(|wanted| wanted.target)
    }

    /// Rows given out so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Rows that were left out because they are torn or for their time.
    pub fn rows_dropped(&self) -> usize {
        self.rows_dropped
    }

    /// Sentences for the reader; complete after the last row.
    pub fn warnings(&self) -> Vec<String> {
        let stamps = self.stamps.sentence(&self.file);
        self.warnings.iter().cloned().chain(stamps).collect()
    }

    /// How the file departs from comma and decimal point, where it does; complete after the last row.
    pub fn dialect(&self) -> Option<String> {
        let Dialect { separator, decimal, .. } = self.dialect;
        let name = if separator == b'\t' {
            "a tab".to_owned()
        } else {
            format!("{:?}", char::from(separator))
        };
        let departures = [
            (separator != b',', &*format!("{name} parts the cells")),
            (decimal == Some(b','), "numbers have a decimal comma"),
            (self.dialect.has_sep_line, "a sep= line names the separator"),
            (self.dialect.has_mark, "it begins with a byte order mark"),
        ];
        let there = departures.iter().filter(|(is_there, _)| *is_there);
        let texts: Vec<&str> = there.map(|(_, text)| *text).collect();
        (!texts.is_empty()).then(|| format!("{}: {}", self.file, texts.join(", ")))
    }

    fn leave_out_torn(&mut self, line: usize) {
        self.rows_dropped += 1;
        let file = &self.file;
        let text = format!("{file}: the last row (line {line}) is torn and was left out");
        self.warnings.push(text);
    }

    /// Number of the line that was read last; at the end of the file of the one that would follow.
    fn line(&self) -> usize {
        usize::try_from(self.cells.line()).unwrap_or(usize::MAX)
    }

    /// The present line as a row; `None` for a blank line, a remark, a row of separators only, as spreadsheets leave them
    /// behind, and one whose time is left out.
    fn take(&mut self) -> Result<Option<Row>, RecordingError> {
        let line = self.line();
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
        for wanted in &mut self.wanted {
            let mut value = wanted.factor;
            for Cell { field, sign } in &mut wanted.cells {
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
            value += wanted.offset;
            if value.abs() > LARGEST {
                let column = headers[wanted.cells[0].field].clone();
                return Err(wrong(RowProblem::TooLarge { column, value }));
            }
            if let Some(channel) = wanted.target {
                empty &= value.is_nan();
                out.set(channel, Some(value));
            } else {
                out.time_s = value;
                time_column = wanted.cells[0].field;
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

fn unparted(why: &Unparted, file: &str, line: usize) -> RecordingError {
    let file = file.to_owned();
    match why {
        Unparted::Io(error) => {
            RecordingError::Io { path: file, doing: "read", reason: error.to_string() }
        }
        // It has not been counted.
        Unparted::TooLong => {
            RecordingError::LineTooLong { file, line: line + 1, most: LONGEST_LINE }
        }
        Unparted::NotUtf8 => RecordingError::NotUtf8 { file, line },
        Unparted::Quote => RecordingError::Quote { file, line },
    }
}

/// Headers, dialect, and number of the header row: the first line that is neither blank nor a remark. A line that begins with
/// `#` but has the time column is a header, as some tools write it.
fn head(
    reader: &mut impl BufRead,
    file: &str,
    time: &str,
) -> Result<(Vec<String>, Dialect, u64), RecordingError> {
    let mut dialect =
        Dialect { separator: b',', decimal: None, has_mark: false, has_sep_line: false };
    let mut separators = SEPARATORS.to_vec();
    let mut bytes = Vec::new();
    for lines in 1.. {
        bytes.clear();
        let before = usize::try_from(lines - 1).unwrap_or(usize::MAX);
        let count = read_line(reader, &mut bytes);
        let count = count.map_err(|why| unparted(&why, file, before))?;
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
        let is_remark = text[0] == b'#';
        let of = |separator: &u8| headers(text, *separator, lines, file);
        let found = match separators.iter().map(of).collect::<Result<Vec<_>, _>>() {
            Err(_) if is_remark => continue,
            found => found?,
        };
        let has_time = |names: &Vec<String>| names.iter().any(|name| name == time);
        let with_time = found.iter().position(has_time);
        if is_remark && with_time.is_none() {
            continue;
        }
        let most = found.iter().map(Vec::len).max();
        let most = found.iter().position(|names| Some(names.len()) == most);
        let chosen = with_time.or(most).unwrap_or_default();
        dialect.separator = separators[chosen];
        let headers = found.into_iter().nth(chosen).unwrap_or_default();
        return Ok((headers, dialect, lines));
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
    let text = std::str::from_utf8(text).map_err(|_| Unparted::NotUtf8);
    // Under a separator that is none of the file's own, text may well follow a closed quote.
    let cells = text.and_then(|text| quoted_cells(text, separator));
    let (cells, _) = cells.map_err(|why| unparted(&why, file, line))?;
    Ok(cells.iter().map(|name| name.trim().to_owned()).collect())
}

fn wanted_by_map(
    headers: &[String],
    map: &ColumnMap,
    file: &str,
) -> Result<Vec<Wanted>, RecordingError> {
    let cell = |name: &str, sign| -> Result<Cell, RecordingError> {
        let field = field_of(headers, name, file)?;
        Ok(Cell { field, sign })
    };
    let mut wanted = Vec::new();
    for item in map.items() {
        // A header may hold a star itself.
        let is_one = headers.contains(&item.header);
        let cells = item.columns.iter().map(|factor| match factor {
            Factor::Column(name) => cell(name, None),
            Factor::SignOf(name) => cell(name, Some(1.0)),
        });
        wanted.push(Wanted {
            target: item.target,
            cells: if is_one {
                vec![cell(&item.header, None)?]
            } else {
                cells.collect::<Result<_, _>>()?
            },
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
    let plain = |header, target| {
        let field = field_of(headers, header, file)?;
        Ok(Wanted { target, cells: vec![Cell { field, sign: None }], factor: 1.0, offset: 0.0 })
    };
    let mut wanted = vec![plain("time_s", None)?];
    let mut ignored = Vec::new();
    for header in headers {
        if let Some(channel) = Channel::from_key(header) {
            wanted.push(plain(header, Some(channel))?);
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
    let fields: Vec<usize> = (0..headers.len()).filter(|field| headers[*field] == header).collect();
    let (file, header) = (file.to_owned(), header.to_owned());
    match (fields.first(), fields.len()) {
        (Some(field), 1) => Ok(*field),
        (Some(_), count) => Err(RecordingError::AmbiguousHeader { file, header, count }),
        (None, _) => {
            let names = headers.iter().map(String::as_str);
            let near = nearest(&header, names.filter(|name| !name.is_empty()));
            let near = near.map_or_else(String::new, |name| format!("did you mean {name:?}? "));
            Err(RecordingError::HeaderNotFound { file, header, help: near + &map_help(headers) })
        }
    }
}

/// What is in the file, and how to say which column is which.
fn map_help(headers: &[String]) -> String {
    let there: Vec<String> = headers.iter().map(|name| format!("{name:?}")).collect();
    format!("the file has {}; name them with --map 'time_s=HEADER,...'", there.join(", "))
}

#[cfg(test)]
#[path = "csv_read_tests.rs"]
mod tests;

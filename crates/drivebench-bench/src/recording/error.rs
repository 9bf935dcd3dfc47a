//! Errors of recorded data; every message names the thing, the value and what is allowed.

use std::path::Path;

use thiserror::Error;

use super::csv_number::NoNumber;
use super::csv_time::is_date;
use drivebench_identify::sanity::{ColumnUnit, is_unit};
use drivebench_model::sample::{LARGEST, RunError};

/// What mends a time that is not increasing.
#[derive(Clone, Debug, PartialEq)]
pub enum Remedy {
    /// Sorted by this column, all rows are in order.
    Sort { column: String },
    /// The rows up to this line are in order.
    Cut { line: usize },
    /// Another column is the time.
    Column,
}

/// Error of a row of a CSV; the text follows the row's number.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RowProblem {
    #[error(": time {time_s} s is not after {before_s} s (time must be strictly increasing)")]
    TimeNotIncreasing { time_s: f64, before_s: f64, remedy: Remedy },
    #[error(": no time in column {column:?}")]
    TimeMissing { column: String },
    #[error(": {found} cells, the header has {expected}")]
    FieldCount { found: usize, expected: usize },
    #[error(
        ", column {column:?}: {text:?} is not a number (allowed: a finite number with a decimal point, NaN or an empty cell)"
    )]
    NotANumber { column: String, text: String, form: NoNumber },
    #[error(
        ", column {column:?}: {text:?} is neither a number nor a date and time (read are 1.5, 2024-05-06T11:59:55.002, 06.05.2024 11:59:55, 11:59:55.5, 1:02:03 PM and the like)"
    )]
    NotATime { column: String, text: String },
    #[error(
        ", column {column:?}: {text:?} is a date or a clock, which is read in seconds, and the map gives it a factor"
    )]
    FactorOfStamp { column: String, text: String },
    #[error(", column {column:?}: {value:e} is not allowed (expected a size up to {LARGEST:e})")]
    TooLarge { column: String, value: f64 },
    #[error(": NUL bytes, as a write that was cut off leaves them behind")]
    Nul,
    #[error(": a second row of texts under the header row, in which no known unit stands")]
    SecondHeader,
    #[error(": here a block of text after the data begins")]
    Footer,
}

impl RowProblem {
    pub(super) fn not_a_number(column: &str, text: &str, form: NoNumber) -> Self {
        Self::NotANumber { column: column.to_owned(), text: excerpt(text), form }
    }

    pub(super) fn not_a_time(column: &str, text: &str) -> Self {
        Self::NotATime { column: column.to_owned(), text: excerpt(text) }
    }

    fn help(&self, row: usize, line: usize) -> String {
        let leave_out = || format!("sed '{line}d' FILE > whole.csv leaves the row out");
        match self {
            Self::TimeNotIncreasing { remedy: Remedy::Sort { column }, .. } => {
                format!("sort the rows by column {column:?}: then all of them rise in usual steps")
            }
            Self::TimeNotIncreasing { remedy: Remedy::Cut { line }, .. } => {
                format!("the rows before it are in order: head -n {line} FILE > part.csv keeps them")
            }
            Self::TimeNotIncreasing { remedy: Remedy::Column, .. } => {
                "is this the time column? name another with --map time_s=HEADER".into()
            }
            Self::FieldCount { .. } if row == 1 => {
                "write one name for each cell of the rows into the header row; a line sep=; before it names another separator".into()
            }
            Self::Footer => format!("head -n {} FILE > data.csv keeps the data", line - 1),
            Self::TooLarge { .. } => CHECK_CELL.into(),
            Self::Nul => "tr -d '\\000' < FILE > whole.csv removes them".into(),
            Self::FactorOfStamp { column, .. } => {
                format!("write --map time_s={column} without a factor")
            }
            Self::NotATime { column, text } if is_date(text) => {
                format!("name the column of the clock too: --map 'time_s={column}+CLOCK'")
            }
            Self::NotATime { .. } if row == 1 => {
                "name a column of numbers, or of dates in one of these forms, with --map time_s=HEADER".into()
            }
            Self::NotATime { .. }
            | Self::TimeMissing { .. }
            | Self::FieldCount { .. }
            | Self::SecondHeader => leave_out(),
            Self::NotANumber { text, form, .. } => help_for_text(text, *form),
        }
    }
}

fn excerpt(text: &str) -> String {
    let begin: String = text.chars().take(60).collect();
    if begin.len() < text.len() { begin + "..." } else { begin }
}

/// What to write instead of a text that is no number.
fn help_for_text(text: &str, form: NoNumber) -> String {
    let digits = text.trim_start_matches(['+', '-']);
    let number = digits.find(|c: char| !(c.is_ascii_digit() || ".,".contains(c)));
    let (number, unit) = digits.split_at(number.unwrap_or(digits.len()));
    match form {
        NoNumber::OtherMark => "write the cell with the decimal mark of the others".into(),
        NoNumber::Ambiguous => {
            let (thousands, decimals) = (text.replace(',', ""), text.replace(',', "."));
            format!(
                "write {thousands} if the comma parts thousands, {decimals} if it is the decimal mark"
            )
        }
        NoNumber::Text if text.starts_with("0x") => "write the number in decimal digits".into(),
        NoNumber::Text if !number.is_empty() && is_unit(unit) => {
            format!("write the numbers without their unit {:?}", unit.trim())
        }
        NoNumber::Text if text.contains(':') && !number.is_empty() => {
            "is this the column of the time? name it with --map time_s=HEADER".into()
        }
        // What one argument of a shell holds.
        NoNumber::Text if text.contains(['\'', '"']) || text.ends_with("...") => {
            "leave a missing value empty or write NaN".into()
        }
        NoNumber::Text => {
            let item = if text.contains(',') { format!("\"{text}\"") } else { text.to_owned() };
            format!("if it stands for a missing value, --missing '{item}' reads it so")
        }
    }
}

const CHECK_CELL: &str = "check the cell and the unit of its column; leave a damaged cell empty";

#[derive(Clone, Debug, Error, PartialEq)]
pub enum RecordingError {
    #[error("{path}: cannot {doing}: {reason}")]
    Io { path: String, doing: &'static str, reason: String },
    #[error("{path}: a folder of {runs} runs and none itself")]
    FolderOfRuns { path: String, runs: usize, latest: String },
    #[error("{path}: a folder without a samples.csv, which is no run")]
    NoRun { path: String },
    #[error("--map: {item:?}: {reason}")]
    Map { item: String, reason: String },
    #[error("--map: unknown target {target:?}")]
    UnknownTarget { target: String, help: String },
    #[error("--map: no item for time_s, which every run needs")]
    MapWithoutTime,
    #[error("{file}: no column {header:?} in the header")]
    HeaderNotFound { file: String, header: String, help: String },
    #[error("{file}: {count} columns are called {header:?}, exactly one is needed")]
    AmbiguousHeader { file: String, header: String, count: usize },
    #[error("{file}: no known column beside time_s")]
    NoKnownColumn { file: String, help: String },
    #[error("{file}: row {row} (line {line}){problem}")]
    Row { file: String, row: usize, line: usize, problem: RowProblem },
    #[error(
        "{file}: line {line}: a double quote is not closed on its line, or text follows a closed one"
    )]
    Quote { file: String, line: usize },
    #[error("{file}: line {line}: the text is not UTF-8")]
    NotUtf8 { file: String, line: usize },
    #[error("{file}: the text is UTF-16, and UTF-8 is read")]
    Utf16 { file: String, encoding: &'static str },
    #[error("{file}: this is {form}, and no text table")]
    NotText { file: String, form: &'static str },
    #[error("{file}: there is no header row: numbers stand in line {line}")]
    NoHeader { file: String, line: u64, names: String },
    #[error("{file}: no line is left behind the {skip} that --skip leaves out")]
    SkippedAll { file: String, skip: usize },
    #[error(
        "{file}: column {column:?} is in {}, not in s: its first values are {} and {}", unit.name, first[0], first[1]
    )]
    TimeUnit { file: String, column: String, first: [f64; 2], unit: ColumnUnit },
    #[error("{file}: line {line} is longer than {most} bytes, the most that a row may have")]
    LineTooLong { file: String, line: usize, most: u64 },
    #[error("{file}: the file is empty (a header row and data rows are needed)")]
    Empty { file: String },
    #[error("{file}: a header but no data row")]
    NoRows { file: String },
    #[error("{file}: {source}")]
    Run { file: String, source: RunError },
    #[error("{path}: the writer thread of the recorder is gone")]
    WriterGone { path: String },
}

impl RecordingError {
    pub fn help(&self) -> String {
        match self {
            Self::UnknownTarget { help, .. }
            | Self::HeaderNotFound { help, .. }
            | Self::NoKnownColumn { help, .. } => help.clone(),
            Self::Io { doing: "open", .. } => {
                "check the path; `drivebench` without arguments lists the runs in this folder".into()
            }
            Self::Io { .. } => "check the path, its permissions and the space on the disk".into(),
            Self::Map { .. } => {
                "the form is --map 'target=header[*factor][+offset],...', where a factor is a number, another header or sign(HEADER); put a header with , * or + in double quotes; a negative offset is +-3".into()
            }
            Self::FolderOfRuns { latest, .. } => format!("did you mean the latest of them, {latest}?"),
            Self::NoRun { .. } => {
                "a run is a folder that `drivebench run` made, its samples.csv, or a CSV file with --map".into()
            }
            Self::MapWithoutTime => "add time_s=HEADER, for instance time_s=t".into(),
            Self::AmbiguousHeader { .. } => "rename one of the columns in the file".into(),
            Self::Row { problem, row, line, .. } => problem.help(*row, *line),
            Self::Quote { .. } => "a quoted cell must begin and end on one line, with nothing but its separator after it".into(),
            Self::LineTooLong { .. } => "rows end with a line feed; is this a text file?".into(),
            Self::NotUtf8 { .. } => {
                "iconv -f WINDOWS-1252 -t UTF-8 FILE > utf8.csv converts a text of Western Europe".into()
            }
            Self::Utf16 { encoding, .. } => {
                format!("iconv -f {encoding} -t UTF-8 FILE > utf8.csv converts it")
            }
            Self::NotText { .. } => "export or unpack it as a text table (CSV)".into(),
            Self::NoHeader { line, names, .. } => {
                format!("write names before it, as sed '{line}i {names}' FILE > named.csv does")
            }
            Self::SkippedAll { .. } => "--skip counts the lines before the header row".into(),
            Self::TimeUnit { column, unit, .. } => {
                format!("convert it with --map time_s={column}*{}", unit.factor)
            }
            Self::Empty { .. } | Self::NoRows { .. } => {
                "nothing was recorded; give another run".into()
            }
            Self::Run { source: RunError::Absurd { .. }, .. } => CHECK_CELL.into(),
            Self::Run { .. } => "time must grow from row to row, and every row needs a cell for every column".into(),
            Self::WriterGone { .. } => "the run is unfinished; its rows so far are on disk".into(),
        }
    }

    pub(crate) fn io(path: &Path, doing: &'static str, error: &std::io::Error) -> Self {
        Self::Io { path: path.display().to_string(), doing, reason: error.to_string() }
    }
}

//! Errors of recorded data; every message names the thing, the value and what is allowed.

use std::path::Path;

use thiserror::Error;

use drivebench_model::sample::{LARGEST, RunError};

/// Error of a row of a CSV; the text follows the row's number.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RowProblem {
    #[error(": time {time_s} s is not after {before_s} s (time must be strictly increasing)")]
    TimeNotIncreasing { time_s: f64, before_s: f64 },
    #[error(": no time in column {column:?}")]
    TimeMissing { column: String },
    #[error(": {found} cells, the header has {expected}")]
    FieldCount { found: usize, expected: usize },
    #[error(
        ", column {column:?}: {text:?} is not a number (allowed: a finite number with a decimal point, NaN or an empty cell)"
    )]
    NotANumber { column: String, text: String },
    #[error(", column {column:?}: {value:e} is not allowed (expected a size up to {LARGEST:e})")]
    TooLarge { column: String, value: f64 },
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
    /// The next step for the reader.
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
            Self::Row { problem, .. } => match problem {
                RowProblem::TimeNotIncreasing { .. } => "sort the rows by time and remove repeated ones; is this the time column?",
                RowProblem::TimeMissing { .. } => "remove the row or give it a time",
                RowProblem::FieldCount { .. } => "only the last row of a file may be torn; a separator other than the comma, or a decimal comma, also looks like this",
                RowProblem::TooLarge { .. } => CHECK_CELL,
                RowProblem::NotANumber { .. } => "leave a missing value empty or write NaN; numbers have a decimal point and no unit",
            }
            .into(),
            Self::Quote { .. } => "a quoted cell must begin and end on one line, with nothing but its separator after it".into(),
            Self::LineTooLong { .. } => "rows end with a line feed; is this a text file?".into(),
            Self::NotUtf8 { .. } => "save the file as CSV in UTF-8".into(),
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

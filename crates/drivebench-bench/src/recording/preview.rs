//! The columns of a foreign file before they are mapped: headers, units, first texts, numbers.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use super::csv_cells::at_line;
use super::csv_head::read_head;
use super::csv_number::NumberFormat;
use super::csv_time::{TextClock, is_date};
use super::{MissingValues, ReadOptions, RecordingError};

#[derive(Clone, Debug, Default)]
pub struct Preview {
    pub headers: Vec<String>,
    /// What the row of units below the headers has for each column; empty where there is none.
    pub units: Vec<String>,
    /// Lines of text before the headers.
    pub lines_before: usize,
    /// All rows of the file.
    pub rows: usize,
    /// Distance of the rows that `columns` hold: 1 in a short file, a power of two in a long one.
    pub stride: usize,
    pub columns: Vec<PreviewColumn>,
}

#[derive(Clone, Debug, Default)]
pub struct PreviewColumn {
    /// One number for each row that is kept; NaN where the cell holds none. Dates and clocks are seconds.
    pub numbers: Vec<f64>,
    /// The cells are clocks, with a date or without.
    pub is_clock: bool,
    /// The cells are dates without a clock.
    pub is_date: bool,
    clock: TextClock,
}

/// Rows that are kept at most, evenly spread over the file.
const MOST_ROWS: usize = 20_000;
/// Columns that are looked at, and their cells, which bound the memory.
const MOST_COLUMNS: usize = 2_000;
const MOST_CELLS: usize = 4_000_000;

/// Looks at a file of any headers; the options as for reading it. `known` counts the headers of a line that are known together.
pub fn preview(
    path: &Path,
    options: ReadOptions<'_>,
    known: impl Fn(&[String]) -> usize,
) -> Result<Preview, RecordingError> {
    let file = File::open(path).map_err(|error| RecordingError::io(path, "open", &error))?;
    read_preview(BufReader::new(file), &path.display().to_string(), options, known)
}

/// The same of a text; `file` stands in errors.
pub fn read_preview(
    reader: impl std::io::Read,
    file: &str,
    options: ReadOptions<'_>,
    known: impl Fn(&[String]) -> usize,
) -> Result<Preview, RecordingError> {
    let (mut head, mut cells) = read_head(reader, file, options.skip, known)?;
    head.refuse_numbers(file)?;
    head.headers.truncate(MOST_COLUMNS);
    let most_rows = (MOST_CELLS / head.headers.len().max(1)).min(MOST_ROWS);
    let mut numbers = NumberFormat::new();
    let missing = options.missing.cloned().unwrap_or_default();
    let mut preview = Preview {
        lines_before: head.lines_before,
        stride: 1,
        columns: vec![PreviewColumn::default(); head.headers.len()],
        units: head.units,
        headers: head.headers,
        ..Preview::default()
    };
    while cells.next_line().map_err(|error| at_line(&error, file, cells.line()))? {
        if cells.get(0).starts_with('#') {
            continue;
        }
        let is_kept = preview.rows.is_multiple_of(preview.stride);
        if is_kept {
            let mut all = cells.iter();
            for column in &mut preview.columns {
                column.push(all.next().unwrap_or_default(), &mut numbers, &missing);
            }
        }
        preview.rows += 1;
        if is_kept && preview.columns.first().is_some_and(|c| c.numbers.len() >= most_rows) {
            preview.keep_every_second();
        }
    }
    if preview.rows == 0 {
        return Err(RecordingError::NoRows { file: file.to_owned() });
    }
    Ok(preview)
}

impl PreviewColumn {
    fn push(&mut self, cell: &str, numbers: &mut NumberFormat, missing: &MissingValues) {
        numbers.learn(cell);
        let number = match numbers.number(cell) {
            _ if missing.has_text(cell) => None,
            Ok(number) => Some(number).filter(|number| !missing.has_number(*number)),
            Err(_) => {
                let seconds = self.clock.seconds(cell);
                self.is_clock |= seconds.is_some();
                self.is_date |= seconds.is_none() && self.numbers.is_empty() && is_date(cell);
                seconds
            }
        };
        self.numbers.push(number.unwrap_or(f64::NAN));
    }
}

impl Preview {
    fn keep_every_second(&mut self) {
        self.stride *= 2;
        for column in &mut self.columns {
            let mut is_even = false;
            column.numbers.retain(|_| {
                is_even = !is_even;
                is_even
            });
        }
    }
}

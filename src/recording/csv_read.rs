//! Any CSV into a [`Run`].

use std::io::BufRead;

use super::{ColumnMap, CsvRows, RecordingError};
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

/// Reads a whole CSV by the rules of [`CsvRows`]. Returns the run and warnings for the reader.
pub fn read_csv(
    reader: impl BufRead,
    file: &str,
    options: ReadOptions<'_>,
) -> Result<(Run, Vec<String>), RecordingError> {
    let mut rows = CsvRows::new(reader, file, options)?;
    let run = collect(&mut rows, file, options.map.is_none())?;
    Ok((run, rows.warnings().to_vec()))
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
    let wrap = |source| RecordingError::Run {
        file: file.to_owned(),
        source,
    };
    let mut run = Run::new(file, time_s).map_err(wrap)?;
    for (channel, column) in channels.into_iter().zip(columns) {
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
    run.set_limited_rows(limited_rows);
    run.rows_dropped = rows.rows_dropped();
    if run.column(Channel::Speed).is_none() && run.column(Channel::Angle).is_some() {
        run.notes.push(format!(
            "{file}: speed_rad_s is absent, angle_rad is there: speed has to be derived from it"
        ));
    }
    Ok(run)
}

#[cfg(test)]
#[path = "csv_read_tests.rs"]
mod tests;

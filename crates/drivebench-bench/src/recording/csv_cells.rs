//! Lines of a text table, each split into its cells (RFC 4180, any separator of one byte).
//!
//! The memory does not grow with the file: a line has at most [`LONGEST_LINE`] bytes. A quoted cell holds no line break, so
//! that a torn line never swallows others: the csv reader ignores quotes, and a line with quotes is split once more.

use std::io::{self, Chain, Cursor, Read, Seek, SeekFrom};

use super::RecordingError;

/// Longest row, bytes.
pub(super) const LONGEST_LINE: u64 = 1 << 20;

/// How the lines of a table are written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lines {
    pub separator: u8,
    /// They end with carriage returns alone.
    pub has_carriage_returns: bool,
    /// Lines of the file before the first of them.
    pub before: u64,
}

/// The lines behind the head, each split into its cells.
pub(super) struct Cells<R> {
    reader: csv::Reader<Bounded<Chain<Cursor<Vec<u8>>, R>>>,
    separator: u8,
    record: csv::StringRecord,
    /// Lines up to here.
    lines_before: u64,
}

/// Fails where a line is too long.
struct Bounded<R> {
    inner: R,
    /// Lines end with carriage returns alone, which are read as line feeds.
    has_carriage_returns: bool,
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
        if self.has_carriage_returns {
            feed_for_return(&mut buffer[..count]);
        }
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

pub(super) fn feed_for_return(bytes: &mut [u8]) {
    bytes.iter_mut().filter(|byte| **byte == b'\r').for_each(|byte| *byte = b'\n');
}

/// A line that cannot be split into cells.
pub(super) enum LineError {
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

impl<R: Read> Cells<R> {
    /// Lines of `ahead`, which was read before, then of `inner`.
    pub(super) fn new(ahead: Vec<u8>, inner: R, lines: Lines) -> Self {
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .quoting(false)
            .delimiter(lines.separator)
            .terminator(csv::Terminator::Any(b'\n'))
            .buffer_capacity(1 << 16)
            .from_reader(Bounded {
                inner: Cursor::new(ahead).chain(inner),
                has_carriage_returns: lines.has_carriage_returns,
                length: 0,
                is_over: false,
            });
        Self {
            reader,
            separator: lines.separator,
            record: csv::StringRecord::new(),
            lines_before: lines.before,
        }
    }

    /// What was read before.
    pub(super) fn ahead(&self) -> &[u8] {
        self.reader.get_ref().inner.get_ref().0.get_ref()
    }

    /// Reads the next line that is not blank; `false` at the end of the file.
    pub(super) fn next_line(&mut self) -> Result<bool, LineError> {
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
    pub(super) fn is_open(&self) -> bool {
        self.reader.get_ref().is_over
    }

    /// Number of the line in the file; at its end of the one that would follow.
    pub(super) fn line(&self) -> usize {
        let line = self.lines_before + self.reader.position().line() - u64::from(!self.is_open());
        usize::try_from(line).unwrap_or(usize::MAX)
    }

    /// Cells of the present line.
    pub(super) fn count(&self) -> usize {
        self.record.len()
    }

    /// Cells of the present line.
    pub(super) fn iter(&self) -> impl Iterator<Item = &str> {
        self.record.iter().map(str::trim)
    }

    /// A cell of the present line, without blanks at its ends.
    #[inline]
    pub(super) fn get(&self, field: usize) -> &str {
        let cell = &self.record[field];
        // The usual cell begins and ends with a printed character.
        match cell.as_bytes() {
            [b'!'..=b'~', .., b'!'..=b'~'] | [b'!'..=b'~'] => cell,
            _ => cell.trim(),
        }
    }
}

/// The cells of a line with quotes, and whether text follows a closed quote, which belongs to the cell then: `"1"2`.
pub(super) fn quoted_cells(line: &str, separator: u8) -> Result<(Vec<String>, bool), LineError> {
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

pub(super) fn at_line(error: &LineError, file: &str, line: usize) -> RecordingError {
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

//! Head of a text table: byte order mark, `sep=` line, comments, header row; from it the separator.

use std::io::BufRead;

use super::RecordingError;
use super::csv_cells::{Cells, LineError, at_line, quoted_cells, read_line};

/// The head of a table.
#[derive(Clone, Debug, Default)]
pub(super) struct Head {
    /// One name for each column, as it stands there, without blanks and quotes around it.
    pub headers: Vec<String>,
    pub separator: u8,
    pub has_mark: bool,
    pub has_sep_line: bool,
    /// Number of the line with the headers, from 1.
    pub line: u64,
}

/// Reads to the end of the header row: the first line that is neither blank nor a comment. Of comma, semicolon and tab the
/// separator is the first with which the row has the column `time`, else that which gives most columns. A line that begins
/// with `#` but has the time column is a header, as some tools write it.
///
/// Returns the head, and the lines behind it split at its separator. `file` stands in errors.
pub(super) fn read_head<R: BufRead>(
    mut reader: R,
    file: &str,
    time: &str,
) -> Result<(Head, Cells<R>), RecordingError> {
    let head = head(&mut reader, file, time)?;
    let cells = Cells::behind_header(reader, head.separator, head.line);
    Ok((head, cells))
}

fn head(reader: &mut impl BufRead, file: &str, time: &str) -> Result<Head, RecordingError> {
    let mut head = Head::default();
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
            head.has_mark = true;
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
            head.has_sep_line = true;
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
        head.separator = separators[chosen];
        head.headers = found.into_iter().nth(chosen).unwrap_or_default();
        head.line = lines;
        return Ok(head);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_split_at_commas_outside_of_quotes() {
        let cells = |line: &str| headers(format!("{line}\n").as_bytes(), b',', 1, "f");
        for (line, expected) in [
            ("a,b", vec!["a", "b"]),
            (",", vec!["", ""]),
            (" a , b ", vec!["a", "b"]),
            (r#""a,b",c"#, vec!["a,b", "c"]),
            (r#""say ""x""" , 1"#, vec![r#"say "x""#, "1"]),
            ("Torque (N\u{b7}m),x", vec!["Torque (N\u{b7}m)", "x"]),
            (r#"5" pipe,1"#, vec![r#"5" pipe"#, "1"]),
        ] {
            assert_eq!(cells(line).unwrap(), expected, "{line}");
        }
        for open in [r#"a,"b"#, r#""a"""#] {
            assert!(matches!(cells(open).unwrap_err(), RecordingError::Quote { .. }), "{open}");
        }
    }
}

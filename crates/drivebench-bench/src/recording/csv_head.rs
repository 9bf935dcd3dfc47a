//! Head of a text table: byte order mark, `sep=` line, lines before the header, header row, row of units; from it the separator.
//!
//! ```text
//! first bytes -> encoding, line ends -> lines -> header row: where the wanted names stand,
//!                                                else above the first rows of numbers with as many cells,
//!                                                else the first line
//! ```

use std::io::{self, Read};

use super::RecordingError;
use super::csv_cells::{
    Cells, LONGEST_LINE, LineError, Lines, at_line, feed_for_return, quoted_cells,
};
use drivebench_identify::sanity::is_unit;

#[derive(Clone, Debug, Default)]
pub(super) struct Head {
    /// One name for each column, as it stands there, without blanks and quotes around it.
    pub headers: Vec<String>,
    /// The row of units under the headers, one cell for each column; empty where there is none.
    pub units: Vec<String>,
    pub separator: u8,
    pub has_mark: bool,
    pub has_sep_line: bool,
    /// Lines end with carriage returns alone.
    pub has_carriage_returns: bool,
    /// Lines with text before the header row that are neither comments nor a `sep=` line.
    pub lines_before: usize,
    /// Number of the line with the headers, from 1.
    pub line: u64,
    /// Number of the last line of the head: that of the headers, or of the row of units.
    pub data_line: u64,
}

/// Lines among which the header row is looked for.
const MOST_LINES: usize = 200;
/// Forms of other files: first bytes, and what they are.
const NO_TEXT: [(&[u8], &str); 5] = [
    (b"PK\x03\x04", "a ZIP archive, as an .xlsx workbook is"),
    (b"\x1f\x8b", "compressed with gzip"),
    (b"PAR1", "a Parquet file"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MATLAB 5.0 MAT-file", "a MAT-file"),
];

impl Head {
    /// The lines behind it.
    pub(super) const fn lines(&self) -> Lines {
        let Self { separator, has_carriage_returns, data_line: before, .. } = *self;
        Lines { separator, has_carriage_returns, before }
    }

    /// Numbers are no names: the header row is missing.
    pub(super) fn refuse_numbers(&self, file: &str) -> Result<(), RecordingError> {
        let are_numbers = self.headers.iter().any(|name| is_datum(name))
            && self.headers.iter().all(|name| name.is_empty() || is_datum(name));
        if !are_numbers {
            return Ok(());
        }
        let names: Vec<String> = (1..=self.headers.len()).map(|at| format!("c{at}")).collect();
        let separator = match self.separator {
            b'\t' => "\\t".to_owned(),
            other => char::from(other).to_string(),
        };
        let names = names.join(&separator);
        Err(RecordingError::NoHeader { file: file.to_owned(), line: self.line, names })
    }
}

/// Reads the head, and returns it with the lines behind it.
///
/// `skip`: lines before the header row, where they are known. `wanted` counts the wanted columns among headers, 0 where the
/// time is not among them: the header row is the first line with most of them. Where no line has one it is the first line
/// without numbers above rows of numbers with as many cells, else the first that is neither blank nor a comment. Of comma,
/// semicolon and tab the separator is the first that gives most wanted columns, else most columns. A line that begins with
/// `#` is a header only by its wanted names, or above numbers where no other is. `file` stands in errors.
pub(super) fn read_head<R: Read>(
    mut reader: R,
    file: &str,
    skip: Option<usize>,
    wanted: impl Fn(&[String]) -> usize,
) -> Result<(Head, Cells<R>), RecordingError> {
    let mut ahead = look_ahead(&mut reader, skip.unwrap_or(0) + 64)
        .map_err(|error| at_line(&LineError::Io(error), file, 0))?;
    refuse_other_forms(&ahead, file)?;
    let mut head = Head { has_mark: ahead.starts_with(b"\xef\xbb\xbf"), ..Head::default() };
    if head.has_mark {
        ahead.drain(..3);
    }
    head.has_carriage_returns = !ahead.contains(&b'\n') && ahead.contains(&b'\r');
    if head.has_carriage_returns {
        feed_for_return(&mut ahead);
    }
    let lines: Vec<&[u8]> = ahead.split_inclusive(|byte| *byte == b'\n').collect();
    if let Some(at) = lines.iter().position(|line| line.len() as u64 > LONGEST_LINE) {
        return Err(at_line(&LineError::TooLong, file, at));
    }
    let mut separators = vec![b',', b';', b'\t'];
    if let Some(separator) = lines.first().and_then(|line| separator_line(line)) {
        separators = vec![separator];
        head.has_sep_line = true;
    }
    let begin = skip.unwrap_or(0).max(usize::from(head.has_sep_line));
    let search = Search { lines: &lines, begin, separators: &separators };
    let found = search.by_names(wanted).or_else(|| search.by_numbers());
    let (at, separator) = match found {
        Some(found) => found,
        None => search.first(file)?,
    };
    head.headers = cells(lines[at], separator).map_err(|error| at_line(&error, file, at + 1))?;
    head.separator = separator;
    let is_left_out = |line: &&&[u8]| !is_blank(line) && !is_comment(line);
    head.lines_before =
        lines[usize::from(head.has_sep_line).min(at)..at].iter().filter(is_left_out).count();
    head.line = at as u64 + 1;
    let data = match search.units(at, separator, head.headers.len()) {
        Some((units, data)) => {
            head.units = units;
            data
        }
        None => at + 1,
    };
    head.data_line = data as u64;
    let length: usize = lines[..data].iter().map(|line| line.len()).sum();
    let rest = ahead.split_off(length);
    let cells = Cells::new(rest, reader, head.lines());
    Ok((head, cells))
}

/// The first 64 KiB, and more until they hold so many lines; never much more than the longest line.
fn look_ahead(reader: &mut impl Read, lines: usize) -> io::Result<Vec<u8>> {
    let block = 1 << 16;
    let mut ahead = Vec::new();
    loop {
        let count = reader.by_ref().take(block).read_to_end(&mut ahead)?;
        let ends = ahead.iter().filter(|byte| matches!(byte, b'\n' | b'\r')).count();
        if (count as u64) < block || ends >= lines || ahead.len() as u64 > LONGEST_LINE + block {
            return Ok(ahead);
        }
    }
}

/// Refuses what is no UTF-8 text by its first bytes.
fn refuse_other_forms(ahead: &[u8], file: &str) -> Result<(), RecordingError> {
    if let Some((_, form)) = NO_TEXT.iter().find(|(bytes, _)| ahead.starts_with(bytes)) {
        return Err(RecordingError::NotText { file: file.to_owned(), form });
    }
    let text = ahead.trim_ascii_start();
    let is_json = match text {
        [b'{', ..] => true,
        [b'[', rest @ ..] => rest.trim_ascii_start().starts_with(b"{"),
        _ => false,
    };
    if is_json {
        return Err(RecordingError::NotText { file: file.to_owned(), form: "a JSON file" });
    }
    // In Latin letters every second byte of UTF-16 is zero.
    let begin = &ahead[..ahead.len().min(512)];
    let zeros = |parity: usize| begin.iter().skip(parity).step_by(2).filter(|b| **b == 0).count();
    let (even, odd, half) = (zeros(0), zeros(1), begin.len() / 2);
    let encoding = if ahead.starts_with(b"\xff\xfe") || ahead.starts_with(b"\xfe\xff") {
        "UTF-16"
    } else if half > 4 && odd > half / 2 && even < half / 8 {
        "UTF-16LE"
    } else if half > 4 && even > half / 2 && odd < half / 8 {
        "UTF-16BE"
    } else {
        // Characters that no text has. A write that was cut off leaves zeros, which are errors of their rows.
        let is_control = |byte: &&u8| matches!(byte, 1..=8 | 14..=26 | 28..=31);
        let is_binary = 32 * begin.iter().filter(is_control).count() > begin.len();
        let form = "binary data";
        return if is_binary {
            Err(RecordingError::NotText { file: file.to_owned(), form })
        } else {
            Ok(())
        };
    };
    Err(RecordingError::Utf16 { file: file.to_owned(), encoding })
}

/// The separator of a `sep=` line, as spreadsheets write and read it.
fn separator_line(line: &[u8]) -> Option<u8> {
    let text = line.trim_ascii();
    // A tab was trimmed away.
    match text.len() {
        4 if text.eq_ignore_ascii_case(b"sep=") && line.contains(&b'\t') => Some(b'\t'),
        5 if text[..4].eq_ignore_ascii_case(b"sep=") && text[4].is_ascii_punctuation() => {
            Some(text[4])
        }
        _ => None,
    }
}

fn is_blank(line: &[u8]) -> bool {
    line.trim_ascii().is_empty()
}

fn is_comment(line: &[u8]) -> bool {
    line.trim_ascii_start().starts_with(b"#")
}

/// The cells of a line of the head, without blanks and quotes around them.
fn cells(line: &[u8], separator: u8) -> Result<Vec<String>, LineError> {
    // With a separator that is not that of the file, text may follow a closed quote.
    let text = std::str::from_utf8(line).map_err(|_| LineError::NotUtf8)?;
    let text = text.trim_matches([' ', '\r', '\n']);
    let (cells, _) = quoted_cells(text, separator)?;
    Ok(cells.iter().map(|name| name.trim().to_owned()).collect())
}

/// Whether a cell may be a number, a date or a time.
fn is_datum(cell: &str) -> bool {
    let digits = cell.trim_start_matches(['+', '-', '.', ',']);
    (digits.starts_with(|first: char| first.is_ascii_digit()) || cell.parse::<f64>().is_ok())
        && !is_unit(cell)
}

/// Cells of a row, without empty ones at its end.
fn filled(row: &[String]) -> usize {
    row.len() - row.iter().rev().take_while(|cell| cell.is_empty()).count()
}

/// The lines of the head, of which one is the header row.
struct Search<'a> {
    lines: &'a [&'a [u8]],
    /// The first that may be it.
    begin: usize,
    separators: &'a [u8],
}

impl Search<'_> {
    /// Lines that may be the header row: number from 0, and text.
    fn candidates(&self) -> impl Iterator<Item = (usize, &[u8])> + Clone {
        let lines = self.lines.iter().copied().enumerate();
        lines.skip(self.begin).take(MOST_LINES).filter(|(_, line)| !is_blank(line))
    }

    /// The first line with most wanted names.
    fn by_names(&self, wanted: impl Fn(&[String]) -> usize) -> Option<(usize, u8)> {
        let mut best = None;
        let mut most = 0;
        for (at, line) in self.candidates() {
            for separator in self.separators {
                let count = cells(line, *separator).map_or(0, |names| wanted(&names));
                if count > most {
                    (best, most) = (Some((at, *separator)), count);
                }
            }
        }
        best
    }

    /// The first line without numbers above rows of numbers with as many cells; of the separators that with most cells.
    fn by_numbers(&self) -> Option<(usize, u8)> {
        let lines: Vec<(usize, &[u8])> = self.candidates().collect();
        // Pairs of a name and a value, as they stand before a table, are numbers by half.
        for (only_numbers, may_be_comment) in
            [(true, false), (true, true), (false, false), (false, true)]
        {
            let mut best = None;
            let mut most = 1;
            for separator in self.separators {
                let rows =
                    lines.iter().map(|(_, line)| cells(line, *separator).unwrap_or_default());
                let rows: Vec<Vec<String>> = rows.collect();
                let found = (0..rows.len()).find(|at| {
                    (may_be_comment || !is_comment(lines[*at].1))
                        && is_above_numbers(&rows[*at..], only_numbers)
                });
                if let Some(at) = found
                    && filled(&rows[at]) > most
                {
                    (best, most) = (Some((lines[at].0, *separator)), filled(&rows[at]));
                }
            }
            if best.is_some() {
                return best;
            }
        }
        None
    }

    /// The first line that is no comment, with the separator that gives as many cells in most of the next lines, then most cells.
    fn first(&self, file: &str) -> Result<(usize, u8), RecordingError> {
        let Some((at, line)) = self.candidates().find(|(_, line)| !is_comment(line)) else {
            let file = file.to_owned();
            let is_skipped = self.begin > 1 && !self.lines.is_empty();
            return Err(if is_skipped {
                RecordingError::SkippedAll { file, skip: self.begin }
            } else {
                RecordingError::Empty { file }
            });
        };
        // The cells of the line, if some of the next lines have as many: a decimal comma does not stand in each.
        let split = |separator: &u8| -> Result<(usize, usize), LineError> {
            let count = cells(line, *separator)?.len();
            let next = self.lines[at + 1..].iter().take(8);
            let alike = next.filter(|line| {
                count > 1 && cells(line, *separator).is_ok_and(|cells| cells.len() == count)
            });
            Ok((alike.count(), count))
        };
        let counts = self.separators.iter().map(split).collect::<Result<Vec<_>, _>>();
        let counts = counts.map_err(|error| at_line(&error, file, at + 1))?;
        let most = counts.iter().max();
        let chosen = counts.iter().position(|count| Some(count) == most).unwrap_or_default();
        Ok((at, self.separators[chosen]))
    }

    /// The row of units among the rows of texts directly under the headers, and the number of lines up to the first row of
    /// numbers.
    fn units(&self, header: usize, separator: u8, columns: usize) -> Option<(Vec<String>, usize)> {
        let mut units = None;
        let under = self.lines.iter().enumerate().skip(header + 1);
        let mut under = under.filter(|(_, line)| !is_blank(line) && !is_comment(line)).take(4);
        under.find_map(|(at, line)| {
            let mut row = cells(line, separator).unwrap_or_default();
            // A row of units may end with the period, as that of an oscilloscope.
            let units_there = row.iter().filter(|cell| is_unit(cell)).count();
            let is_of_units = units_there > 1 && row.first().is_some_and(|cell| !is_datum(cell));
            if !is_of_units && row.iter().any(|cell| is_datum(cell)) {
                return Some(units.take().map(|units| (units, at)));
            }
            let fits = filled(&row) <= columns && filled(&row) > 0;
            if fits && units.is_none() && row.iter().any(|cell| is_unit(cell)) {
                row.resize(columns, String::new());
                units = Some(row);
            }
            None
        })?
    }
}

/// Whether the first row has no numbers, and of the next rows, which have as many cells, at most three are of text, as units
/// are, before rows of numbers.
fn is_above_numbers(rows: &[Vec<String>], only_numbers: bool) -> bool {
    let [header, under @ ..] = rows else { return false };
    let columns = filled(header);
    let fits = |row: &&Vec<String>| (columns..=header.len().max(columns + 1)).contains(&row.len());
    let data = header.iter().filter(|cell| is_datum(cell)).count();
    let is_of_numbers = |row: &[String]| {
        let all = row.iter().filter(|cell| !cell.is_empty()).count();
        let numbers = row.iter().filter(|cell| is_datum(cell)).count();
        numbers > 0 && numbers >= if only_numbers { all } else { all.div_ceil(2) }
    };
    if columns < 2 || 2 * data >= columns || header.iter().any(|cell| cell.parse::<f64>().is_ok()) {
        return false;
    }
    let texts = under.iter().take(3).take_while(|row| {
        fits(row) && filled(row) <= columns && !row.iter().any(|cell| is_datum(cell))
    });
    let numbers = &under[texts.count()..];
    let mut first = numbers.iter().take(2).peekable();
    first.peek().is_some() && first.all(|row| fits(&row) && is_of_numbers(row))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head_of(text: &str, skip: Option<usize>, time: &str) -> Result<Head, RecordingError> {
        let wanted = |names: &[String]| names.iter().filter(|name| *name == time).count();
        read_head(text.as_bytes(), "f", skip, wanted).map(|(head, _)| head)
    }

    #[test]
    fn cells_are_split_at_commas_outside_of_quotes() {
        let cells = |line: &str| cells(format!("{line}\n").as_bytes(), b',');
        for (line, expected) in [
            ("a,b", vec!["a", "b"]),
            (",", vec!["", ""]),
            (" a , b ", vec!["a", "b"]),
            (r#""a,b",c"#, vec!["a,b", "c"]),
            (r#""say ""x""" , 1"#, vec![r#"say "x""#, "1"]),
            ("Torque (N\u{b7}m),x", vec!["Torque (N\u{b7}m)", "x"]),
            (r#"5" pipe,1"#, vec![r#"5" pipe"#, "1"]),
        ] {
            assert_eq!(cells(line).ok().unwrap(), expected, "{line}");
        }
        for open in [r#"a,"b"#, r#""a"""#] {
            assert!(matches!(cells(open), Err(LineError::Quote)), "{open}");
        }
    }

    /// Line ends are written as `/`.
    #[test]
    fn the_header_row_is_found_behind_other_lines() {
        let scope =
            "Model,MSO44/Record Length,1000/Sample Interval,1e-6//TIME,CH1,CH2/s,V,A/0,1,2/1,2,3/";
        let report = "Report of the run/Date;06.05.2024/t;u;i/0,0;1,5;2/0,1;1,5;2/";
        let pico = "Time,Channel A,Channel B/(ms),(V),(mV)//0,1,2/1,2,3/";
        let two_rows = "t,u,i/s,V,A/double,double,double/0,1,2/";
        let quote = "made \"here\", \"there/t,u,i/0,1,2/1,1,2/";
        for (name, text, skip, time, line, columns, units, data_line) in [
            ("the first line", "t,u/0,1/", None, "t", 1, 2, "", 1),
            ("by its name", scope, None, "TIME", 5, 3, "s,V,A", 6),
            ("above numbers", scope, None, "none", 5, 3, "s,V,A", 6),
            ("decimal commas", report, None, "none", 3, 3, "", 3),
            ("units and a blank line", pico, None, "none", 1, 3, "(ms),(V),(mV)", 3),
            ("two rows of texts", two_rows, None, "t", 1, 3, "s,V,A", 3),
            ("by the lines before it", report, Some(2), "none", 3, 3, "", 3),
            ("a comment of numpy", "# a/# t,u/0,1/1,2/", None, "none", 2, 2, "", 2),
            ("an open quote before it", quote, None, "t", 2, 3, "", 2),
            ("no numbers at all", "a,b/c,d/", None, "t", 1, 2, "", 1),
            ("a row of missing values", "t,u/x,#N/A/0,1/", None, "t", 1, 2, "", 1),
        ] {
            let head = head_of(&text.replace("#N/A", "#NA").replace('/', "\n"), skip, time);
            let head = head.unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!((head.line, head.headers.len()), (line, columns), "{name}");
            assert_eq!(
                (head.units.join(","), head.data_line),
                (units.to_owned(), data_line),
                "{name}"
            );
        }
    }

    #[test]
    fn other_forms_are_refused_by_their_first_bytes() {
        let text = "time_s\tu\n0\t1\n";
        let units = |order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect();
        let (little, big): (Vec<u8>, Vec<u8>) = (units(u16::to_le_bytes), units(u16::to_be_bytes));
        let marked = [&b"\xff\xfe"[..], &little].concat();
        for (bytes, part) in [
            (&marked[..], "UTF-16"),
            (&little, "UTF-16LE"),
            (&big, "UTF-16BE"),
            (b"PK\x03\x04...", ".xlsx"),
            (b"\x1f\x8b\x08", "gzip"),
            (b"{\n \"t\": [0, 1]}", "a JSON file"),
            (b"[ {\"t\": 0}]", "a JSON file"),
            (&[b'a', 2, 0xE7, 19, 200, 7, 0, 1, 99], "binary data"),
        ] {
            let error = read_head(bytes, "f", None, |_| 0).err().unwrap();
            let text = format!("{error}: {}", error.help());
            assert!(text.contains(part), "{text}");
        }
    }
}

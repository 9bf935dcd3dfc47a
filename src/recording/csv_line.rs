//! One line of CSV into cells. A quoted cell may hold commas and doubled quotes but no line break: so a torn line can
//! never swallow the lines after it.

use std::borrow::Cow;

/// Byte ranges of the cells of one line (without its line end); quotes are outside the ranges.
///
/// `None`: a quote that is not closed, or text after a closing quote.
pub(super) fn split(line: &str, cells: &mut Vec<(usize, usize)>) -> Option<()> {
    cells.clear();
    let bytes = line.as_bytes();
    let mut start = 0;
    loop {
        let lead = start + bytes[start..].iter().take_while(|b| **b == b' ').count();
        let end = if bytes.get(lead) == Some(&b'"') {
            let close = closing_quote(bytes, lead + 1)?;
            cells.push((lead + 1, close));
            let tail = close + 1;
            tail + bytes[tail..].iter().take_while(|b| **b == b' ').count()
        } else {
            let length = bytes[start..].iter().take_while(|b| **b != b',').count();
            cells.push((start, start + length));
            start + length
        };
        match bytes.get(end) {
            None => return Some(()),
            Some(b',') => start = end + 1,
            Some(_) => return None,
        }
    }
}

/// Index of the quote that ends a quoted text which begins at `from`; a doubled quote stands for one.
pub(super) fn closing_quote(bytes: &[u8], from: usize) -> Option<usize> {
    let mut at = from;
    loop {
        at += bytes.get(at..)?.iter().position(|b| *b == b'"')?;
        if bytes.get(at + 1) != Some(&b'"') {
            return Some(at);
        }
        at += 2;
    }
}

/// The text of a cell: trimmed, doubled quotes made single.
pub(super) fn text(cell: &str) -> Cow<'_, str> {
    let trimmed = cell.trim();
    if trimmed.contains("\"\"") {
        Cow::Owned(trimmed.replace("\"\"", "\""))
    } else {
        Cow::Borrowed(trimmed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(line: &str) -> Option<Vec<String>> {
        let mut ranges = Vec::new();
        split(line, &mut ranges)?;
        Some(
            ranges
                .iter()
                .map(|(from, to)| text(&line[*from..*to]).into_owned())
                .collect(),
        )
    }

    #[test]
    fn lines_split_at_commas_outside_quotes() {
        for (line, expected) in [
            ("a,b", vec!["a", "b"]),
            ("", vec![""]),
            (",", vec!["", ""]),
            (" a , b ", vec!["a", "b"]),
            (r#""a,b",c"#, vec!["a,b", "c"]),
            (r#""say ""x""" , 1"#, vec![r#"say "x""#, "1"]),
            ("Torque (N\u{b7}m),x", vec!["Torque (N\u{b7}m)", "x"]),
            (r#"5" pipe,1"#, vec![r#"5" pipe"#, "1"]),
        ] {
            assert_eq!(cells(line).unwrap(), expected, "{line}");
        }
    }

    #[test]
    fn an_open_quote_is_refused() {
        assert_eq!(cells(r#"a,"b"#), None);
        assert_eq!(cells(r#""a"b,c"#), None);
        assert_eq!(cells(r#""a"""#), None);
    }
}

//! Numbers as text: decimal point or decimal comma, one of them in a file, and marks between thousands.
//!
//! A mark between thousands is read only where its groups are complete (`1,234.5`, `1.234.567`, `1 234`), and one comma before
//! three digits (`1,234`) only where another number of the file shows which mark is the decimal one.

/// How the numbers of a file are written.
#[derive(Clone, Debug)]
pub(super) struct NumberFormat {
    /// The decimal mark, once a number has shown it.
    decimal: Option<char>,
    /// A mark between thousands that was read.
    group: Option<char>,
}

/// What a cell is instead of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoNumber {
    /// Another text, or an infinite number.
    Text,
    /// Three digits behind the only comma: thousands or decimals.
    Ambiguous,
    /// The other decimal mark than in the numbers before.
    OtherMark,
}

const GROUPS: [char; 7] = [',', '.', ' ', '\u{a0}', '\u{202f}', '\'', '\u{2019}'];

impl NumberFormat {
    pub(super) const fn new() -> Self {
        Self { decimal: None, group: None }
    }

    /// How the numbers differ from those with a decimal point alone.
    pub(super) fn differences(&self) -> impl Iterator<Item = String> {
        let comma = (self.decimal == Some(',')).then(|| "numbers have a decimal comma".to_owned());
        let name = |group: char| match group {
            ' ' | '\u{a0}' | '\u{202f}' => "a blank".to_owned(),
            other => format!("{other:?}"),
        };
        let group = self.group.map(|group| format!("{} parts thousands", name(group)));
        comma.into_iter().chain(group)
    }

    /// NaN for a missing cell.
    #[inline]
    pub(super) fn number(&mut self, cell: &str) -> Result<f64, NoNumber> {
        if cell.is_empty() {
            return Ok(f64::NAN);
        }
        if self.decimal != Some(',')
            && let Ok(value) = cell.parse::<f64>()
        {
            if self.decimal.is_none() && cell.contains('.') {
                self.decimal = Some('.');
            }
            return if value.is_infinite() { Err(NoNumber::Text) } else { Ok(value) };
        }
        self.marked(cell)
    }

    /// A number with a comma or marks of thousands.
    fn marked(&mut self, cell: &str) -> Result<f64, NoNumber> {
        // The usual form, quickly.
        if self.decimal == Some(',')
            && let Some(value) = with_comma(cell)
        {
            return Ok(value);
        }
        let (digits, decimal, group) = parts(cell).ok_or(NoNumber::Text)?;
        let decimal = match (decimal, group, self.decimal) {
            (Mark::None, ..) => None,
            (Mark::Certain(mark), _, None) => Some(mark),
            (Mark::Certain(mark), _, Some(other)) if mark == other => Some(mark),
            (Mark::Open(mark), _, Some(other)) if mark == other => Some(mark),
            // The other mark of the file is the decimal one, so this one parts thousands.
            (Mark::Open(mark), None, Some(_)) => {
                self.group = Some(mark);
                return digits.replace(mark, "").parse().map_err(|_| NoNumber::Text);
            }
            (Mark::Open(_), _, None) => return Err(NoNumber::Ambiguous),
            _ => return Err(NoNumber::OtherMark),
        };
        if let Some(group) = group {
            // A mark of thousands is not the decimal one.
            if self.decimal == Some(group) {
                return Err(NoNumber::OtherMark);
            }
            self.group = Some(group);
            if decimal.is_none() && matches!(group, ',' | '.') {
                self.decimal = Some(if group == ',' { '.' } else { ',' });
            }
        }
        if decimal.is_some() {
            self.decimal = decimal;
        }
        let value = digits.replace(',', ".").parse::<f64>().map_err(|_| NoNumber::Text)?;
        if value.is_infinite() { Err(NoNumber::Text) } else { Ok(value) }
    }

    /// Takes the decimal mark from a cell that leaves no doubt; the first one decides.
    pub(super) fn learn(&mut self, cell: &str) {
        if self.decimal.is_none()
            && let Some((_, decimal, group)) = parts(cell)
        {
            self.decimal = match (decimal, group) {
                (Mark::Certain(mark), _) => Some(mark),
                (_, Some(',')) => Some('.'),
                (_, Some('.')) => Some(','),
                _ => None,
            };
        }
    }
}

/// A short finite number with at most one mark, a comma.
fn with_comma(cell: &str) -> Option<f64> {
    let mut digits = [0_u8; 32];
    let text = digits.get_mut(..cell.len())?;
    let mut commas = 0;
    for (to, from) in text.iter_mut().zip(cell.bytes()) {
        commas += usize::from(from == b',');
        *to = if from == b',' { b'.' } else { from };
        if from == b'.' || commas > 1 {
            return None;
        }
    }
    std::str::from_utf8(text).ok()?.parse().ok().filter(|value: &f64| value.is_finite())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    None,
    Certain(char),
    /// It may as well part thousands.
    Open(char),
}

/// A number without its marks of thousands, its decimal mark, and the mark of thousands; `None` where it is no number.
fn parts(cell: &str) -> Option<(String, Mark, Option<char>)> {
    let mantissa = cell.split(['e', 'E']).next()?;
    let exponent = &cell[mantissa.len()..];
    let digits = mantissa.trim_start_matches(['+', '-']);
    if mantissa.len() - digits.len() > 1 || !digits.bytes().any(|b| b.is_ascii_digit()) {
        return None;
    }
    let is_mark = |letter: &char| GROUPS.contains(letter);
    if !digits.chars().all(|letter| letter.is_ascii_digit() || is_mark(&letter)) {
        return None;
    }
    let marks: Vec<(usize, char)> =
        digits.char_indices().filter(|(_, letter)| is_mark(letter)).collect();
    let Some((&(at, last), before)) = marks.split_last() else {
        return Some((cell.to_owned(), Mark::None, None));
    };
    // The last mark is the decimal one where it stands alone or is another than those before it.
    let may_be_decimal = matches!(last, ',' | '.') && before.iter().all(|(_, mark)| *mark != last);
    let (whole, decimal) = if may_be_decimal { (&digits[..at], last) } else { (digits, ' ') };
    let group = before.first().or(if may_be_decimal { None } else { marks.first() });
    let group = group.map(|(_, mark)| *mark);
    if let Some(group) = group {
        let mut blocks = whole.split(group);
        let first = blocks.next().unwrap_or_default();
        let is_digits = |block: &str| block.bytes().all(|b| b.is_ascii_digit());
        let fits = (1..=3).contains(&first.len())
            && is_digits(first)
            && blocks.all(|block| block.len() == 3 && is_digits(block));
        if !fits {
            return None;
        }
    }
    let plain = match group {
        Some(group) => cell.replace(group, ""),
        None => cell.to_owned(),
    };
    if !may_be_decimal {
        return Some((plain, Mark::None, group));
    }
    let behind = &digits[at + decimal.len_utf8()..];
    // Thousands have three digits behind the mark, and do not begin with zero.
    let is_open = group.is_none()
        && exponent.is_empty()
        && behind.len() == 3
        && (1..=3).contains(&whole.len())
        && !whole.starts_with('0');
    let mark = if is_open { Mark::Open(decimal) } else { Mark::Certain(decimal) };
    Some((plain, mark, group))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_a_file_share_their_marks() {
        use NoNumber::{Ambiguous, OtherMark, Text};
        for (cells, expected) in [
            (&["1.5", "-2", "3e-1", "1.234"][..], &[Ok(1.5), Ok(-2.0), Ok(0.3), Ok(1.234)][..]),
            (&["1,5", "-0,25", "1,234", "2,5e3"], &[Ok(1.5), Ok(-0.25), Ok(1.234), Ok(2500.0)]),
            // Evidence may stand behind.
            (&["1,234", "0,5"], &[Ok(1.234), Ok(0.5)]),
            (&["1,234", "0.5"], &[Ok(1234.0), Ok(0.5)]),
            (&["1,234", "12"], &[Err(Ambiguous), Ok(12.0)]),
            (&["1,234.5", "1,234", "12,345,678"], &[Ok(1234.5), Ok(1234.0), Ok(12_345_678.0)]),
            (&["1.234,5", "1.234", "-0,5"], &[Ok(1234.5), Ok(1234.0), Ok(-0.5)]),
            (&["1.234.567", "1,5"], &[Ok(1_234_567.0), Ok(1.5)]),
            (&["1 234,5", "1'234,5", "1\u{202f}234"], &[Ok(1234.5), Ok(1234.5), Ok(1234.0)]),
            // Groups that are not complete, and two decimal marks.
            (&["1,23,456", "12 34", "1.2.3"], &[Err(Text), Err(Text), Err(Text)]),
            (&["0.5", "1,5"], &[Ok(0.5), Err(OtherMark)]),
            (&["0,5", "1.25"], &[Ok(0.5), Err(OtherMark)]),
            (&["0.5", "1.234,5"], &[Ok(0.5), Err(OtherMark)]),
            (&["inf", "1 A", "#N/A", "--1", ",", "1,5 "], &[Err(Text); 6]),
        ] {
            let mut format = NumberFormat::new();
            for cell in cells {
                format.learn(cell);
            }
            for (cell, expected) in cells.iter().zip(expected) {
                assert_eq!(format.number(cell), *expected, "{cell} of {cells:?}");
            }
        }
        assert!(NumberFormat::new().number("").unwrap().is_nan());
        assert!(NumberFormat::new().number("NaN").unwrap().is_nan());
    }
}

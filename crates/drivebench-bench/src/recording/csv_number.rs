//! Numbers as text: decimal point or decimal comma, one of them in a file.

/// How the numbers of a file are written.
pub(super) struct NumberFormat {
    /// The decimal mark, once a number has one; always a point where the comma is the separator.
    decimal: Option<u8>,
    separator: u8,
}

impl NumberFormat {
    pub(super) const fn new(separator: u8) -> Self {
        Self { decimal: None, separator }
    }

    pub(super) fn has_decimal_comma(&self) -> bool {
        self.decimal == Some(b',')
    }

    /// NaN for a missing cell; `None` for what is neither missing nor a finite number.
    pub(super) fn number(&mut self, cell: &str) -> Option<f64> {
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

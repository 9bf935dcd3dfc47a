//! `--missing 'A,B,-9999'`: texts and numbers that stand for a missing value.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use super::column_map::split_unquoted;

/// Cells that are read as missing, as empty ones and NaN are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MissingValues {
    texts: Vec<String>,
    /// Values of cells, however they are written.
    numbers: Vec<f64>,
}

impl FromStr for MissingValues {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut missing = Self::default();
        for item in split_unquoted(text, ',') {
            let item = item.trim_matches('"').trim();
            if item.is_empty() {
                return Err(format!(
                    "{text:?} has an empty item (an empty cell is missing anyway)"
                ));
            }
            missing.texts.push(item.to_owned());
            missing.numbers.extend(item.parse::<f64>().ok().filter(|value| value.is_finite()));
        }
        Ok(missing)
    }
}

/// As it may be given again.
impl Display for MissingValues {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        for (place, text) in self.texts.iter().enumerate() {
            let comma = if place > 0 { "," } else { "" };
            let quote = if text.contains(',') { "\"" } else { "" };
            write!(f, "{comma}{quote}{text}{quote}")?;
        }
        Ok(())
    }
}

impl MissingValues {
    pub(super) fn is_empty(&self) -> bool {
        self.texts.is_empty()
    }

    /// In letters of either case.
    pub(super) fn has_text(&self, cell: &str) -> bool {
        self.texts.iter().any(|text| text.eq_ignore_ascii_case(cell))
    }

    pub(super) fn has_number(&self, value: f64) -> bool {
        self.numbers.iter().any(|number| (number - value).abs() <= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_and_numbers_stand_for_missing_values() {
        let text = "#N/A,ERR, -9999 ,\"n,a\"";
        let missing: MissingValues = text.parse().unwrap();
        for (cell, expected) in [("#n/a", true), ("ERR", true), ("n,a", true), ("ER", false)] {
            assert_eq!(missing.has_text(cell), expected, "{cell}");
        }
        assert!(missing.has_number(-9999.0) && !missing.has_number(-999.0));
        assert_eq!(missing.to_string().parse(), Ok(missing));
        for wrong in ["", "a,,b", "a,"] {
            assert!(wrong.parse::<MissingValues>().is_err(), "{wrong}");
        }
    }
}

//! The table of known columns, `known_columns.toml`: words, symbols, programs and instruments. Units are those of
//! [`drivebench_identify::sanity`].

use std::collections::BTreeMap;
use std::sync::LazyLock;

use crate::fits_pattern;
use drivebench_identify::sanity::any_unit;
use drivebench_model::text::number::with_digits;
use serde::Deserialize;

/// What a column of a foreign log holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    Time,
    /// A count of rows.
    Index,
    /// At the terminals of the motor.
    Voltage,
    VoltageCommand,
    SupplyVoltage,
    /// The share of its supply that a bridge applies.
    Duty,
    /// A command without a quantity.
    Command,
    /// In the winding.
    Current,
    SupplyCurrent,
    Speed,
    /// Of the field: the speed of the shaft times the pole pairs.
    ElectricalSpeed,
    SpeedReference,
    Angle,
    Torque,
    /// Of an oscilloscope: anything.
    Channel,
    /// Nothing that a map needs.
    Other,
}

/// What a column is multiplied by to be SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Factor {
    pub value: f64,
    /// Name and power of a number that the file does not contain.
    pub number: Option<(&'static str, i32)>,
}

impl Factor {
    pub(super) const ONE: Self = Self { value: 1.0, number: None };

    pub(super) const fn of(value: f64) -> Self {
        Self { value, ..Self::ONE }
    }

    pub(super) const fn times(self, number: &'static str) -> Self {
        Self { number: Some((number, 1)), ..self }
    }

    pub(super) const fn over(self, number: &'static str) -> Self {
        Self { number: Some((number, -1)), ..self }
    }

    /// `A`, `A*NAME` or `A/NAME`.
    pub(super) fn parsed(text: &'static str) -> Option<Self> {
        let (value, number) = match text.split_once('*') {
            Some((value, number)) => (value, Some((number, 1))),
            None => text
                .split_once('/')
                .map_or((text, None), |(value, number)| (value, Some((number, -1)))),
        };
        Some(Self { value: value.parse().ok()?, number })
    }

    /// With its number, where that is given.
    pub(super) fn filled(self, given: &BTreeMap<String, f64>) -> Self {
        let number = self.number.and_then(|(name, power)| Some(given.get(name)?.powi(power)));
        number.map_or(self, |number| Self::of(self.value * number))
    }

    pub(super) fn is_one(&self) -> bool {
        self.number.is_none() && (self.value - 1.0).abs() < 1e-12
    }

    /// As it stands in a map behind the star, the number in braces; ten figures without an exponent.
    pub(super) fn text(&self) -> String {
        let value = with_digits(self.value, 10);
        match self.number {
            None => value.to_string(),
            Some((name, 1)) if Self::of(value).is_one() => format!("{{{name}}}"),
            Some((name, 1)) => format!("{{{value}*{name}}}"),
            Some((name, _)) => format!("{{{value}/{name}}}"),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    pub quantity: Quantity,
    pub name: &'static str,
    pub factor: Factor,
}

impl Unit {
    pub(super) fn of(text: &str) -> Option<Self> {
        let (target, unit) = any_unit(&plain(text))?;
        let quantity = match target {
            "time_s" => Quantity::Time,
            "voltage_v" => Quantity::Voltage,
            "current_a" => Quantity::Current,
            "speed_rad_s" => Quantity::Speed,
            "angle_rad" => Quantity::Angle,
            "torque_n_m" => Quantity::Torque,
            "duty" => Quantity::Duty,
            _ => Quantity::Other,
        };
        Some(Self { quantity, name: unit.name, factor: Factor::parsed(unit.factor)? })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Qualifier {
    Commanded,
    OfTheSupply,
    Electrical,
    DirectAxis,
    QuadratureAxis,
    Derived,
    Rms,
}

/// A whole header that is a symbol.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Symbol {
    names: String,
    /// The more usual first.
    pub quantities: Vec<Quantity>,
    /// By convention.
    pub unit: Option<String>,
}

/// A program or an instrument.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tool {
    pub name: String,
    signature: Vec<String>,
    needs: usize,
    columns: Vec<ToolColumn>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ToolColumn {
    header: String,
    pub quantity: Quantity,
    pub unit: Option<String>,
    /// The usual one, where the program leaves it to its user.
    pub likely_unit: Option<String>,
    pub factor: Option<f64>,
    /// Of columns of one quantity that with the smallest is the first choice.
    #[serde(default)]
    pub rank: u8,
    pub note: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Known {
    /// Numbers that a map may need and no file contains, and how to find each.
    pub numbers: BTreeMap<String, String>,
    words: BTreeMap<Quantity, String>,
    qualifiers: BTreeMap<Qualifier, String>,
    #[serde(rename = "symbol")]
    symbols: Vec<Symbol>,
    #[serde(rename = "tool")]
    tools: Vec<Tool>,
}

static KNOWN: LazyLock<Known> = LazyLock::new(|| {
    toml::from_str(include_str!("known_columns.toml")).expect("a test parses the embedded table")
});

/// What a word stands for, alone or as the part of a compound.
fn meaning<K: Copy>(
    table: &BTreeMap<K, String>,
    word: &str,
    is_part: impl Fn(&str) -> bool,
) -> Option<K> {
    let of = |is: &dyn Fn(&str) -> bool| {
        table.iter().find(|(_, names)| names.split(' ').any(is)).map(|(key, _)| *key)
    };
    of(&|name| name == word).or_else(|| of(&is_part))
}

impl Known {
    pub(super) fn get() -> &'static Self {
        &KNOWN
    }

    /// The quantity of a word; a long word may stand at the end of a compound, as in `Motorstrom`.
    pub(super) fn word(&self, token: &str) -> Option<Quantity> {
        meaning(&self.words, token, |name| name.len() >= 5 && token.ends_with(name))
    }

    pub(super) fn qualifier(&self, token: &str) -> Option<Qualifier> {
        let is_long = |name: &str| name.len() >= 4 && token.len() > name.len() + 3;
        meaning(&self.qualifiers, token, |name| is_long(name) && token.starts_with(name))
    }

    pub(super) fn symbol(&self, header: &str) -> Option<&Symbol> {
        self.symbols.iter().find(|symbol| symbol.names.split(' ').any(|name| name == header))
    }

    /// The program or instrument that writes such headers.
    pub(super) fn tool(&self, headers: &[String]) -> Option<&Tool> {
        let headers: Vec<String> = headers.iter().map(|header| plain(header)).collect();
        self.tools.iter().find(|tool| {
            let stands =
                |pattern: &&String| headers.iter().any(|header| fits_pattern(pattern, header));
            tool.signature.iter().filter(stands).count() >= tool.needs
        })
    }
}

impl Tool {
    pub(super) fn column(&self, header: &str) -> Option<&ToolColumn> {
        let header = plain(header);
        self.columns.iter().find(|column| fits_pattern(&column.header, &header))
    }
}

/// A text without capitals, accents and typographic marks.
pub(super) fn plain(text: &str) -> String {
    let mut plain = String::new();
    for letter in text.trim().chars().flat_map(char::to_lowercase) {
        match letter {
            '\u{e4}' => plain.push_str("ae"),
            '\u{f6}' => plain.push_str("oe"),
            '\u{fc}' => plain.push_str("ue"),
            '\u{df}' => plain.push_str("ss"),
            '\u{e0}'..='\u{e5}' => plain.push('a'),
            '\u{e8}'..='\u{eb}' => plain.push('e'),
            '\u{ec}'..='\u{ef}' => plain.push('i'),
            '\u{f2}'..='\u{f5}' => plain.push('o'),
            '\u{f9}'..='\u{fb}' | '\u{b5}' | '\u{3bc}' => plain.push('u'),
            '\u{e7}' => plain.push('c'),
            '\u{f1}' => plain.push('n'),
            '\u{b7}' | '\u{22c5}' | '\u{2219}' | '\u{d7}' => plain.push('.'),
            '\u{207b}' => plain.push('-'),
            '\u{b9}' => plain.push('1'),
            '\u{feff}' => {}
            _ => plain.push(letter),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_whole() {
        let known = Known::get();
        for tool in &known.tools {
            assert!(tool.needs >= 1 && tool.needs <= tool.signature.len(), "{}", tool.name);
            for column in &tool.columns {
                assert_eq!(plain(&column.header), column.header, "{}", tool.name);
                for unit in [&column.unit, &column.likely_unit].into_iter().flatten() {
                    assert!(Unit::of(unit).is_some(), "{}: {unit}", tool.name);
                }
            }
        }
        let units = known.symbols.iter().filter_map(|symbol| symbol.unit.as_ref());
        assert!(units.into_iter().all(|unit| Unit::of(unit).is_some()));
        let names = known.words.values().chain(known.qualifiers.values());
        for name in names.flat_map(|names| names.split(' ')) {
            assert_eq!(plain(name), name);
        }
        for unit in ["counts/s", "counts", "permille"] {
            let number = Unit::of(unit).and_then(|unit| unit.factor.number).unwrap();
            assert!(known.numbers.contains_key(number.0), "{unit}");
        }
    }
}

//! The table of known columns, `known_columns.toml`: units, words, symbols, programs and instruments.

use std::sync::LazyLock;

use drivebench_identify::sanity::unit_of;
use serde::{Deserialize, Serialize};

/// What a column of a foreign log holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
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

/// How a value becomes SI.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Factor {
    Known(f64),
    /// An expression with one number that the file does not contain: `A/NAME`, `A*NAME` or `NAME`.
    Hole(String),
}

/// A unit of a column.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Unit {
    pub quantity: Quantity,
    pub name: String,
    pub factor: Factor,
}

/// A unit that the reader of files does not convert by itself.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FurtherUnit {
    quantity: Quantity,
    name: String,
    spellings: String,
    factor: Option<String>,
    hole: Option<String>,
}

impl FurtherUnit {
    fn unit(&self) -> Unit {
        let known = self.factor.as_ref().and_then(|factor| factor.parse().ok());
        let factor = match &self.hole {
            Some(hole) => Factor::Hole(hole.clone()),
            None => Factor::Known(known.unwrap_or(1.0)),
        };
        Unit { quantity: self.quantity, name: self.name.clone(), factor }
    }
}

/// Targets of a map, and what their units are of.
const OF_TARGETS: [(&str, Quantity); 7] = [
    ("time_s", Quantity::Time),
    ("voltage_v", Quantity::Voltage),
    ("current_a", Quantity::Current),
    ("speed_rad_s", Quantity::Speed),
    ("angle_rad", Quantity::Angle),
    ("torque_n_m", Quantity::Torque),
    ("temperature_c", Quantity::Other),
];

/// A number that a map may need and no file contains.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Number {
    pub name: String,
    pub how: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Word {
    quantity: Quantity,
    names: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
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

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct QualifierWords {
    kind: Qualifier,
    names: String,
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
    #[serde(rename = "column")]
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
    pub factor: Option<String>,
    /// Of columns of one quantity that with the smallest is the first choice.
    #[serde(default)]
    pub rank: u8,
    pub note: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Known {
    #[serde(rename = "unit")]
    units: Vec<FurtherUnit>,
    #[serde(rename = "number")]
    numbers: Vec<Number>,
    #[serde(rename = "word")]
    words: Vec<Word>,
    #[serde(rename = "qualifier")]
    qualifiers: Vec<QualifierWords>,
    #[serde(rename = "symbol")]
    symbols: Vec<Symbol>,
    #[serde(rename = "tool")]
    tools: Vec<Tool>,
}

static KNOWN: LazyLock<Known> = LazyLock::new(|| {
    toml::from_str(include_str!("known_columns.toml")).expect("a test parses the embedded table")
});

impl Known {
    pub(super) fn get() -> &'static Self {
        &KNOWN
    }

    /// The unit with this spelling.
    pub(super) fn unit(&self, text: &str) -> Option<Unit> {
        let text = plain(text);
        let further = self.units.iter().find(|unit| has(&unit.spellings, &text));
        further.map(FurtherUnit::unit).or_else(|| {
            OF_TARGETS.iter().find_map(|(target, quantity)| {
                let found = unit_of(target, &text)?;
                // Behind a blank stands what the unit is to that of the target.
                let name = found.name.split(" (").next().unwrap_or(found.name).to_owned();
                let factor = Factor::Known(found.factor.parse().ok()?);
                Some(Unit { quantity: *quantity, name, factor })
            })
        })
    }

    pub(super) fn numbers(&self) -> impl Iterator<Item = &Number> + Clone {
        self.numbers.iter()
    }

    /// The first number of the table that stands in an expression.
    pub(super) fn number_in(&self, hole: &str) -> Option<&Number> {
        self.numbers.iter().find(|number| hole.split(['*', '/']).any(|part| part == number.name))
    }

    /// The quantity of a word; a long word may stand at the end of a compound, as in `Motorstrom`.
    pub(super) fn word(&self, token: &str) -> Option<Quantity> {
        let exact = self.words.iter().find(|word| has(&word.names, token));
        let ends = |name: &str| name.len() >= 5 && token.ends_with(name);
        let compound = || self.words.iter().find(|word| word.names.split(' ').any(ends));
        exact.or_else(compound).map(|word| word.quantity)
    }

    pub(super) fn qualifier(&self, token: &str) -> Option<Qualifier> {
        let begins =
            |name: &str| name.len() >= 4 && token.len() > name.len() + 3 && token.starts_with(name);
        let exact = self.qualifiers.iter().find(|words| has(&words.names, token));
        let compound = || self.qualifiers.iter().find(|words| words.names.split(' ').any(begins));
        exact.or_else(compound).map(|words| words.kind)
    }

    pub(super) fn symbol(&self, header: &str) -> Option<&Symbol> {
        self.symbols.iter().find(|symbol| has(&symbol.names, header))
    }

    /// The program or instrument that writes such headers.
    pub(super) fn tool(&self, headers: &[String]) -> Option<&Tool> {
        let headers: Vec<String> = headers.iter().map(|header| plain(header)).collect();
        self.tools.iter().find(|tool| {
            let stands = |pattern: &&String| headers.iter().any(|header| fits(pattern, header));
            tool.signature.iter().filter(stands).count() >= tool.needs
        })
    }
}

impl Tool {
    pub(super) fn column(&self, header: &str) -> Option<&ToolColumn> {
        let header = plain(header);
        self.columns.iter().find(|column| fits(&column.header, &header))
    }
}

fn has(names: &str, text: &str) -> bool {
    names.split(' ').any(|name| name == text)
}

/// Whether a text fits a pattern, in which a star stands for any text and a question mark for one letter. No header is longer.
fn fits(pattern: &str, text: &str) -> bool {
    if text.len() > 200 {
        return false;
    }
    let mut pattern_letters = pattern.chars();
    match pattern_letters.next() {
        None => text.is_empty(),
        Some('*') => {
            let rest = pattern_letters.as_str();
            let ends = text.char_indices().map(|(at, _)| at).chain([text.len()]);
            ends.into_iter().any(|at| fits(rest, &text[at..]))
        }
        Some(letter) => {
            let mut letters = text.chars();
            let fitting = letters.next().is_some_and(|own| own == letter || letter == '?');
            fitting && fits(pattern_letters.as_str(), letters.as_str())
        }
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
        for unit in &known.units {
            assert!(unit.factor.is_some() != unit.hole.is_some(), "{}", unit.name);
            let is_number = unit.factor.as_ref().is_none_or(|factor| factor.parse::<f64>().is_ok());
            assert!(is_number, "{}", unit.name);
            let hole = unit.hole.as_ref().is_none_or(|hole| known.number_in(hole).is_some());
            assert!(hole, "{}: no number explains its hole", unit.name);
            for spelling in unit.spellings.split(' ') {
                assert_eq!(plain(spelling), spelling, "{}", unit.name);
                let same = known.unit(spelling).map(|found| found.name);
                assert_eq!(same.as_ref(), Some(&unit.name), "{spelling} stands in two units");
            }
        }
        for tool in &known.tools {
            assert!(tool.needs >= 1 && tool.needs <= tool.signature.len(), "{}", tool.name);
            for column in &tool.columns {
                assert_eq!(plain(&column.header), column.header, "{}", tool.name);
                let units = [&column.unit, &column.likely_unit].into_iter().flatten();
                for unit in units {
                    assert!(known.unit(unit).is_some(), "{}: {unit}", tool.name);
                }
                let factor = column.factor.as_ref();
                assert!(factor.is_none_or(|factor| factor.parse::<f64>().is_ok()));
            }
        }
        let units = known.symbols.iter().filter_map(|symbol| symbol.unit.as_ref());
        assert!(units.into_iter().all(|unit| known.unit(unit).is_some()));
        let names = known.words.iter().map(|word| &word.names);
        let names = names.chain(known.qualifiers.iter().map(|words| &words.names));
        for name in names.flat_map(|names| names.split(' ')) {
            assert_eq!(plain(name), name);
        }
    }

    #[test]
    fn patterns_have_stars_and_question_marks() {
        for (pattern, text, expected) in [
            ("a*c", "abbc", true),
            ("a*c", "abb", false),
            ("*", "", true),
            ("ch?", "ch1", true),
            ("ch?", "ch12", false),
            ("*vel_estimate", "axis0.encoder.vel_estimate", true),
            ("a", "ab", false),
        ] {
            assert_eq!(fits(pattern, text), expected, "{pattern} {text}");
        }
    }
}

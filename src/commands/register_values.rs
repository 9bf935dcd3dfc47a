//! Registers as numbers and texts: types and byte orders, the notations of an address, and the readings that look plausible.
//!
//! A byte order names the four bytes of a number, the highest A, in the order in which they come: ABCD is that of the standard.

use clap::ValueEnum;
use serde::Serialize;

use drivebench_link::CellTable;
use drivebench_link::register_map::{Kind, Layout, Order};

fn hexadecimal(text: &str) -> Option<&str> {
    text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"))
}

/// The content of a register, or its number: decimal, or hexadecimal with 0x.
pub(super) fn cell(text: &str) -> Option<u16> {
    match hexadecimal(text) {
        Some(digits) => u16::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ValueType {
    U16,
    I16,
    U32,
    I32,
    F32,
    /// Two characters in each register
    Text,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize)]
#[value(rename_all = "UPPER")]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum ByteOrder {
    #[default]
    Abcd,
    Cdab,
    Badc,
    Dcba,
}

/// The name of a value as an option takes it.
fn name_of(value: &impl ValueEnum) -> String {
    value.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

impl ByteOrder {
    const fn swaps_bytes(self) -> bool {
        matches!(self, Self::Badc | Self::Dcba)
    }
}

/// How registers are read and written as values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Format {
    #[serde(rename = "as")]
    pub(super) kind: ValueType,
    pub(super) order: ByteOrder,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub(super) enum Value {
    Number(f64),
    Text(String),
}

impl Format {
    /// A text has no words whose order could be another.
    pub(super) fn new(kind: ValueType, order: ByteOrder) -> Result<Self, String> {
        match (kind, order) {
            (ValueType::Text, ByteOrder::Cdab | ByteOrder::Dcba) => Err(format!(
                "--order {} is not one of a text (allowed: ABCD, or BADC for swapped bytes)",
                name_of(&order)
            )),
            _ => Ok(Self { kind, order }),
        }
    }

    pub(super) fn name(self) -> String {
        format!("{} {}", name_of(&self.kind), name_of(&self.order))
    }

    fn layout(self) -> Option<Layout> {
        let kind = match self.kind {
            ValueType::U16 => Kind::U16,
            ValueType::I16 => Kind::I16,
            ValueType::U32 => Kind::U32,
            ValueType::I32 => Kind::I32,
            ValueType::F32 => Kind::F32,
            ValueType::Text => return None,
        };
        let order = |is_low_first| if is_low_first { Order::LowFirst } else { Order::HighFirst };
        let words = order(matches!(self.order, ByteOrder::Cdab | ByteOrder::Dcba));
        Some(Layout { words, bytes: order(self.order.swaps_bytes()), ..Layout::plain(kind) })
    }

    /// Registers of one value; a text may have any number.
    pub(super) fn registers(self) -> u16 {
        self.layout().map_or(1, |layout| layout.cells())
    }

    /// The values of registers whose number is a multiple of [`Format::registers`].
    pub(super) fn decode(self, registers: &[u16]) -> Vec<Value> {
        let Some(layout) = self.layout() else {
            let swaps = self.order.swaps_bytes();
            let word = |word: &u16| if swaps { word.swap_bytes() } else { *word };
            let bytes: Vec<u8> = registers.iter().flat_map(|r| word(r).to_be_bytes()).collect();
            let text = String::from_utf8_lossy(&bytes);
            return vec![Value::Text(text.trim_end_matches(['\0', ' ']).to_owned())];
        };
        let values = registers.chunks_exact(usize::from(layout.cells()));
        let number = |words: &[u16]| layout.number(layout.pattern(words).unwrap_or_default());
        values.map(|words| Value::Number(shortest(self.kind, number(words)))).collect()
    }

    /// The registers that hold a value as it is typed.
    pub(super) fn encode(self, text: &str) -> Result<Vec<u16>, String> {
        let Some(layout) = self.layout() else {
            if text.is_empty() || !text.bytes().all(|byte| byte.is_ascii_graphic() || byte == b' ')
            {
                return Err(format!("{text:?} is not a text of printable ASCII characters"));
            }
            let pairs = text.as_bytes().chunks(2);
            let words =
                pairs.map(|pair| u16::from_be_bytes([pair[0], pair.get(1).copied().unwrap_or(0)]));
            let swaps = self.order.swaps_bytes();
            return Ok(words.map(|word| if swaps { word.swap_bytes() } else { word }).collect());
        };
        let allowed = match self.kind {
            ValueType::U16 => "a whole number from 0 to 65535",
            ValueType::I16 => "a whole number from -32768 to 32767",
            ValueType::U32 => "a whole number from 0 to 4294967295",
            ValueType::I32 => "a whole number from -2147483648 to 2147483647",
            ValueType::F32 | ValueType::Text => "a number of 32 bits",
        };
        let is_whole = self.kind != ValueType::F32;
        let number = match hexadecimal(text) {
            Some(digits) if is_whole => u32::from_str_radix(digits, 16).ok().map(f64::from),
            Some(_) => None,
            None => text.parse().ok(),
        };
        number
            .filter(|number: &f64| !is_whole || number.fract() == 0.0)
            .and_then(|number| layout.encode(number))
            .ok_or_else(|| {
                format!("{text:?} is not {allowed} (0x... for hexadecimal whole numbers)")
            })
    }
}

/// A float register as the decimal that it was written as: 49.98 and not 49.97999954.
fn shortest(kind: ValueType, number: f64) -> f64 {
    #[expect(clippy::cast_possible_truncation, reason = "it came from a number of 32 bits")]
    let float = number as f32;
    match kind {
        ValueType::F32 => float.to_string().parse().unwrap_or(number),
        _ => number,
    }
}

impl Value {
    pub(super) fn text(&self) -> String {
        match self {
            Self::Text(text) => format!("{text:?}"),
            Self::Number(number) if *number == 0.0 || (1e-4..1e10).contains(&number.abs()) => {
                number.to_string()
            }
            Self::Number(number) => format!("{number:e}"),
        }
    }
}

/// One plausible reading, and why it is one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Guess {
    address: u16,
    #[serde(flatten)]
    format: Format,
    value: Value,
    why: &'static str,
}

impl Guess {
    pub(super) fn line(&self) -> String {
        let (address, format, value) = (self.address, self.format.name(), self.value.text());
        format!("{address:>5}  {format:<9} {value:<16} {}", self.why)
    }
}

/// All readings of these registers that look plausible, pair by pair; of several the likelier first. None is proven by this.
pub(super) fn guesses(address: u16, registers: &[u16]) -> Vec<Guess> {
    let mut all = Vec::new();
    let mut guess = |at: usize, kind, order, value, why| {
        let address = address.saturating_add(u16::try_from(at).unwrap_or(u16::MAX));
        all.push(Guess { address, format: Format { kind, order }, value, why });
    };
    for order in [ByteOrder::Abcd, ByteOrder::Badc] {
        let format = Format { kind: ValueType::Text, order };
        for value in format.decode(registers) {
            let is_readable = |text: &String| {
                text.len() >= 4 && text.chars().all(|c| c.is_ascii_graphic() || c == ' ')
            };
            if matches!(&value, Value::Text(text) if is_readable(text)) {
                guess(0, ValueType::Text, order, value, "every character is printable");
            }
        }
    }
    for (pair, words) in registers.chunks(2).enumerate() {
        let at = 2 * pair;
        let one = |kind, order| Format { kind, order }.decode(words).into_iter().next();
        if words.len() == 2 && words != [0, 0] {
            let mut floats = Vec::new();
            for &order in ByteOrder::value_variants() {
                let Some(Value::Number(number)) = one(ValueType::F32, order) else { continue };
                // Sizes of physical quantities in usual units.
                if (1e-3..1e6).contains(&number.abs()) {
                    let digits = number.to_string().bytes().filter(u8::is_ascii_digit).count();
                    floats.push((digits, order, number));
                }
            }
            floats.sort_by_key(|(digits, ..)| *digits);
            for (digits, order, number) in floats {
                let why = if digits <= 6 {
                    "of usual size, and a short decimal, which chance seldom gives"
                } else {
                    "of usual size"
                };
                guess(at, ValueType::F32, order, Value::Number(number), why);
            }
            for &order in ByteOrder::value_variants() {
                let (high, low) = match order {
                    ByteOrder::Abcd | ByteOrder::Badc => (words[0], words[1]),
                    ByteOrder::Cdab | ByteOrder::Dcba => (words[1], words[0]),
                };
                let kind = match high {
                    0 if low != 0 => ValueType::U32,
                    u16::MAX => ValueType::I32,
                    _ => continue,
                };
                if let Some(value) = one(kind, order).filter(|_| !order.swaps_bytes()) {
                    guess(at, kind, order, value, "the high register only extends the low one");
                }
            }
        }
        for (offset, word) in words.iter().enumerate() {
            let number = |value| Value::Number(value);
            let (plain, why) = (number(f64::from(*word)), "each register is a number");
            guess(at + offset, ValueType::U16, ByteOrder::Abcd, plain, why);
            if *word > 0x8000 {
                let signed = number(f64::from(word.cast_signed()));
                guess(at + offset, ValueType::I16, ByteOrder::Abcd, signed, "the same with a sign");
            }
        }
    }
    all
}

/// Protocol address, its table where the notation has one, and whether the notation was converted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Address {
    pub(super) number: u16,
    pub(super) table: Option<CellTable>,
    /// As it was given, where it is no protocol address.
    pub(super) notation: Option<String>,
}

impl Address {
    /// A protocol address; or a register of a manual that cannot be one: `4x1`, `3x1`, or six digits from 400001 or 300001.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let lower = text.to_ascii_lowercase();
        let six = |first: u32, table| {
            let number = lower.parse::<u32>().ok()?.checked_sub(first)?;
            Some((u16::try_from(number).ok().filter(|_| lower.len() == 6)?, table))
        };
        let of_table = |prefix: &str, table| {
            let number = lower.strip_prefix(prefix)?.parse::<u32>().ok()?.checked_sub(1)?;
            Some((u16::try_from(number).ok()?, table))
        };
        let converted = of_table("4x", CellTable::Holding)
            .or_else(|| of_table("3x", CellTable::Input))
            .or_else(|| six(400_001, CellTable::Holding))
            .or_else(|| six(300_001, CellTable::Input).filter(|_| lower.starts_with('3')));
        if let Some((number, table)) = converted {
            return Ok(Self { number, table: Some(table), notation: Some(text.to_owned()) });
        }
        cell(text).map(|number| Self { number, table: None, notation: None }).ok_or_else(|| {
            format!(
                "{text:?} is not a number from 0 to 65535 (0x... for hexadecimal; 4x1, 3x1, 400001 or 300001 for registers as manuals count them)"
            )
        })
    }

    /// The protocol address of a converted one.
    pub(super) fn remark(&self) -> Option<String> {
        let table = if self.table? == CellTable::Input { "input" } else { "holding" };
        let notation = self.notation.as_ref()?;
        Some(format!("{notation} is {table} register {} of the protocol", self.number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn format(kind: ValueType, order: ByteOrder) -> Format {
        Format { kind, order }
    }

    #[test]
    fn values_are_read_and_written_in_every_order() {
        use ByteOrder::{Abcd, Badc, Cdab, Dcba};
        use ValueType::{F32, I16, I32, Text, U16, U32};
        for (kind, order, typed, registers) in [
            (U16, Abcd, "65535", &[0xFFFF][..]),
            (U16, Badc, "0x1234", &[0x3412]),
            (I16, Abcd, "-2", &[0xFFFE]),
            (U32, Abcd, "70000", &[1, 4464]),
            (U32, Cdab, "70000", &[4464, 1]),
            (I32, Cdab, "-1", &[0xFFFF, 0xFFFF]),
            (F32, Abcd, "49.98", &[0x4247, 0xEB85]),
            (F32, Cdab, "49.98", &[0xEB85, 0x4247]),
            (F32, Badc, "49.98", &[0x4742, 0x85EB]),
            (F32, Dcba, "49.98", &[0x85EB, 0x4742]),
            (Text, Abcd, "VX-40", &[0x5658, 0x2D34, 0x3000]),
            (Text, Badc, "VX", &[0x5856]),
        ] {
            let format = format(kind, order);
            let context = format!("{} {typed}", format.name());
            assert_eq!(format.encode(typed).unwrap(), registers, "{context}");
            let read = format.decode(registers);
            let expected = match typed.strip_prefix("0x") {
                Some(digits) => i64::from_str_radix(digits, 16).unwrap().to_string(),
                None if kind == Text => format!("{typed:?}"),
                None => typed.to_owned(),
            };
            assert_eq!(read[0].text(), expected, "{context}");
        }
        for (kind, wrong) in [
            (U16, &["-1", "65536", "1.5"][..]),
            (I16, &["40000"]),
            (U32, &["4294967296"]),
            (I32, &["0x"]),
            (F32, &["1e39", "nan", "0x10"]),
            (Text, &["", "é"]),
        ] {
            for typed in wrong {
                let refused = format(kind, Abcd).encode(typed);
                assert!(refused.is_err(), "{kind:?} {typed}: {refused:?}");
            }
        }
        assert!(Format::new(Text, Dcba).is_err() && Format::new(F32, Dcba).is_ok());
    }

    #[test]
    fn addresses_of_manuals_are_converted_where_unambiguous() {
        use CellTable::{Holding, Input};
        for (text, expected) in [
            ("0", Some((0, None))),
            ("0x2100", Some((0x2100, None))),
            ("40001", Some((40_001, None))),
            ("65535", Some((65_535, None))),
            ("4x1", Some((0, Some(Holding)))),
            ("4X0001", Some((0, Some(Holding)))),
            ("3x10", Some((9, Some(Input)))),
            ("400001", Some((0, Some(Holding)))),
            ("465536", Some((65_535, Some(Holding)))),
            ("300100", Some((99, Some(Input)))),
        ]
        .into_iter()
        .chain(["4x0", "4x65537", "400000", "465537", "65536", "-1", ""].map(|text| (text, None)))
        {
            let found = Address::parse(text).ok().map(|address| (address.number, address.table));
            assert_eq!(found, expected, "{text}");
        }
        let remark = Address::parse("4x0101").unwrap().remark();
        assert_eq!(remark.unwrap(), "4x0101 is holding register 100 of the protocol");
    }

    #[test]
    fn a_guess_has_the_true_reading_and_its_reason() {
        for (registers, expected) in [
            ([0x4247, 0xEB85], "400  f32 ABCD  49.98 "),
            ([0xE000, 0x4366], "400  f32 CDAB  230.875 "),
            ([0xA243, 0x00A0], "400  f32 BADC  325.25 "),
            ([0, 1500], "400  u32 ABCD  1500 "),
            ([0xFFFE, 0xFFFF], "400  i32 CDAB  -2 "),
            ([0x5658, 0x2D34], "400  text ABCD \"VX-4\" "),
            ([10, 20], "401  u16 ABCD  20 "),
        ] {
            let lines: Vec<String> = guesses(400, &registers).iter().map(Guess::line).collect();
            let is_there = lines.iter().any(|line| line.trim_start().starts_with(expected));
            assert!(is_there, "{expected} in {lines:#?}");
        }
        // Short decimals before long ones.
        let first = &guesses(400, &[0x4247, 0xEB85])[0];
        assert!(first.line().contains("49.98") && first.why.contains("short decimal"), "{first:?}");
    }
}

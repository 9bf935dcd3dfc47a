//! Registers to a raw number and back: types, word and byte order, packed bytes and bit fields.

use crate::settings::named;

named! {
    /// How a raw number lies in its registers.
    pub enum Kind {
        U16 = "u16",
        I16 = "i16",
        U32 = "u32",
        I32 = "i32",
        F32 = "f32",
    }
}

named! {
    /// Which of two comes first.
    #[derive(Default)]
    pub enum Order {
        #[default]
        HighFirst = "high_first",
        LowFirst = "low_first",
    }
}

named! {
    /// One of two values that share a register.
    pub enum Byte {
        High = "high",
        Low = "low",
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    pub kind: Kind,
    pub words: Order,
    /// `LowFirst`: the two bytes of each register are exchanged.
    pub bytes: Order,
    pub byte: Option<Byte>,
    /// First and last bit, counted from the lowest.
    pub bits: Option<(u8, u8)>,
}

impl Kind {
    pub const fn registers(self) -> u16 {
        match self {
            Self::U16 | Self::I16 => 1,
            Self::U32 | Self::I32 | Self::F32 => 2,
        }
    }

    pub const fn is_signed(self) -> bool {
        !matches!(self, Self::U16 | Self::U32)
    }
}

impl Layout {
    pub const fn plain(kind: Kind) -> Self {
        Self { kind, words: Order::HighFirst, bytes: Order::HighFirst, byte: None, bits: None }
    }

    pub const fn registers(&self) -> u16 {
        self.kind.registers()
    }

    /// The bits as they are, before a type is read into them; `None` where registers are missing.
    pub fn pattern(&self, registers: &[u16]) -> Option<u32> {
        let word = |word: u16| match self.bytes {
            Order::HighFirst => word,
            Order::LowFirst => word.swap_bytes(),
        };
        let whole = match (self.registers(), registers) {
            (1, [one, ..]) => u32::from(word(*one)),
            (2, [first, second, ..]) => {
                let (high, low) = match self.words {
                    Order::HighFirst => (word(*first), word(*second)),
                    Order::LowFirst => (word(*second), word(*first)),
                };
                (u32::from(high) << 16) | u32::from(low)
            }
            _ => return None,
        };
        let part = match self.byte {
            Some(Byte::High) => (whole >> 8) & 0xFF,
            Some(Byte::Low) => whole & 0xFF,
            None => whole,
        };
        Some(
            self.bits.map_or(part, |(first, last)| {
                (part >> first) & (u32::MAX >> (31 - (last - first)))
            }),
        )
    }

    pub const fn width(&self) -> u16 {
        match (self.bits, self.byte) {
            (Some((first, last)), _) => (last - first) as u16 + 1,
            (None, Some(_)) => 8,
            (None, None) => 16 * self.registers(),
        }
    }

    /// The raw number; not finite where a float register says so.
    pub fn number(&self, pattern: u32) -> f64 {
        if self.bits.is_some() {
            return f64::from(pattern);
        }
        let [.., high, low] = pattern.to_be_bytes();
        let word = u16::from_be_bytes([high, low]);
        match (self.kind, self.byte) {
            (Kind::I16, Some(_)) => f64::from(i8::from_be_bytes([low])),
            (Kind::I16, None) => f64::from(word.cast_signed()),
            (Kind::I32, _) => f64::from(pattern.cast_signed()),
            (Kind::F32, _) => f64::from(f32::from_bits(pattern)),
            (Kind::U16 | Kind::U32, _) => f64::from(pattern),
        }
    }

    /// The registers that hold a raw number, rounded; `None` where the type does not hold it.
    pub fn encode(&self, raw: f64) -> Option<Vec<u16>> {
        if !raw.is_finite() || self.byte.is_some() || self.bits.is_some() {
            return None;
        }
        let raw_whole = raw.round();
        let (lowest, highest) = match self.kind {
            Kind::U16 => (0.0, f64::from(u16::MAX)),
            Kind::I16 => (f64::from(i16::MIN), f64::from(i16::MAX)),
            Kind::U32 => (0.0, f64::from(u32::MAX)),
            Kind::I32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
            Kind::F32 => (f64::from(f32::MIN), f64::from(f32::MAX)),
        };
        if !(lowest..=highest).contains(&raw_whole) {
            return None;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the range was checked above"
        )]
        let pattern = match self.kind {
            Kind::F32 => (raw as f32).to_bits(),
            Kind::U16 | Kind::U32 => raw_whole as u32,
            Kind::I16 | Kind::I32 => (raw_whole as i32).cast_unsigned(),
        };
        let [b3, b2, b1, b0] = pattern.to_be_bytes();
        let (high, low) = (u16::from_be_bytes([b3, b2]), u16::from_be_bytes([b1, b0]));
        let mut registers = match (self.registers(), self.words) {
            (1, _) => vec![low],
            (_, Order::HighFirst) => vec![high, low],
            (_, Order::LowFirst) => vec![low, high],
        };
        if self.bytes == Order::LowFirst {
            for word in &mut registers {
                *word = word.swap_bytes();
            }
        }
        Some(registers)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn decode(layout: Layout, registers: &[u16]) -> f64 {
        layout.number(layout.pattern(registers).unwrap())
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "whole numbers are exact")]
    fn types_orders_bytes_and_bits_are_read_as_the_manual_says() {
        let plain = Layout::plain;
        let (mut low_first, mut swapped) = (plain(Kind::U32), plain(Kind::U16));
        (low_first.words, swapped.bytes) = (Order::LowFirst, Order::LowFirst);
        let (mut high, mut bits) = (plain(Kind::U16), plain(Kind::U16));
        (high.byte, bits.bits) = (Some(Byte::High), Some((3, 5)));
        for (layout, registers, number) in [
            (plain(Kind::U16), &[0xFFFF][..], 65_535.0),
            (plain(Kind::I16), &[0xFFFF], -1.0),
            (plain(Kind::I32), &[0xFFFF, 0xFFFE], -2.0),
            (plain(Kind::U32), &[1, 2], 65_538.0),
            (plain(Kind::F32), &[0x41C8, 0], 25.0),
            (low_first, &[2, 1], 65_538.0),
            (swapped, &[0x0100], 1.0),
            (high, &[0x1234], 18.0),
            (bits, &[0b0010_1000], 5.0),
        ] {
            assert_eq!(decode(layout, registers), number, "{layout:?}");
        }
        assert_eq!(plain(Kind::I32).pattern(&[1]), None);
        for (kind, raw) in [(Kind::U16, -1.0), (Kind::U16, 65_536.0), (Kind::I16, f64::NAN)] {
            assert_eq!(plain(kind).encode(raw), None);
        }
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded(raw in -40_000_i32..70_000, kind in 0..4_usize, low_first: bool, swapped: bool) {
            let order = |flag| if flag { Order::LowFirst } else { Order::HighFirst };
            let layout = Layout {
                words: order(low_first),
                bytes: order(swapped),
                ..Layout::plain([Kind::U16, Kind::I16, Kind::U32, Kind::I32][kind])
            };
            match layout.encode(f64::from(raw)) {
                Some(registers) => prop_assert!((decode(layout, &registers) - f64::from(raw)).abs() < 1e-9),
                None => prop_assert!(raw < 0 || raw > i32::from(i16::MAX)),
            }
        }
    }
}

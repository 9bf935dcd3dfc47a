//! Cells to a raw number and back: types, word and byte order, packed bytes and bit fields.

use crate::settings::named;

named! {
    /// How a raw number lies in its cells.
    #[derive(Default)]
    pub enum Kind {
        U8 = "u8",
        I8 = "i8",
        U16 = "u16",
        I16 = "i16",
        U32 = "u32",
        I32 = "i32",
        #[default]
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

/// What one cell of a bus holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CellSize {
    #[default]
    Register,
    Byte,
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
    pub cell: CellSize,
    pub words: Order,
    /// `LowFirst`: the two bytes of each register are exchanged; all bytes where each is a cell.
    pub bytes: Order,
    pub byte: Option<Byte>,
    /// First and last bit, counted from the lowest.
    pub bits: Option<(u8, u8)>,
}

impl Kind {
    pub const fn bytes(self) -> u16 {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
        }
    }

    pub const fn is_signed(self) -> bool {
        !matches!(self, Self::U8 | Self::U16 | Self::U32)
    }
}

impl Layout {
    pub const fn plain(kind: Kind) -> Self {
        let order = Order::HighFirst;
        Self { kind, cell: CellSize::Register, words: order, bytes: order, byte: None, bits: None }
    }

    pub const fn cells(&self) -> u16 {
        let bytes = self.kind.bytes();
        match self.cell {
            CellSize::Byte => bytes,
            CellSize::Register => bytes.div_ceil(2),
        }
    }

    /// Orders cells as the drive has them into those of the highest first, and back.
    fn ordered(self, cells: &mut [u16]) {
        match (self.cell, self.words, self.bytes) {
            (CellSize::Byte, _, Order::HighFirst) => {}
            (CellSize::Byte, _, Order::LowFirst) => cells.reverse(),
            (CellSize::Register, words, bytes) => {
                if words == Order::LowFirst {
                    cells.reverse();
                }
                if bytes == Order::LowFirst {
                    for cell in cells {
                        *cell = cell.swap_bytes();
                    }
                }
            }
        }
    }

    const fn cell_bits(self) -> u32 {
        match self.cell {
            CellSize::Byte => 8,
            CellSize::Register => 16,
        }
    }

    /// The bits as they are, before a type is read into them; `None` where cells are missing.
    pub fn pattern(&self, cells: &[u16]) -> Option<u32> {
        let mut cells = cells.get(..self.cells().into())?.to_vec();
        self.ordered(&mut cells);
        let bits = self.cell_bits();
        let whole = cells.iter().fold(0, |whole, cell| (whole << bits) | u32::from(*cell));
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
            (None, None) => 8 * self.kind.bytes(),
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
            (Kind::I16, Some(_)) | (Kind::I8, _) => f64::from(i8::from_be_bytes([low])),
            (Kind::I16, None) => f64::from(word.cast_signed()),
            (Kind::I32, _) => f64::from(pattern.cast_signed()),
            (Kind::F32, _) => f64::from(f32::from_bits(pattern)),
            (Kind::U8 | Kind::U16 | Kind::U32, _) => f64::from(pattern),
        }
    }

    /// The cells that hold a raw number, rounded; `None` where the type does not hold it.
    pub fn encode(&self, raw: f64) -> Option<Vec<u16>> {
        if !raw.is_finite() || self.byte.is_some() || self.bits.is_some() {
            return None;
        }
        let raw_whole = raw.round();
        let (lowest, highest) = match self.kind {
            Kind::U8 => (0.0, f64::from(u8::MAX)),
            Kind::I8 => (f64::from(i8::MIN), f64::from(i8::MAX)),
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
            Kind::U8 | Kind::U16 | Kind::U32 => raw_whole as u32,
            Kind::I8 | Kind::I16 | Kind::I32 => (raw_whole as i32).cast_unsigned(),
        };
        let bytes = pattern.to_be_bytes();
        let [b3, b2, b1, b0] = bytes;
        let all = match self.cell {
            CellSize::Byte => bytes.map(u16::from).to_vec(),
            CellSize::Register => vec![u16::from_be_bytes([b3, b2]), u16::from_be_bytes([b1, b0])],
        };
        let mut cells = all[all.len() - usize::from(self.cells())..].to_vec();
        self.ordered(&mut cells);
        Some(cells)
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
        let of_bytes = |kind, bytes| Layout { cell: CellSize::Byte, bytes, ..plain(kind) };
        for (layout, registers, number) in [
            (of_bytes(Kind::U8, Order::LowFirst), &[0xC8][..], 200.0),
            (of_bytes(Kind::I8, Order::LowFirst), &[0xFF], -1.0),
            (of_bytes(Kind::I16, Order::LowFirst), &[0xFE, 0xFF], -2.0),
            (of_bytes(Kind::I32, Order::HighFirst), &[0xFF, 0xFF, 0xFF, 0xFD], -3.0),
            (of_bytes(Kind::U32, Order::LowFirst), &[1, 2, 0, 0], 513.0),
            (plain(Kind::U16), &[0xFFFF], 65_535.0),
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
        fn what_is_encoded_is_decoded(
            raw in -40_000_i32..70_000, kind in 0..4_usize, low_first: bool, swapped: bool, of_bytes: bool
        ) {
            let order = |flag| if flag { Order::LowFirst } else { Order::HighFirst };
            let layout = Layout {
                cell: if of_bytes { CellSize::Byte } else { CellSize::Register },
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

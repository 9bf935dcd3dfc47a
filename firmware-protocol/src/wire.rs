//! Where typed values are written to and read from: a block of registers, or the bytes of a stream message.
//!
//! A scaled one-word register travels on the stream as i32 with 1000 times finer steps;
//! everything else travels as it stands in the register. The numbers are big-endian, as the words are.

use crate::registers::{Kind, Register};

pub(crate) trait Sink {
    fn raw(&mut self, register: &Register, raw: i64);

    fn value(&mut self, register: &Register, value: f64) {
        self.raw(register, register.encode(value));
    }
}

pub(crate) trait Source {
    fn raw(&mut self, register: &Register) -> i64;

    fn value(&mut self, register: &Register) -> f64 {
        register.decode(self.raw(register))
    }

    /// The register is one word: the number fits.
    fn u16(&mut self, register: &Register) -> u16 {
        u16::try_from(self.raw(register)).unwrap_or(u16::MAX)
    }

    /// The register is unsigned: the number fits.
    fn u32(&mut self, register: &Register) -> u32 {
        u32::try_from(self.raw(register)).unwrap_or(u32::MAX)
    }
}

/// A block of registers to be filled.
pub(crate) struct WordsMut<'a> {
    pub(crate) block: &'a mut [u16],
    pub(crate) base: u16,
}

impl Sink for WordsMut<'_> {
    fn raw(&mut self, register: &Register, raw: i64) {
        register.put(self.block, self.base, raw);
    }
}

/// A block of registers to be read.
pub(crate) struct Words<'a> {
    pub(crate) block: &'a [u16],
    pub(crate) base: u16,
}

impl Source for Words<'_> {
    fn raw(&mut self, register: &Register) -> i64 {
        register.get(self.block, self.base)
    }
}

/// The register as the stream carries it.
pub(crate) fn on_stream(register: &Register) -> Register {
    if register.kind.words() == 1 && register.steps_per_unit() > 1.0 {
        Register {
            scale: register.scale / 1000.0,
            kind: Kind::I32,
            min: Kind::I32.lowest() + 1,
            max: Kind::I32.highest(),
            ..*register
        }
    } else {
        *register
    }
}

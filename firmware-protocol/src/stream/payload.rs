//! Payload of a message: values behind one another, as the register table has them or in finer steps.

use super::MAX_PLAIN;
use crate::bytes::Bytes;
use crate::registers as r;
use crate::registers::Register;
use crate::wire::{Sink, Source, on_stream};

/// A frame before its stuffing; it holds the longest payload.
pub(super) type Plain = Bytes<MAX_PLAIN>;

impl Plain {
    pub(super) fn words(&mut self, words: &[u16]) {
        for word in words {
            self.extend(&word.to_be_bytes());
        }
    }
}

impl Sink for Plain {
    fn raw(&mut self, register: &Register, raw: i64) {
        // The frame's header carries the time.
        if *register == r::TIME {
            return;
        }
        let bytes = raw.to_be_bytes();
        self.extend(&bytes[8 - 2 * usize::from(register.kind.words())..]);
    }

    fn value(&mut self, register: &Register, value: f64) {
        let register = on_stream(register);
        self.raw(&register, register.encode(value));
    }
}

/// Takes a payload apart. After the end it gives zeros and remembers that it did.
pub(super) struct Reader<'a> {
    rest: &'a [u8],
    time_us: u32,
    short: bool,
}

impl<'a> Reader<'a> {
    pub(super) const fn new(payload: &'a [u8], time_us: u32) -> Self {
        Self { rest: payload, time_us, short: false }
    }

    /// Neither a byte too few nor one too many.
    pub(super) const fn is_used_up(&self) -> bool {
        self.rest.is_empty() && !self.short
    }

    pub(super) fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let Some((bytes, rest)) = self.rest.split_first_chunk() else {
            self.short = true;
            return None;
        };
        self.rest = rest;
        Some(*bytes)
    }

    pub(super) fn words<const N: usize>(&mut self) -> Option<[u16; N]> {
        let mut words = [0; N];
        for word in &mut words {
            *word = u16::from_be_bytes(self.bytes()?);
        }
        Some(words)
    }
}

impl Source for Reader<'_> {
    fn raw(&mut self, register: &Register) -> i64 {
        if *register == r::TIME {
            return self.time_us.into();
        }
        let words = if register.kind.words() == 1 {
            self.words::<1>().map(|[word]| [word, 0])
        } else {
            self.words::<2>()
        };
        let [first, second] = words.unwrap_or_default();
        register.kind.number(first, second)
    }

    fn value(&mut self, register: &Register) -> f64 {
        let register = on_stream(register);
        let raw = self.raw(&register);
        register.decode(raw)
    }
}

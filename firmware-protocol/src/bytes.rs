//! Bytes of a frame or of a part of one, of which there may be so many: without an allocator nothing grows further.

use core::ops::{Deref, DerefMut};

/// At most `N` bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes<const N: usize> {
    room: [u8; N],
    length: usize,
}

impl<const N: usize> Bytes<N> {
    pub(crate) const EMPTY: Self = Self { room: [0; N], length: 0 };

    /// These; what has no room is cut.
    pub(crate) fn of(bytes: &[u8]) -> Self {
        let mut all = Self::EMPTY;
        all.extend(bytes);
        all
    }

    /// Puts more behind them; what has no room is cut.
    pub(crate) fn extend(&mut self, more: &[u8]) {
        let count = more.len().min(N - self.length);
        self.room[self.length..self.length + count].copy_from_slice(&more[..count]);
        self.length += count;
    }
}

impl<const N: usize> Deref for Bytes<N> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.room[..self.length]
    }
}

impl<const N: usize> DerefMut for Bytes<N> {
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut self.room[..self.length]
    }
}

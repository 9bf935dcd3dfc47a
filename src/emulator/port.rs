//! What a session needs of its transport: bytes in within a deadline, bytes out without blocking the plant.

use std::time::Duration;

/// The host has gone; what it wrote before was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Gone;

/// One connection to a host.
pub(super) trait Port {
    /// Waits at most `timeout` for bytes; 0: none came.
    fn read_within(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, Gone>;

    /// Hands over what the host has room for; returns the bytes that were taken.
    fn write(&mut self, bytes: &[u8]) -> usize;
}

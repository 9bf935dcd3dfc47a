//! Exponential backoff of the polling of a busy drive. Pure: its input is host time.

use super::link::{LinkError, Result};
use super::reopen::Backoff;

/// Exceptions of a device that cannot answer now: failure, acknowledge, busy, and those of a gateway
/// (Modbus Application Protocol 1.1b3, 7).
pub(super) const fn is_busy(code: u8) -> bool {
    matches!(code, 0x04..=0x06 | 0x0A | 0x0B)
}

/// The pauses, the time until which the drive is not polled, s, and the last refusal.
#[derive(Clone, Debug, Default)]
pub(super) struct PollingBackoff(Option<(Backoff, f64, LinkError)>);

impl PollingBackoff {
    /// Whether it may be polled at `now_s`; else the last refusal.
    pub(super) fn check(&self, now_s: f64) -> Result<()> {
        match &self.0 {
            Some((_, until_s, refusal)) if now_s < *until_s => Err(refusal.clone()),
            _ => Ok(()),
        }
    }

    /// Takes the result of an exchange that ended at `now_s`.
    pub(super) fn note<T>(&mut self, now_s: f64, result: &Result<T>) {
        match result {
            Err(error @ LinkError::Exception { code, .. }) if is_busy(*code) => {
                let seed = u64::from(*code);
                // Shortest and longest pause, s: all of them are shorter than the silence that ends a run.
                let fresh = || Backoff::between(0.005, 0.08, seed);
                let mut backoff = self.0.take().map_or_else(fresh, |(backoff, ..)| backoff);
                let until_s = now_s + backoff.pause_s();
                self.0 = Some((backoff, until_s, error.clone()));
            }
            Ok(_) => self.0 = None,
            Err(_) => {}
        }
    }
}

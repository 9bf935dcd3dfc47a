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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exceptions::Requested;

    fn refused(code: u8) -> Result<()> {
        Err(LinkError::Exception {
            link: "x".to_owned(),
            request: "read".to_owned(),
            code,
            name: "busy",
            requested: Requested::default(),
        })
    }

    #[test]
    fn a_busy_drive_is_asked_less_and_less_often_until_it_answers() {
        let mut polling_backoff = PollingBackoff::default();
        let mut now_s = 0.0;
        let mut asked = Vec::new();
        while now_s < 1.0 {
            if polling_backoff.check(now_s).is_ok() {
                asked.push(now_s);
                polling_backoff.note(now_s, &refused(6));
            }
            now_s += 0.001;
        }
        let gaps: Vec<f64> = asked.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(gaps[0] < 0.008, "{gaps:?}");
        assert!((0.06..0.102).contains(gaps.last().unwrap()), "{gaps:?}");
        assert!(asked.len() < 25, "{}", asked.len());
        polling_backoff.note(now_s, &Ok(()));
        polling_backoff.note(now_s, &refused(2));
        assert!(polling_backoff.check(now_s).is_ok(), "02 is no busy drive");
    }
}

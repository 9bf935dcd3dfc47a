//! A busy drive is polled less often until it answers again. Pure: host time goes in.

use super::link::{LinkError, Result};
use super::reopen::Backoff;

/// Exceptions of a device that cannot answer now: failure, acknowledge, busy, and those of a gateway
/// (Modbus Application Protocol 1.1b3, 7).
pub(super) const fn is_busy(code: u8) -> bool {
    matches!(code, 0x04..=0x06 | 0x0A | 0x0B)
}

/// The last refusal, and until when the drive is not polled.
#[derive(Clone, Debug, Default)]
pub(super) struct Patience(Option<(Backoff, f64, LinkError)>);

impl Patience {
    /// Whether it may be polled at `now_s`; else the last refusal.
    pub(super) fn check(&self, now_s: f64) -> Result<()> {
        match &self.0 {
            Some((_, until_s, said)) if now_s < *until_s => Err(said.clone()),
            _ => Ok(()),
        }
    }

    /// What came of a question that ended at `now_s`.
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

    fn refused(code: u8) -> Result<()> {
        Err(LinkError::Exception {
            link: "x".to_owned(),
            request: "read".to_owned(),
            code,
            name: "busy",
        })
    }

    #[test]
    fn a_busy_drive_is_asked_less_and_less_often_until_it_answers() {
        let mut patience = Patience::default();
        let mut now_s = 0.0;
        let mut asked = Vec::new();
        while now_s < 1.0 {
            if patience.check(now_s).is_ok() {
                asked.push(now_s);
                patience.note(now_s, &refused(6));
            }
            now_s += 0.001;
        }
        let gaps: Vec<f64> = asked.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(gaps[0] < 0.008, "{gaps:?}");
        assert!((0.06..0.102).contains(gaps.last().unwrap()), "{gaps:?}");
        assert!(asked.len() < 25, "{}", asked.len());
        patience.note(now_s, &Ok(()));
        patience.note(now_s, &refused(2));
        assert!(patience.check(now_s).is_ok(), "02 is no busy drive");
    }
}

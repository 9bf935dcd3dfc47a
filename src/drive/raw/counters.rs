//! What became of every request.

use serde::Serialize;

/// Every request ends in exactly one class: `sent` is the sum of `ok` to `aborted`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RawCounters {
    pub sent: u64,
    pub ok: u64,
    pub timeout: u64,
    /// Bytes without a valid frame came.
    pub crc: u64,
    /// Replies to earlier requests came, or the answer could not be vouched for afterwards.
    pub stale: u64,
    /// Whole frames came that answer nothing that was asked.
    pub mismatch: u64,
    /// The unit refused.
    pub exception: u64,
    /// The port broke meanwhile.
    pub aborted: u64,
    /// Requests among `sent` that only proved that the line is in step.
    pub probes: u64,
    pub resynchronisations: u64,
    pub bytes_sent: u64,
    pub bytes_received: u64,
    /// Received bytes that belonged to no accepted reply.
    pub bytes_dropped: u64,
    /// The line returns our own requests (two-wire RS-485 without echo suppression).
    pub echoes: bool,
}

/// The class that a request ended in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Class {
    Ok,
    Timeout,
    Crc,
    Stale,
    Mismatch,
    Exception,
    Aborted,
}

impl RawCounters {
    /// The accounting invariant: nothing that was sent is unaccounted for.
    pub const fn balances(&self) -> bool {
        self.sent
            == self.ok
                + self.timeout
                + self.crc
                + self.stale
                + self.mismatch
                + self.exception
                + self.aborted
    }

    pub(super) fn book(&mut self, class: Class) {
        self.sent += 1;
        *match class {
            Class::Ok => &mut self.ok,
            Class::Timeout => &mut self.timeout,
            Class::Crc => &mut self.crc,
            Class::Stale => &mut self.stale,
            Class::Mismatch => &mut self.mismatch,
            Class::Exception => &mut self.exception,
            Class::Aborted => &mut self.aborted,
        } += 1;
    }

    /// So many answers that were taken turn out to be doubtful.
    pub(super) fn withdraw(&mut self, answers: u64) {
        let answers = answers.min(self.ok);
        self.ok -= answers;
        self.stale += answers;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_class_keeps_the_balance_and_withdrawing_moves_and_never_loses() {
        let mut counters = RawCounters::default();
        for class in [
            Class::Ok,
            Class::Ok,
            Class::Timeout,
            Class::Crc,
            Class::Stale,
            Class::Mismatch,
            Class::Exception,
            Class::Aborted,
        ] {
            counters.book(class);
            assert!(counters.balances(), "{class:?}");
        }
        counters.withdraw(5);
        assert_eq!((counters.ok, counters.stale, counters.sent), (0, 3, 8));
        assert!(counters.balances());
    }
}

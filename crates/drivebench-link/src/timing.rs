//! Deadlines and silences of a line, and waits with an error below 0.1 ms.

use std::time::{Duration, Instant};

use super::settings::{Framing, LinkSettings};
use super::waiting::{now, skip_to};

/// Delay of an adapter until it is measured (the latency timer of FTDI is 16 ms); also the most that a busy host may add.
const ADAPTER_DELAY: Duration = Duration::from_millis(16);

/// What a converter adds until it hands a frame on (packing time-outs of 10 to 50 ms), with a round trip of a local network.
const CONVERTER_DELAY: Duration = Duration::from_millis(60);

/// Silence between frames by the standard, s.
pub fn standard_gap_s(baud: u32, framing: Framing) -> f64 {
    // 3.5 characters, and a fixed time above 19200 baud (MODBUS over Serial Line V1.02, 2.5.1.1).
    if baud > 19_200 { 0.001_75 } else { 3.5 * char_s(baud, framing) }
}

pub(super) fn char_s(baud: u32, framing: Framing) -> f64 {
    f64::from(framing.bits_per_char()) / f64::from(baud.max(1))
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LineTiming {
    /// Time of one character, s; 0: not a serial line.
    char_s: f64,
    gap_s: f64,
    reply: Duration,
    /// What adapter and host add to an exchange at the most.
    adapter: Duration,
    /// What a network with a converter adds besides; never measured away.
    network: Duration,
    deadline: Option<Duration>,
}

impl LineTiming {
    /// A serial line; `with_gaps`: silence separates frames.
    pub(super) fn serial(settings: &LinkSettings, baud: u32, with_gaps: bool) -> Self {
        let gap_s =
            settings.gap_us.map_or_else(|| standard_gap_s(baud, settings.framing), |us| us * 1e-6);
        Self {
            char_s: char_s(baud, settings.framing),
            gap_s: if with_gaps { gap_s } else { 0.0 },
            ..Self::network(settings)
        }
    }

    pub(super) fn network(settings: &LinkSettings) -> Self {
        Self {
            char_s: 0.0,
            gap_s: 0.0,
            reply: seconds(settings.reply_ms * 1e-3),
            adapter: ADAPTER_DELAY,
            network: Duration::ZERO,
            deadline: settings.deadline_ms.map(|ms| seconds(ms * 1e-3)),
        }
    }

    /// A serial line behind a converter on a network: the times of both.
    pub(super) fn converter(settings: &LinkSettings, baud: u32) -> Self {
        Self { network: CONVERTER_DELAY, ..Self::serial(settings, baud, true) }
    }

    /// The same with another silence before a request.
    pub(super) const fn with_gap(self, gap_s: f64) -> Self {
        Self { gap_s, ..self }
    }

    /// Replaces the delay of the slowest adapter by the measured `longest_lag` of replies beyond their wire time, from which deadlines
    /// and silences follow.
    pub(super) fn measured(&mut self, longest_lag: Duration) {
        self.adapter = longest_lag.clamp(Duration::from_millis(4), ADAPTER_DELAY);
    }

    pub(super) fn wire(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        seconds((request_bytes + reply_bytes) as f64 * self.char_s)
    }

    /// Between which instants the drive acted on a request: it has all of it, and its reply has not begun. An adapter hands bytes on
    /// in pieces, so the first byte of a reply came earlier than its piece by the time of those behind it. An exchange
    /// quicker than the baud rate was on no such line (a pseudo-terminal): it keeps the instants of the host.
    pub(super) fn acted(
        &self,
        (request_bytes, reply_bytes): (usize, usize),
        (asked, answered, complete): (Instant, Instant, Instant),
    ) -> (Instant, Instant) {
        let (out, back) =
            (self.wire(request_bytes, 0), self.wire(0, reply_bytes.saturating_sub(1)));
        if complete.saturating_duration_since(asked) < out + back {
            return (asked, answered);
        }
        (asked + out, complete.checked_sub(back).map_or(answered, |begun| answered.min(begun)))
    }

    /// Longest time of so many answers that follow one another.
    pub(super) fn answers(&self, count: u32) -> Duration {
        count * self.reply
    }

    pub(super) const fn network_delay(&self) -> Duration {
        self.network
    }

    pub(super) fn gap(&self) -> Duration {
        seconds(self.gap_s)
    }

    /// Silence after which nothing of an earlier exchange can come any more from a drive that keeps its times.
    pub(super) fn quiet(&self) -> Duration {
        self.gap() + 2 * self.reply + self.adapter + self.network
    }

    pub(super) fn allowed(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        self.deadline.unwrap_or_else(|| self.unhurried(request_bytes, reply_bytes))
    }

    /// Time of an exchange within a cycle of a run: after a lost reply the request is repeated before the silence would end the run.
    pub(super) fn hurried(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        self.deadline.unwrap_or_else(|| self.brief(request_bytes, reply_bytes))
    }

    /// Time of an urgent request: one turnaround and the delay of an adapter.
    pub(super) fn brief(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        let wire_s = (request_bytes + reply_bytes) as f64 * self.char_s + self.gap_s;
        seconds(wire_s) + self.reply + self.adapter + self.network
    }

    /// Time for an exchange outside the cycles of a run, whose deadline it does not have to keep.
    pub(super) fn unhurried(&self, request_bytes: usize, reply_bytes: usize) -> Duration {
        let wire_s = (request_bytes + reply_bytes) as f64 * self.char_s + 2.0 * self.gap_s;
        // What adapter, kernel and host may add to an exchange.
        seconds(wire_s) + 2 * self.reply + Duration::from_millis(40) + self.network
    }

    /// Wire time of an exchange with its silences, s: what no drive can do better. How long this one takes to reply is
    /// measured, and often far below what its profile allows. `None` without a line.
    pub(super) fn shortest_cycle_s(&self, request_bytes: usize, reply_bytes: usize) -> Option<f64> {
        let wire_s = (request_bytes + reply_bytes) as f64 * self.char_s + 2.0 * self.gap_s;
        (self.char_s > 0.0).then_some(wire_s)
    }
}

/// Waits until `at`: sleeps until 0.3 ms before, the usual delay of a wake-up, and polls the clock for the rest, because a gap that
/// is 0.1 ms too long already costs one request in twenty.
pub(super) fn wait_until(at: Instant) {
    if skip_to(at) {
        return;
    }
    let left = at.saturating_duration_since(now());
    std::thread::sleep(left.saturating_sub(Duration::from_micros(300)));
    while now() < at {
        std::hint::spin_loop();
    }
}

/// Settings are checked to be finite and not negative.
fn seconds(time_s: f64) -> Duration {
    Duration::try_from_secs_f64(time_s).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DriveProfile;

    #[test]
    fn an_exchange_at_115200_takes_its_wire_time() {
        let settings = DriveProfile::named("own").unwrap().link;
        let timing = LineTiming::serial(&settings, 115_200, true);
        let expected = 58.0 * 10.0 / 115_200.0 + 2.0 * 0.001_75;
        assert!((timing.shortest_cycle_s(21, 37).unwrap() - expected).abs() < 1e-12);
        let slow = LineTiming::serial(&settings, 9600, true);
        assert!((slow.gap().as_secs_f64() - 3.5 * 10.0 / 9600.0).abs() < 1e-8);
        assert_eq!(LineTiming::network(&settings).shortest_cycle_s(21, 37), None);
        assert_eq!(LineTiming::serial(&settings, 9600, false).gap(), Duration::ZERO);
    }

    #[test]
    fn waiting_is_never_too_short() {
        for us in [0, 50, 300, 1750] {
            let at = now() + Duration::from_micros(us);
            wait_until(at);
            assert!(now() >= at);
        }
    }
}

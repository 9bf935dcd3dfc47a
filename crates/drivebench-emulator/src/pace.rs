//! Timing of a serial line: without it a pseudo-terminal would be a hundred times faster than a real line.
//!
//! ```text
//! host writes   |rrrrrrrr|                      request, one character after the other
//! drive                  ^applied |gap|turnaround|aaaaaaaaaaaa|  answer
//! host reads                                                  ^  the whole answer
//! ```

use super::config::LineConfig;

/// One line: when it is free again, and what travels how long. Times are those of the caller's clock, s.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    char_s: f64,
    gap_s: f64,
    turnaround_s: f64,
    late: Late,
    free_from_s: f64,
}

/// Answers that come late, evenly spread over all of them.
#[derive(Clone, Copy, Debug, Default)]
struct Late {
    share: f64,
    by_s: f64,
    /// Part of a late answer that is due.
    due: f64,
}

impl Late {
    fn of(line: &LineConfig) -> Self {
        Self { share: line.late_share, by_s: line.late_ms * 1e-3, due: 0.0 }
    }

    /// What the next answer is late by, s.
    fn next_s(&mut self) -> f64 {
        self.due += self.share;
        if self.due < 1.0 {
            return 0.0;
        }
        self.due -= 1.0;
        self.by_s
    }
}

impl Pace {
    /// A serial line; `with_gaps`: silence separates frames.
    pub(super) fn serial(line: &LineConfig, with_gaps: bool) -> Self {
        let char_s =
            if line.baud == 0 { 0.0 } else { f64::from(line.bits_per_char) / f64::from(line.baud) };
        let standard_gap_s = match line.baud {
            0 => 0.0,
            baud if baud > 19_200 => 0.001_75,
            // Characters of silence that end a Modbus RTU frame, and the fixed time above 19200 baud
            // (MODBUS over Serial Line V1.02, 2.5.1.1).
            _ => 3.5 * char_s,
        };
        let gap_s = line.gap_us.map_or(standard_gap_s, |us| us * 1e-6);
        Self {
            char_s,
            gap_s: if with_gaps { gap_s } else { 0.0 },
            turnaround_s: line.turnaround_ms * 1e-3,
            late: Late::of(line),
            free_from_s: f64::NEG_INFINITY,
        }
    }

    /// A network connection: only the drive itself takes time.
    pub(super) fn network(line: &LineConfig) -> Self {
        Self { char_s: 0.0, ..Self::serial(line, false) }
    }

    /// Silence that ends a frame, s.
    pub(super) const fn gap_s(&self) -> f64 {
        self.gap_s
    }

    pub(super) const fn wire_s(&self, bytes: usize) -> f64 {
        bytes as f64 * self.char_s
    }

    /// When a byte that the host hands over at `now_s` begins to travel.
    pub(super) const fn departure_s(&self, now_s: f64) -> f64 {
        self.free_from_s.max(now_s)
    }

    /// When the next byte of the host, handed over at `now_s`, has come in as a whole.
    pub(super) const fn arrival_s(&mut self, now_s: f64) -> f64 {
        self.free_from_s = self.free_from_s.max(now_s) + self.char_s;
        self.free_from_s
    }

    /// The same of the last of so many bytes.
    pub(super) fn arrived_s(&mut self, now_s: f64, bytes: usize) -> f64 {
        (0..bytes).fold(now_s, |_, _| self.arrival_s(now_s))
    }

    /// When an answer of `bytes` to a request that ended at `end_s` has arrived; the line is busy until the gap after it.
    pub(super) fn delivery_s(&mut self, end_s: f64, bytes: usize) -> f64 {
        let thinks_s = self.turnaround_s + self.late.next_s();
        let start = self.free_from_s.max(end_s) + self.gap_s + thinks_s;
        let delivered = start + bytes as f64 * self.char_s;
        self.free_from_s = delivered + self.gap_s;
        delivered
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exchange_s(line: &LineConfig, with_gaps: bool, request: usize, answer: usize) -> f64 {
        let mut pace = Pace::serial(line, with_gaps);
        let end = pace.arrived_s(10.0, request);
        pace.delivery_s(end, answer) - 10.0
    }

    #[test]
    fn an_exchange_takes_its_wire_time() {
        let line = |baud, bits_per_char, turnaround_ms| LineConfig {
            baud,
            bits_per_char,
            turnaround_ms,
            ..LineConfig::default()
        };
        // FC23 r16 w4: 21 + 37 characters of 86.8 us, one gap, turnaround. Slow lines have a gap of 3.5 characters.
        let without_gap_s = 58.0 * 10.0 / 115_200.0 + 0.000_5;
        for (line, with_gaps, request, answer, expected_s) in [
            (line(115_200, 10, 0.5), true, 21, 37, without_gap_s + 0.001_75),
            (line(115_200, 10, 0.5), false, 21, 37, without_gap_s),
            (line(9600, 10, 0.0), true, 8, 25, (33.0 + 3.5) * 10.0 / 9600.0),
            (line(9600, 11, 0.0), true, 8, 25, (33.0 + 3.5) * 11.0 / 9600.0),
            (line(0, 10, 0.5), true, 21, 37, 0.000_5),
        ] {
            let took_s = exchange_s(&line, with_gaps, request, answer);
            assert!((took_s - expected_s).abs() < 1e-12, "{line:?}: {took_s}");
        }
        assert!((Pace::network(&line(115_200, 10, 0.5)).arrival_s(1.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn so_many_answers_come_late_and_the_others_in_time() {
        let line = LineConfig { late_share: 0.01, late_ms: 30.0, ..LineConfig::default() };
        let mut pace = Pace::serial(&line, true);
        let taken = (0..1000).map(|exchange| {
            let begin = f64::from(exchange);
            let end = pace.arrival_s(begin);
            pace.delivery_s(end, 10) - begin
        });
        assert_eq!(taken.filter(|taken_s| *taken_s > 0.03).count(), 10);
    }
}

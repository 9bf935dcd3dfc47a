//! What a serial line can carry, by arithmetic (LINKS.md 2.1): times of characters, gaps, adapter and drive.

use serde::Serialize;

use super::super::profile::Framing;

/// Characters of silence that end a frame, and the fixed time above 19200 baud (MODBUS over Serial Line V1.02, 2.5.1.1).
const GAP_CHARS: f64 = 3.5;
const FIXED_GAP_S: f64 = 0.001_75;
const FIXED_GAP_ABOVE_BAUD: u32 = 19_200;
/// Registers of the loops that are reckoned with: ten read, two written (what a drive's cycle needs).
const READ: f64 = 10.0;
const WRITTEN: f64 = 2.0;

/// Silence between frames that the standard asks for, s.
pub fn standard_gap_s(baud: u32, framing: Framing) -> f64 {
    if baud > FIXED_GAP_ABOVE_BAUD {
        FIXED_GAP_S
    } else {
        GAP_CHARS * char_s(baud, framing)
    }
}

fn char_s(baud: u32, framing: Framing) -> f64 {
    f64::from(framing.bits_per_char()) / f64::from(baud.max(1))
}

/// A line and who is at its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredLine {
    pub baud: u32,
    pub framing: Framing,
    /// Silence before a request and before a reply, s.
    pub gap_s: f64,
    /// What drive, adapter and host add to one exchange, s.
    pub added_s: f64,
}

/// Loop rates that a line can carry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LoopRates {
    /// One request of function code 23 a cycle: ten registers read, two written.
    pub read_write_hz: f64,
    /// A write of four registers and a read of ten a cycle, two requests.
    pub write_then_read_hz: f64,
}

impl MeasuredLine {
    /// Time on the wire of a request and its reply with both gaps, s.
    pub fn exchange_s(&self, request_bytes: f64, reply_bytes: f64) -> f64 {
        (request_bytes + reply_bytes) * char_s(self.baud, self.framing)
            + 2.0 * self.gap_s
            + self.added_s
    }

    /// Time of a read of so many registers, s: function code 3, 8 bytes asked and 5 + 2 n answered.
    pub fn read_s(&self, registers: u16) -> f64 {
        self.exchange_s(8.0, 5.0 + 2.0 * f64::from(registers))
    }

    pub fn rates(&self) -> LoopRates {
        let both = self.exchange_s(13.0 + 2.0 * WRITTEN, 5.0 + 2.0 * READ);
        let write = self.exchange_s(9.0 + 8.0, 8.0);
        LoopRates {
            read_write_hz: both.recip(),
            write_then_read_hz: (write + self.exchange_s(8.0, 5.0 + 2.0 * READ)).recip(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table of LINKS.md 2.1: strict gap, 0.5 ms drive, 1.2 ms USB.
    #[test]
    fn the_arithmetic_is_that_of_the_table() {
        for (baud, read_write, two_requests) in [
            (9600, 18.0, 13.0),
            (38_400, 62.0, 39.0),
            (115_200, 113.0, 65.0),
            (921_600, 177.0, 91.0),
        ] {
            let framing = Framing::EightNoneOne;
            let budget = MeasuredLine {
                baud,
                framing,
                gap_s: standard_gap_s(baud, framing),
                added_s: 0.5e-3 + 1.2e-3,
            };
            let rates = budget.rates();
            assert!(
                (rates.read_write_hz - read_write).abs() < 1.0,
                "{baud} {rates:?}"
            );
            assert!(
                (rates.write_then_read_hz - two_requests).abs() < 1.0,
                "{baud} {rates:?}"
            );
        }
    }

    #[test]
    fn parity_costs_a_tenth() {
        let of = |framing| MeasuredLine {
            baud: 9600,
            framing,
            gap_s: 0.0,
            added_s: 0.0,
        };
        let ratio = of(Framing::EightEvenOne).read_s(10) / of(Framing::EightNoneOne).read_s(10);
        assert!((ratio - 1.1).abs() < 1e-12);
    }
}

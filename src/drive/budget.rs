//! How many exchanges a line carries, by arithmetic: before a port is opened, and beside what is measured.

use serde::Serialize;

use super::modbus::{COMMAND_BYTES, TELEMETRY_BYTES};
use super::profile::{LinkSettings, Protocol};
use super::stream;
use super::timing::LineTiming;

/// What adapters add to each exchange, s: none, USB with its latency timer at 1 ms, and FTDI as it is delivered (measured
/// on real adapters: LINKS.md 2.2).
const ADAPTERS: [(&str, f64); 3] = [
    ("no adapter", 0.0),
    ("USB adapter, latency timer 1 ms", 0.0012),
    ("USB adapter, latency timer 16 ms", 0.016),
];

/// The times of one exchange of a command for a sample on a serial line.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LineBudget {
    pub protocol: Protocol,
    pub baud: u32,
    pub request_bytes: usize,
    pub reply_bytes: usize,
    /// Characters of both frames, ms.
    pub wire_ms: f64,
    /// Silences that tell frames apart, ms.
    pub gaps_ms: f64,
    /// What the drive may take to answer, ms.
    pub reply_ms: f64,
    pub rates: Vec<AdapterRate>,
}

/// The loop rate behind one kind of adapter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AdapterRate {
    pub adapter: &'static str,
    pub delay_ms: f64,
    pub rate_hz: f64,
}

impl LineBudget {
    /// The budget of our own register map or stream at these settings; `None`: no serial line.
    pub fn of(settings: &LinkSettings) -> Option<Self> {
        let (request, reply) = match settings.protocol {
            Protocol::ModbusRtu => (COMMAND_BYTES, TELEMETRY_BYTES),
            Protocol::Stream => (stream::COMMAND_BYTES, stream::TELEMETRY_BYTES),
            Protocol::ModbusTcp => return None,
        };
        Some(Self::of_exchange(settings, request, reply))
    }

    /// The budget of any exchange: bytes of whole frames.
    pub fn of_exchange(settings: &LinkSettings, request_bytes: usize, reply_bytes: usize) -> Self {
        let with_gaps = settings.protocol != Protocol::Stream;
        let line = LineTiming::serial(settings, settings.baud, with_gaps);
        let gaps_s = 2.0 * line.gap().as_secs_f64();
        let bits = f64::from(settings.framing.bits_per_char());
        let wire_s = (request_bytes + reply_bytes) as f64 * bits / f64::from(settings.baud);
        let reply_s = settings.reply_ms * 1e-3;
        let rates = ADAPTERS.map(|(adapter, delay_s)| AdapterRate {
            adapter,
            delay_ms: delay_s * 1e3,
            rate_hz: 1.0 / (wire_s + gaps_s + reply_s + delay_s),
        });
        Self {
            protocol: settings.protocol,
            baud: settings.baud,
            request_bytes,
            reply_bytes,
            wire_ms: wire_s * 1e3,
            gaps_ms: gaps_s * 1e3,
            reply_ms: settings.reply_ms,
            rates: rates.to_vec(),
        }
    }

    /// What the line itself carries, Hz.
    pub fn rate_hz(&self) -> f64 {
        1e3 / (self.wire_ms + self.gaps_ms + self.reply_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::DriveProfile;

    fn settings(baud: u32, reply_ms: f64) -> LinkSettings {
        LinkSettings {
            baud,
            reply_ms,
            ..DriveProfile::named("own").unwrap().link
        }
    }

    #[test]
    fn rates_are_those_of_the_published_table() {
        // FC23 that reads ten and writes two registers, 0.5 ms reply, whole gaps: LINKS.md 2.1, adapters 0, 1.2, 16 ms.
        for (baud, expected_hz) in [
            (9600, [19.0, 19.0, 15.0]),
            (115_200, [131.0, 113.0, 42.0]),
            (921_600, [224.0, 177.0, 49.0]),
        ] {
            let budget = LineBudget::of_exchange(&settings(baud, 0.5), 13 + 4, 5 + 20);
            for (rate, expected_hz) in budget.rates.iter().zip(expected_hz) {
                assert!((rate.rate_hz - expected_hz).abs() < 0.8, "{baud}: {rate:?}");
            }
            assert!((budget.rate_hz() - budget.rates[0].rate_hz).abs() < 1e-9);
        }
    }

    #[test]
    fn a_stream_has_no_gaps_and_a_network_no_line() {
        let mut stream = settings(115_200, 0.0);
        stream.protocol = Protocol::Stream;
        let budget = LineBudget::of(&stream).unwrap();
        assert!(budget.gaps_ms.abs() < 1e-12);
        assert!((budget.wire_ms - 70.0 * 10.0 / 115.2).abs() < 1e-9);
        stream.protocol = Protocol::ModbusTcp;
        assert_eq!(LineBudget::of(&stream), None);
    }
}

//! What the doctor found, as text, JSON and one line for a bug report. Pure.

use std::fmt::Write as _;
use std::time::Duration;

use serde::Serialize;

use super::super::ports;
use super::scan::Scan;
use crate::drive::serial_ports::SerialPortInfo;
use crate::drive::{Framing, LoopRates, MeasuredLine, RawCounters};

/// More than this beside wire, gap and a quick drive is worth a remark, s (LINKS.md 2.4).
const REMARKABLE_S: f64 = 3e-3;
/// The rule that sets the latency timer of FTDI adapters whenever one is plugged in.
const UDEV_RULE: &str =
    r#"ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1""#;

/// Everything that was found.
#[derive(Serialize)]
pub(super) struct Findings {
    pub(super) link: String,
    /// Null over a network.
    pub(super) port: Option<SerialPortInfo>,
    /// The port was opened for this program alone (exclusive mark and lock).
    pub(super) exclusive: bool,
    pub(super) latency: Option<Latency>,
    /// A timer was to be set, and there is none.
    #[serde(skip)]
    pub(super) no_timer: bool,
    pub(super) settings: Settings,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) scan: Option<Scan>,
    /// Null where nothing answered.
    pub(super) round_trip: Option<RoundTripFindings>,
    /// Vendor, product, revision, as the unit gives them.
    pub(super) names: Vec<String>,
    pub(super) answers_function_8: Option<bool>,
    pub(super) counters: RawCounters,
}

#[derive(Clone, Copy, Serialize)]
pub(super) struct Settings {
    pub(super) baud: u32,
    pub(super) framing: Framing,
    pub(super) unit: u8,
}

/// The latency timer of an FTDI adapter.
#[derive(Serialize)]
pub(super) struct Latency {
    pub(super) before_ms: u32,
    pub(super) now_ms: u32,
    /// Why it could not be set.
    pub(super) refused: Option<String>,
}

/// Measured round trips, and what follows from them.
#[derive(Serialize)]
pub(super) struct RoundTripFindings {
    pub(super) asked: usize,
    /// Exceptions included.
    pub(super) answered: usize,
    pub(super) exceptions: usize,
    pub(super) p50_us: f64,
    pub(super) p99_us: f64,
    pub(super) worst_us: f64,
    /// What drive, adapter and host add to the wire time of one exchange, by the median, us; null over a network.
    pub(super) added_us: Option<f64>,
    /// Loop rates that this line carries, by arithmetic with what was measured; null over a network.
    pub(super) reachable: Option<LoopRates>,
}

impl RoundTripFindings {
    /// `budget`: the serial line with its gaps, nothing added yet.
    pub(super) fn of(
        mut round_trips: Vec<Duration>,
        exceptions: usize,
        asked: usize,
        budget: Option<MeasuredLine>,
    ) -> Option<Self> {
        round_trips.sort_unstable();
        let last = round_trips.len().checked_sub(1)?;
        let at = |permille: usize| round_trips[(last * permille + 500) / 1000].as_secs_f64();
        let p50_s = at(500);
        // The gap before the request is no part of the round trip, and on a pseudo-terminal nothing takes its wire time.
        let added = budget.map(|line| {
            let no_gaps = MeasuredLine { gap_s: 0.0, ..line };
            let added_s = (p50_s - no_gaps.read_s(1)).max(0.0);
            (added_s, MeasuredLine { added_s, ..line }.rates())
        });
        Some(Self {
            asked,
            answered: round_trips.len(),
            exceptions,
            p50_us: p50_s * 1e6,
            p99_us: at(990) * 1e6,
            worst_us: at(1000) * 1e6,
            added_us: added.map(|(added_s, _)| added_s * 1e6),
            reachable: added.map(|(_, rates)| rates),
        })
    }
}

impl Findings {
    pub(super) fn text(&self) -> String {
        let mut text = match &self.port {
            Some(port) => ports::port(port),
            None => format!("{}\n", self.link),
        };
        let mut line = |name: &str, what: String| {
            let _ = writeln!(text, "  {name:<12} {what}");
        };
        if self.exclusive {
            line("access", "opened for this program alone".to_owned());
        }
        if let Some(latency) = &self.latency {
            line("latency", latency.text());
        }
        if self.no_timer {
            line(
                "latency",
                "nothing to set: this port has no latency timer (FTDI adapters have one)"
                    .to_owned(),
            );
        }
        if let Some(scan) = &self.scan {
            line("scan", scan_text(scan, self.port.is_some()));
        }
        line("asked at", self.settings_text());
        match &self.round_trip {
            None => line("round trip", "nothing answered".to_owned()),
            Some(trips) => {
                line("round trip", trips.text());
                if let Some(remark) = trips.remark(self.latency.as_ref()) {
                    line("", remark);
                }
                if let Some(rates) = trips.reachable {
                    line(
                        "loop rate",
                        format!(
                            "{:.0} Hz with function code 23, {:.0} Hz with a write and a read a cycle (ten registers in, standard gap)",
                            rates.read_write_hz, rates.write_then_read_hz
                        ),
                    );
                }
            }
        }
        if !self.names.is_empty() {
            line("unit says", self.names.join(", "));
        }
        if self.counters.line.echoes {
            line(
                "local echo",
                "the line returns what is sent (two-wire RS-485); it is taken out".to_owned(),
            );
        }
        line("bug report", self.line());
        text
    }

    fn settings_text(&self) -> String {
        let Settings {
            baud,
            framing,
            unit,
        } = self.settings;
        match self.port {
            Some(_) => format!("{baud} {} unit {unit}", framing.name()),
            None => format!("unit {unit}"),
        }
    }

    /// Everything that matters, to be pasted.
    pub(super) fn line(&self) -> String {
        let mut parts = vec![
            format!("drivebench {}", env!("CARGO_PKG_VERSION")),
            format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            self.link.clone(),
        ];
        if let Some(port) = &self.port {
            if let Some(usb) = &port.usb {
                parts.push(format!("usb {}:{}", usb.vendor_id, usb.product_id));
            }
            parts.push(
                port.driver
                    .clone()
                    .unwrap_or_else(|| "no driver".to_owned()),
            );
        }
        if let Some(latency) = &self.latency {
            parts.push(format!("latency {} ms", latency.now_ms));
        }
        parts.push(self.settings_text());
        let c = &self.counters;
        let r = &c.requests;
        parts.push(format!(
            "{} sent, {} ok, {} timeout, {} crc, {} stale, {} mismatch, {} exception",
            r.sent, r.ok, r.timeout, r.crc, r.stale, r.mismatch, r.exception
        ));
        parts.push(self.round_trip.as_ref().map_or_else(
            || "no answer".to_owned(),
            |trips| format!("p50 {:.0} us, p99 {:.0} us", trips.p50_us, trips.p99_us),
        ));
        let yes_no = |answer: bool| if answer { "yes" } else { "no" };
        parts.push(format!("echo {}", yes_no(c.line.echoes)));
        if let Some(answers) = self.answers_function_8 {
            parts.push(format!("fc08 {}", yes_no(answers)));
        }
        if !self.names.is_empty() {
            parts.push(format!("{:?}", self.names.join(" ")));
        }
        parts.join("; ")
    }
}

impl Latency {
    fn text(&self) -> String {
        match &self.refused {
            Some(reason) => format!(
                "{} ms, cannot be set ({reason}); as root, into /etc/udev/rules.d/99-ftdi.rules: {UDEV_RULE}",
                self.now_ms
            ),
            None if self.now_ms < self.before_ms => {
                format!("set from {} to {} ms", self.before_ms, self.now_ms)
            }
            None if self.now_ms > 1 => {
                format!(
                    "{} ms holds every reply back; --set-latency sets 1 ms",
                    self.now_ms
                )
            }
            None => format!("{} ms", self.now_ms),
        }
    }
}

impl RoundTripFindings {
    fn text(&self) -> String {
        let refused = match self.exceptions {
            0 => "",
            all if all == self.answered => {
                ", all with an exception (--address names a register that the unit does not have)"
            }
            _ => ", some with an exception",
        };
        format!(
            "{} of {} requests answered{refused}; {:.0} us (median), {:.0} us (99 %), {:.0} us (worst)",
            self.answered, self.asked, self.p50_us, self.p99_us, self.worst_us
        )
    }

    fn remark(&self, latency: Option<&Latency>) -> Option<String> {
        let added_us = self.added_us.filter(|added| *added > REMARKABLE_S * 1e6)?;
        let cause = match latency {
            Some(latency) if latency.now_ms > 1 => "the latency timer above",
            _ => "a slow drive (look for its reply delay parameter) or adapter",
        };
        Some(format!(
            "{:.1} ms more than the wire takes: {cause}",
            added_us * 1e-3
        ))
    }
}

fn scan_text(scan: &Scan, is_serial: bool) -> String {
    match scan.found {
        None if !is_serial => "nothing answered".to_owned(),
        None => format!("nothing answered at {} settings", scan.tried),
        Some((baud, framing)) => {
            let units: Vec<String> = scan.units.iter().map(u8::to_string).collect();
            let at = if is_serial {
                format!(" at {baud} {}", framing.name())
            } else {
                String::new()
            };
            format!("answers{at}: unit {}", units.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::{LinkStatistics, standard_gap_s};

    fn findings() -> Findings {
        let framing = Framing::EightNoneOne;
        let budget = MeasuredLine {
            baud: 115_200,
            framing,
            gap_s: standard_gap_s(115_200, framing),
            added_s: 0.0,
        };
        // 15 characters take 1.302 ms.
        let trips = vec![Duration::from_micros(18_302); 50];
        Findings {
            link: "/dev/ttyUSB0".to_owned(),
            port: Some(SerialPortInfo {
                path: "/dev/ttyUSB0".into(),
                by_id: vec!["/dev/serial/by-id/usb-FTDI_A1-if00".into()],
                driver: Some("ftdi_sio".to_owned()),
                usb: None,
                latency_ms: Some(16),
                holders: Vec::new(),
            }),
            exclusive: true,
            latency: Some(Latency {
                before_ms: 16,
                now_ms: 16,
                refused: Some("permission denied".to_owned()),
            }),
            no_timer: false,
            settings: Settings {
                baud: 115_200,
                framing,
                unit: 1,
            },
            scan: None,
            round_trip: RoundTripFindings::of(trips, 0, 50, Some(budget)),
            names: vec!["Acme".to_owned(), "VX-1".to_owned()],
            answers_function_8: Some(false),
            counters: RawCounters {
                requests: LinkStatistics {
                    sent: 52,
                    ok: 50,
                    timeout: 2,
                    ..LinkStatistics::default()
                },
                ..RawCounters::default()
            },
        }
    }

    #[test]
    fn the_arithmetic_takes_the_wire_out_and_names_the_cause() {
        let findings = findings();
        let trips = findings.round_trip.as_ref().unwrap();
        assert!((trips.added_us.unwrap() - 17_000.0).abs() < 1.0);
        // 42 characters, two gaps and 17 ms.
        let cycle_s = 42.0 * 10.0 / 115_200.0 + 2.0 * 0.00175 + 0.017;
        let rate_hz = trips.reachable.unwrap().read_write_hz;
        assert!((rate_hz * cycle_s - 1.0).abs() < 1e-4, "{rate_hz}");
        let text = findings.text();
        assert!(text.contains("17.0 ms more than the wire takes: the latency timer above"));
        assert!(text.contains(UDEV_RULE), "{text}");
    }

    #[test]
    fn exceptions_a_missing_timer_and_a_network_are_told() {
        let mut findings = findings();
        findings.latency = None;
        findings.no_timer = true;
        if let Some(trips) = &mut findings.round_trip {
            trips.exceptions = 50;
        }
        let text = findings.text();
        assert!(text.contains("50 of 50 requests answered, all with an exception"));
        assert!(text.contains("no latency timer"), "{text}");
        let scan = Scan {
            tried: 1,
            found: Some((115_200, Framing::EightNoneOne)),
            units: vec![1, 3],
        };
        assert_eq!(scan_text(&scan, false), "answers: unit 1, 3");
        assert_eq!(scan_text(&scan, true), "answers at 115200 8N1: unit 1, 3");
    }

    #[test]
    fn the_line_for_a_report_is_one_line_with_everything() {
        let line = findings().line();
        assert!(!line.contains('\n'));
        for part in [
            "/dev/ttyUSB0",
            "ftdi_sio",
            "latency 16 ms",
            "115200 8N1 unit 1",
            "52 sent, 50 ok, 2 timeout",
            "p50 18302 us",
            "fc08 no",
            "Acme VX-1",
        ] {
            assert!(line.contains(part), "{part} in {line}");
        }
    }
}

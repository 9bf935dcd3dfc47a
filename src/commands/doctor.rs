//! `ports` and `doctor`: which serial ports are there, why does a line not work, and how fast can it be? It only reads:
//! function codes 03, 43 and 08.
//!
//! ```text
//! port -> opened alone? -> latency timer -> scan -> 50 requests -> arithmetic -> findings
//! ```

use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

use serde::Serialize;
use serde_json::json;

use crate::commands::arguments::{WireArguments, open_line};
use crate::commands::probe::{Scan, scan};
use crate::commands::registers::strays_text;
use crate::runtime::{Failure, LINK, REFUSED, Tap, Terminal, lines};
use drivebench_link::serial_ports::{SerialPortInfo, describe, latency_file, list};
use drivebench_link::{
    CellTable, Framing, LinkError, LoopRates, MeasuredLine, RawClient, RawCounters, ReadRequest,
    Target, standard_gap_s,
};

/// List serial ports: stable name, adapter, driver, the program that has them open
#[derive(clap::Args)]
#[command(after_help = "Example:
  drivebench ports
  drivebench ports --json

Use the name from /dev/serial/by-id in bench files: /dev/ttyUSB0 may be another adapter tomorrow.")]
pub(super) struct PortsArguments {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute_ports(
    arguments: &PortsArguments,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let ports = list(Path::new("/"));
    terminal.result(&json!({ "ports": ports }), arguments.json, |_| match ports.as_slice() {
        [] => "no serial port is plugged in; `drivebench emulate` makes one with a software drive behind it"
            .to_owned(),
        ports => ports.iter().map(port_text).collect(),
    })
}

/// Check a line: permission, holder, latency, round trips, reachable loop rate, scan
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench doctor --port /dev/ttyUSB0
  drivebench doctor --port /dev/ttyUSB0 --scan                 which baud rate, parity and unit answer?
  drivebench doctor --port /dev/ttyUSB0 --set-latency --json

Nothing is written to the unit: function codes 03, 43 and 08 only.")]
pub(super) struct Arguments {
    #[command(flatten)]
    wire: WireArguments,
    /// Try baud rates and framings until something answers, then the units
    #[arg(long)]
    scan: bool,
    /// Units that a scan tries
    #[arg(long, value_name = "FIRST-LAST", default_value = "1-16", value_parser = units)]
    units: (u8, u8),
    /// Holding register that the round-trip probe reads
    #[arg(long, value_name = "ADDRESS", default_value_t = 0)]
    address: u16,
    /// Set the latency timer of an FTDI adapter to 1 ms
    #[arg(long)]
    set_latency: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let wire = &arguments.wire;
    let target = wire.target()?;
    let tap = wire.tap(terminal)?;
    let (findings, last_error) = Findings::of(&target, arguments, &tap, terminal)?;
    terminal.result(&findings, arguments.json, Findings::text)?;
    let verdict = findings.verdict();
    match (findings.condition, findings.round_trip, last_error) {
        (Condition::Good, ..) => Ok(()),
        (Condition::Bad, ..) => Err(Failure::with_help(
            REFUSED,
            verdict,
            "the counters in the bug report name the kind: timeout (power, cable), crc (noise, termination, baud rate), stale (late replies), mismatch (another device)",
        )),
        (Condition::Lost, None, Some(error)) => Err(error.into()),
        (Condition::Lost, Some(_), Some(error)) => {
            Err(Failure::link(format!("{verdict}; the last: {error}"), error.help()))
        }
        (Condition::Lost, _, None) => Err(Failure::new(LINK, verdict)),
    }
}

/// Condition of the line by the requests of the round-trip probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Condition {
    /// Every request was answered.
    Good,
    /// Some were not.
    Bad,
    /// Most were not.
    Lost,
}

impl Condition {
    const fn of(trips: Option<&RoundTripFindings>) -> Self {
        match trips {
            Some(trips) if trips.answered == trips.asked => Self::Good,
            Some(trips) if 2 * trips.answered >= trips.asked => Self::Bad,
            _ => Self::Lost,
        }
    }
}

fn units(text: &str) -> Result<(u8, u8), String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.parse(), last.parse()) {
        (Ok(first), Ok(last)) if (1..=last).contains(&first) && last <= 247 => Ok((first, last)),
        _ => Err("expected FIRST-LAST within 1-247, as 1-16".to_owned()),
    }
}

fn port_text(port: &SerialPortInfo) -> String {
    let mut text = format!("{}\n", port.path.display());
    lines(&mut text, "  stable name  ", port.by_id.iter().map(|name| name.display()));
    if let Some(usb) = &port.usb {
        let names = [&usb.manufacturer, &usb.product].map(|name| name.as_deref());
        let names = names.map(Option::unwrap_or_default).join(" ");
        let serial = usb.serial_number.as_deref().unwrap_or("none");
        let (id, names) = (format!("{}:{}", usb.vendor_id, usb.product_id), names.trim());
        let _ = writeln!(text, "  adapter      {id} {names}, serial number {serial}");
    }
    lines(&mut text, "  driver       ", &port.driver);
    let latency = port.latency_ms.map(|ms| format!("{ms} ms"));
    lines(&mut text, "  latency      ", latency);
    lines(&mut text, "  held by      ", &port.holders);
    text
}

/// Reads the latency timer of an FTDI adapter, and sets it to 1 ms where `set`.
fn latency(root: &Path, port: &SerialPortInfo, set: bool) -> Option<Latency> {
    let before_ms = port.latency_ms?;
    let mut latency = Latency { before_ms, now_ms: before_ms, refused: None };
    if set && before_ms > 1 {
        let file = latency_file(root, &port.path)?;
        if let Err(error) = std::fs::write(&file, "1") {
            latency.refused = Some(format!("{}: {error}", file.display()));
        }
        latency.now_ms = describe(root, &port.path).latency_ms.unwrap_or(before_ms);
    }
    Some(latency)
}

/// Requests of the round-trip probe.
const PROBES: usize = 50;

#[derive(Default)]
struct Probed {
    /// Of those that were answered.
    round_trips: Vec<Duration>,
    exceptions: usize,
    /// The last of them.
    exception: Option<LinkError>,
    /// Of the last that was not answered.
    last_error: Option<LinkError>,
}

fn probe(client: &mut RawClient, address: u16) -> Result<Probed, Failure> {
    let request = ReadRequest { table: CellTable::Holding, address, count: 1 };
    let mut probed = Probed::default();
    for sent in 0..PROBES {
        if sent >= 3 && !client.has_answered() {
            break;
        }
        match client.read(request) {
            Ok(_) => probed.round_trips.push(client.last_round_trip()),
            Err(error @ LinkError::Exception { .. }) => {
                probed.round_trips.push(client.last_round_trip());
                probed.exceptions += 1;
                probed.exception = Some(error);
            }
            Err(error @ LinkError::Gone { .. }) => return Err(error.into()),
            Err(error) => probed.last_error = Some(error),
        }
    }
    Ok(probed)
}

/// The rule that sets the latency timer of FTDI adapters whenever one is plugged in.
const UDEV_RULE: &str =
    r#"ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1""#;

#[derive(Serialize)]
struct Findings {
    link: String,
    /// Null over a network.
    port: Option<SerialPortInfo>,
    /// The port was opened for this program alone (exclusive mark and lock).
    exclusive: bool,
    latency: Option<Latency>,
    /// A timer was to be set, and there is none.
    #[serde(skip)]
    no_timer: bool,
    settings: Settings,
    #[serde(skip_serializing_if = "Option::is_none")]
    scan: Option<Scan>,
    /// Null where nothing answered.
    round_trip: Option<RoundTripFindings>,
    /// Vendor, product, revision, as the unit gives them.
    names: Vec<String>,
    answers_function_8: Option<bool>,
    counters: RawCounters,
    condition: Condition,
}

#[derive(Clone, Copy, Serialize)]
struct Settings {
    baud: u32,
    framing: Framing,
    unit: u8,
}

#[derive(Serialize)]
struct Latency {
    before_ms: u32,
    now_ms: u32,
    /// Why it could not be set.
    refused: Option<String>,
}

#[derive(Serialize)]
struct RoundTripFindings {
    asked: usize,
    /// Exceptions included.
    answered: usize,
    exceptions: usize,
    /// Code and name of the last of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    exception: Option<String>,
    p50_us: f64,
    p99_us: f64,
    worst_us: f64,
    /// What drive, adapter and host add to the wire time of one exchange, by the median, us; null over a network.
    added_us: Option<f64>,
    /// Loop rates that this line carries, by arithmetic with what was measured; null over a network.
    reachable: Option<LoopRates>,
}

impl RoundTripFindings {
    /// `budget`: the serial line with its gaps, nothing added yet.
    fn of(probed: Probed, asked: usize, budget: Option<MeasuredLine>) -> Option<Self> {
        let Probed { mut round_trips, exceptions, exception, .. } = probed;
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
            exception: exception.and_then(|error| match error {
                LinkError::Exception { code: 2, .. } => Some(
                    "exception 0x02 illegal data address (--address names a register that the unit does not have)".to_owned(),
                ),
                LinkError::Exception { code, name, .. } => {
                    Some(format!("exception {code:#04x} {name}"))
                }
                _ => None,
            }),
            p50_us: p50_s * 1e6,
            p99_us: at(990) * 1e6,
            worst_us: at(1000) * 1e6,
            added_us: added.map(|(added_s, _)| added_s * 1e6),
            reachable: added.map(|(_, rates)| rates),
        })
    }
}

impl Findings {
    /// Examines the line; with the error of the last request that was not answered.
    fn of(
        target: &Target,
        arguments: &Arguments,
        tap: &Tap,
        terminal: &Terminal,
    ) -> Result<(Self, Option<LinkError>), Failure> {
        let root = Path::new("/");
        let mut settings = arguments.wire.settings();
        let port = match target {
            Target::Serial { path, .. } => Some(describe(root, Path::new(path))),
            Target::Tcp { .. } => None,
        };
        let set = arguments.set_latency;
        let latency = port.as_ref().and_then(|port| latency(root, port, set));
        let units = arguments.scan.then_some(arguments.units);
        let scan = units.map(|units| scan(target, &mut settings, units, tap, terminal));
        let scan = scan.transpose()?;
        let mut client = open_line(target, &settings, tap, terminal)?;
        let mut probed = probe(&mut client, arguments.address)?;
        let last_error = probed.last_error.take();
        let names = client.names()?;
        let answers_function_8 = client.sends_back()?;
        let counters = client.counters();
        drop(client);
        let (baud, framing, unit) = (settings.baud, settings.framing, settings.unit);
        let gap_s = settings.gap.map(|gap| gap.as_secs_f64());
        let gap_s = gap_s.unwrap_or_else(|| standard_gap_s(baud, framing));
        let budget = port.as_ref().map(|_| MeasuredLine { baud, framing, gap_s, added_s: 0.0 });
        let settings = Settings { baud, framing, unit };
        let round_trip = RoundTripFindings::of(probed, PROBES, budget);
        let findings = Self {
            condition: Condition::of(round_trip.as_ref()),
            link: target.to_string(),
            exclusive: port.is_some(),
            port,
            no_timer: set && latency.is_none(),
            latency,
            settings,
            scan,
            round_trip,
            names,
            answers_function_8,
            counters,
        };
        Ok((findings, last_error))
    }

    fn text(&self) -> String {
        let mut text = match &self.port {
            Some(port) => port_text(port),
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
        line("settings", self.settings_text());
        match &self.round_trip {
            None if self.counters.line.foreign_frames > 0 => {
                line("round trip", "no frame that came answers a request".to_owned());
            }
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
            line("names", self.names.join(", "));
        }
        if self.counters.line.echoes {
            line(
                "local echo",
                "the line returns what is sent (two-wire RS-485); it is taken out".to_owned(),
            );
        }
        line("bug report", self.line());
        text.push_str(&strays_text(&self.counters));
        let _ = writeln!(text, "{}", self.verdict());
        text
    }

    fn verdict(&self) -> String {
        let (answered, asked) =
            self.round_trip.as_ref().map_or((0, PROBES), |trips| (trips.answered, trips.asked));
        let link = &self.link;
        match self.condition {
            Condition::Good => format!("{link} works: all {asked} requests were answered"),
            Condition::Bad => {
                format!("{link} works badly: {} of {asked} requests were lost", asked - answered)
            }
            Condition::Lost if answered == 0 => {
                format!("{link} does not work: no request was answered")
            }
            Condition::Lost => {
                format!("{link} does not work: {} of {asked} requests were lost", asked - answered)
            }
        }
    }

    fn settings_text(&self) -> String {
        let at = &self.settings;
        match self.port {
            Some(_) => format!("{} {} unit {}", at.baud, at.framing.name(), at.unit),
            None => format!("unit {}", at.unit),
        }
    }

    /// Everything that matters for a bug report.
    fn line(&self) -> String {
        let mut parts = vec![
            format!("drivebench {}", env!("CARGO_PKG_VERSION")),
            format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            self.link.clone(),
        ];
        if let Some(port) = &self.port {
            if let Some(usb) = &port.usb {
                parts.push(format!("usb {}:{}", usb.vendor_id, usb.product_id));
            }
            parts.push(port.driver.clone().unwrap_or_else(|| "no driver".to_owned()));
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
        parts.push(match &self.round_trip {
            None => "no answer".to_owned(),
            Some(trips) => format!("p50 {:.0} us, p99 {:.0} us", trips.p50_us, trips.p99_us),
        });
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
        let now_ms = self.now_ms;
        match &self.refused {
            Some(reason) => format!(
                "{now_ms} ms, cannot be set ({reason}); as root, into /etc/udev/rules.d/99-ftdi.rules: {UDEV_RULE}"
            ),
            None if now_ms < self.before_ms => {
                format!("set from {} to {now_ms} ms", self.before_ms)
            }
            None if now_ms > 1 => {
                format!("{now_ms} ms holds every reply back; --set-latency sets 1 ms")
            }
            None => format!("{now_ms} ms"),
        }
    }
}

impl RoundTripFindings {
    fn text(&self) -> String {
        let share = if self.exceptions == self.answered { "all" } else { "some" };
        let exception = self.exception.as_ref();
        let refused = exception.map(|exception| format!(", {share} with {exception}"));
        let refused = refused.unwrap_or_default();
        format!(
            "{} of {} requests answered{refused}; {:.0} us (median), {:.0} us (99 %), {:.0} us (worst)",
            self.answered, self.asked, self.p50_us, self.p99_us, self.worst_us
        )
    }

    fn remark(&self, latency: Option<&Latency>) -> Option<String> {
        // A quick drive adds less than 3 ms.
        let added_us = self.added_us.filter(|added_us| *added_us > 3000.0)?;
        let cause = match latency {
            Some(latency) if latency.now_ms > 1 => "the latency timer above",
            _ => "a slow drive (look for its reply delay parameter) or adapter",
        };
        let added_ms = added_us * 1e-3;
        Some(format!("{added_ms:.1} ms more than the wire takes: {cause}"))
    }
}

fn scan_text(scan: &Scan, is_serial: bool) -> String {
    match (scan.found, scan.other_unit) {
        (None, _) if scan.only_echoes > 0 => format!(
            "no unit answered at {} settings; the line returns what is sent, so the adapter works",
            scan.tried
        ),
        (None, _) if !is_serial => "nothing answered".to_owned(),
        (None, _) => format!("nothing answered at {} settings", scan.tried),
        (Some((baud, framing)), Some(unit)) => {
            let at =
                if is_serial { format!(" at {baud} {}", framing.name()) } else { String::new() };
            format!("frames of unit {unit} came{at}, and no unit that was tried answered")
        }
        (Some((baud, framing)), None) => {
            let units = scan.units.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
            if is_serial {
                format!("answers at {baud} {}: unit {units}", framing.name())
            } else {
                format!("answers: unit {units}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_link::LinkStatistics;

    #[test]
    fn ranges_of_units_are_read_and_bounded() {
        for (text, expected) in [("1-16", Some((1, 16))), ("7", Some((7, 7)))]
            .into_iter()
            .chain(["", "0-3", "3-1", "1-248", "a-b", "1-2-3"].map(|wrong| (wrong, None)))
        {
            assert_eq!(units(text).ok(), expected, "{text}");
        }
    }

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
            settings: Settings { baud: 115_200, framing, unit: 1 },
            scan: None,
            round_trip: RoundTripFindings::of(
                Probed { round_trips: trips, ..Probed::default() },
                50,
                Some(budget),
            ),
            condition: Condition::Good,
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
    fn the_condition_of_a_line_follows_from_its_lost_requests() {
        for (answered, condition, verdict) in [
            (Some(50), Condition::Good, "works: all 50"),
            (Some(49), Condition::Bad, "works badly: 1 of 50 requests were lost"),
            (Some(25), Condition::Bad, "works badly: 25 of 50"),
            (Some(24), Condition::Lost, "does not work: 26 of 50"),
            (None, Condition::Lost, "does not work: no request was answered"),
        ] {
            let mut findings = findings();
            let probed = |answered| Probed {
                round_trips: vec![Duration::from_millis(2); answered],
                ..Probed::default()
            };
            findings.round_trip =
                answered.and_then(|answered| RoundTripFindings::of(probed(answered), 50, None));
            findings.condition = Condition::of(findings.round_trip.as_ref());
            assert_eq!(findings.condition, condition, "{answered:?}");
            let text = findings.text();
            assert!(text.trim_end().lines().last().unwrap().contains(verdict), "{text}");
        }
    }

    #[test]
    fn findings_hold_wire_time_causes_and_a_line_for_a_report() {
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
        assert!(text.ends_with("/dev/ttyUSB0 works: all 50 requests were answered\n"), "{text}");
        let line = findings.line();
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
        let mut without_timer = findings;
        (without_timer.latency, without_timer.no_timer) = (None, true);
        let trips = without_timer.round_trip.as_mut().unwrap();
        (trips.exceptions, trips.exception) = (50, Some("exception 0x06 device busy".to_owned()));
        let text = without_timer.text();
        assert!(text.contains("50 of 50 requests answered, all with exception 0x06 device busy;"));
        assert!(text.contains("no latency timer"), "{text}");
        let scan = Scan {
            tried: 1,
            found: Some((115_200, Framing::EightNoneOne)),
            units: vec![1, 3],
            ..Scan::default()
        };
        assert_eq!(scan_text(&scan, false), "answers: unit 1, 3");
        assert_eq!(scan_text(&scan, true), "answers at 115200 8N1: unit 1, 3");
        let other = Scan { units: Vec::new(), other_unit: Some(0), ..scan };
        assert!(scan_text(&other, true).starts_with("frames of unit 0 came at 115200 8N1, and"));
        let echoing = Scan { found: None, other_unit: None, only_echoes: 1, ..other };
        assert!(scan_text(&echoing, true).contains("the adapter works"));
    }
}

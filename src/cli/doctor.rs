//! `doctor`: why does this line not work, and how fast can it be?
//!
//! ```text
//! port (ports.rs) -> opened alone? -> latency timer -> scan -> 50 requests -> arithmetic -> Findings (findings.rs)
//! ```
//!
//! It only reads: function codes 03, 43 and 08.

mod findings;
mod scan;

use std::path::Path;
use std::time::Duration;

use super::failure::{Failure, LINK};
use super::output;
use super::wire::{Tap, WireArguments};
use crate::drive::serial_ports::{SerialPortInfo, describe, latency_file};
use crate::drive::{
    LinkError, MeasuredLine, RawClient, ReadRequest, RegisterTable, Target, standard_gap_s,
};
use findings::{Findings, Latency, RoundTripFindings, Settings};

/// Requests of the round-trip probe.
const PROBES: usize = 50;
/// Probes without any answer after which the rest is not worth its wait.
const SILENT_PROBES: usize = 3;
/// What an FTDI adapter can be set to, ms.
const SHORTEST_LATENCY_MS: u32 = 1;

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
    /// Units that a scan asks
    #[arg(long, value_name = "FIRST-LAST", default_value = "1-16", value_parser = scan::units)]
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

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let target = arguments.wire.target()?;
    let root = Path::new("/");
    let port = match &target {
        Target::Serial { path, .. } => Some(describe(root, Path::new(path))),
        Target::Tcp { .. } => None,
    };
    let latency = port
        .as_ref()
        .and_then(|port| latency(root, port, arguments.set_latency));
    let tap = Tap::create(arguments.wire.tap.as_deref())?;
    let mut wire = arguments.wire.clone();
    let scan = if arguments.scan {
        let scan = scan::scan(&mut wire, arguments.units, port.is_some(), &tap)?;
        Some(scan)
    } else {
        None
    };
    let mut client = wire.open(&tap)?;
    let (round_trips, exceptions, last_error) = probe(&mut client, arguments.address)?;
    let names = client.names()?;
    let diagnostics = client.sends_back()?;
    let counters = client.counters();
    drop(client);
    drop(tap);
    let settings = Settings {
        baud: wire.baud,
        framing: wire.framing,
        unit: wire.unit,
    };
    let budget = port.as_ref().map(|_| MeasuredLine {
        baud: wire.baud,
        framing: wire.framing,
        gap_s: wire.gap().map_or_else(
            || standard_gap_s(wire.baud, wire.framing),
            |gap| gap.as_secs_f64(),
        ),
        added_s: 0.0,
    });
    let findings = Findings {
        link: target.to_string(),
        exclusive: port.is_some(),
        port,
        no_timer: arguments.set_latency && latency.is_none(),
        latency,
        settings,
        scan,
        round_trip: RoundTripFindings::of(round_trips, exceptions, PROBES, budget),
        names,
        answers_function_8: diagnostics,
        counters,
    };
    output::result(&findings, arguments.json, Findings::text)?;
    match (findings.round_trip, last_error) {
        (Some(_), _) => Ok(()),
        (None, Some(error)) => Err(error.into()),
        (None, None) => Err(Failure::new(LINK, "no request was answered")),
    }
}

/// Reads the latency timer, and sets it if asked; what cannot be set is told with the rule that sets it for good.
fn latency(root: &Path, port: &SerialPortInfo, set: bool) -> Option<Latency> {
    let before_ms = port.latency_ms?;
    let mut latency = Latency {
        before_ms,
        now_ms: before_ms,
        refused: None,
    };
    if set && before_ms > SHORTEST_LATENCY_MS {
        let file = latency_file(root, &port.path)?;
        if let Err(error) = std::fs::write(&file, SHORTEST_LATENCY_MS.to_string()) {
            latency.refused = Some(format!("{}: {error}", file.display()));
        }
        latency.now_ms = describe(root, &port.path).latency_ms.unwrap_or(before_ms);
    }
    Some(latency)
}

/// Round trips of the requests that were answered, how many of them with an exception, and why the last one was not.
fn probe(
    client: &mut RawClient,
    address: u16,
) -> Result<(Vec<Duration>, usize, Option<LinkError>), Failure> {
    let request = ReadRequest {
        table: RegisterTable::Holding,
        address,
        count: 1,
    };
    let (mut round_trips, mut exceptions, mut last_error) = (Vec::new(), 0, None);
    for asked in 0..PROBES {
        if asked >= SILENT_PROBES && !client.is_heard() {
            break;
        }
        let reply = client.read(request);
        exceptions += usize::from(matches!(reply, Err(LinkError::Exception { .. })));
        match reply {
            Ok(_) | Err(LinkError::Exception { .. }) => round_trips.push(client.last_round_trip()),
            Err(error @ LinkError::Gone { .. }) => return Err(error.into()),
            Err(error) => last_error = Some(error),
        }
    }
    Ok((round_trips, exceptions, last_error))
}

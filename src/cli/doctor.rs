//! `ports` and `doctor`: which serial ports are there, why does a line not work, and how fast can it be?
//!
//! ```text
//! port, settings -> app::doctor -> findings: text, JSON, one line for a report
//! ```
//!
//! It only reads: function codes 03, 43 and 08.

use std::path::Path;

use serde::Serialize;

use super::arguments::{WireArguments, open_line};
use super::failure::{Failure, LINK};
use super::output;
use crate::app::doctor::{Findings, Look, port_text};
use drivebench_link::RawSettings;
use drivebench_link::serial_ports::{SerialPortInfo, list};

/// List serial ports: stable name, adapter, driver, who holds them
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

#[derive(Serialize)]
struct Ports {
    ports: Vec<SerialPortInfo>,
}

pub(super) fn execute_ports(arguments: &PortsArguments) -> Result<(), Failure> {
    let ports = Ports {
        ports: list(Path::new("/")),
    };
    output::result(&ports, arguments.json, ports_text)
}

fn ports_text(ports: &Ports) -> String {
    if ports.ports.is_empty() {
        return "no serial port is plugged in; `drivebench emulate` makes one with a software drive behind it"
            .to_owned();
    }
    ports.ports.iter().map(port_text).collect()
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
    /// Units that a scan asks
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

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let wire = &arguments.wire;
    let target = wire.target()?;
    let (tap, settings) = (wire.tap()?, wire.settings());
    let look = Look {
        units: arguments.scan.then_some(arguments.units),
        set_latency: arguments.set_latency,
        address: arguments.address,
    };
    let open = |settings: &RawSettings| open_line(&target, settings, &tap);
    let (findings, last_error) = Findings::of(&target, settings, &look, &tap, open)?;
    output::result(&findings, arguments.json, Findings::text)?;
    match (findings.round_trip, last_error) {
        (Some(_), _) => Ok(()),
        (None, Some(error)) => Err(error.into()),
        (None, None) => Err(Failure::new(LINK, "no request was answered")),
    }
}

fn units(text: &str) -> Result<(u8, u8), String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.parse(), last.parse()) {
        (Ok(first), Ok(last)) if (1..=last).contains(&first) && last <= 247 => Ok((first, last)),
        _ => Err("expected FIRST-LAST within 1-247, as 1-16".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_units_are_read_and_bounded() {
        assert_eq!(units("1-16"), Ok((1, 16)));
        assert_eq!(units("7"), Ok((7, 7)));
        for wrong in ["", "0-3", "3-1", "1-248", "a-b", "1-2-3"] {
            assert!(units(wrong).is_err(), "{wrong}");
        }
    }
}

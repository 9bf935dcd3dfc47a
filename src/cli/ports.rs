//! `ports`: the serial ports of this machine.

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

use super::failure::Failure;
use super::output;
use crate::drive::serial_ports::{SerialPortInfo, list};

/// List serial ports: stable name, adapter, driver, who holds them
#[derive(clap::Args)]
#[command(after_help = "Example:
  drivebench ports
  drivebench ports --json

Use the name from /dev/serial/by-id in bench files: /dev/ttyUSB0 may be another adapter tomorrow.")]
pub(super) struct Arguments {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Ports {
    ports: Vec<SerialPortInfo>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let ports = Ports {
        ports: list(Path::new("/")),
    };
    output::result(&ports, arguments.json, text)
}

fn text(ports: &Ports) -> String {
    if ports.ports.is_empty() {
        return "no serial port is plugged in; `drivebench emulate` makes one with a software drive behind it"
            .to_owned();
    }
    ports.ports.iter().map(port).collect()
}

/// One port in a few lines.
pub(super) fn port(port: &SerialPortInfo) -> String {
    let mut text = format!("{}\n", port.path.display());
    for name in &port.by_id {
        let _ = writeln!(text, "  stable name  {}", name.display());
    }
    if let Some(usb) = &port.usb {
        let names =
            [&usb.manufacturer, &usb.product].map(|name| name.as_deref().unwrap_or_default());
        let serial = usb.serial_number.as_deref().unwrap_or("none");
        let _ = writeln!(
            text,
            "  adapter      {}:{} {}, serial number {serial}",
            usb.vendor_id,
            usb.product_id,
            names.join(" ").trim()
        );
    }
    if let Some(driver) = &port.driver {
        let _ = writeln!(text, "  driver       {driver}");
    }
    if let Some(latency_ms) = port.latency_ms {
        let _ = writeln!(text, "  latency      {latency_ms} ms");
    }
    for holder in &port.holders {
        let _ = writeln!(text, "  held by      {holder}");
    }
    text
}

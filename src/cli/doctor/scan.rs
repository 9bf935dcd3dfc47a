//! Which baud rate, framing and unit answer? Only function code 03 is asked: every Modbus unit answers it, if only with
//! an exception.

use std::time::Duration;

use serde::Serialize;

use super::super::failure::Failure;
use super::super::output;
use super::super::wire::{Tap, WireArguments};
use crate::drive::{Framing, LinkError, RawClient};

/// In the order of how common they are on drives.
const BAUDS: [u32; 7] = [9600, 19_200, 115_200, 38_400, 57_600, 230_400, 4800];
const FRAMINGS: [Framing; 4] = [
    Framing::EightNoneOne,
    Framing::EightEvenOne,
    Framing::EightOddOne,
    Framing::EightNoneTwo,
];
/// The slowest drives answer in 60 ms (LINKS.md 2.1); wire and adapter come on top.
const PATIENCE: Duration = Duration::from_millis(120);

/// Between two openings of a port: what is under way at the old baud rate must be over, and our software drive needs a
/// moment for a fresh pseudo-terminal.
const SETTLING: Duration = Duration::from_millis(100);

/// What a scan has found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Scan {
    /// Settings that were tried.
    pub(super) tried: usize,
    /// Baud rate and framing of the first answer.
    pub(super) found: Option<(u32, Framing)>,
    pub(super) units: Vec<u8>,
}

pub(super) fn units(text: &str) -> Result<(u8, u8), String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.parse(), last.parse()) {
        (Ok(first), Ok(last)) if (1..=last).contains(&first) && last <= 247 => Ok((first, last)),
        _ => Err("expected FIRST-LAST within 1-247, as 1-16".to_owned()),
    }
}

/// Asks until something answers; `wire` gets the settings that did.
pub(super) fn scan(
    wire: &mut WireArguments,
    (first, last): (u8, u8),
    is_serial: bool,
    tap: &Tap,
) -> Result<Scan, Failure> {
    let mut scan = Scan::default();
    let mut lines: Vec<(u32, Framing)> = vec![(wire.baud, wire.framing)];
    if is_serial {
        let all = FRAMINGS.iter().flat_map(|f| BAUDS.map(|baud| (baud, *f)));
        lines.extend(all.filter(|line| *line != (wire.baud, wire.framing)));
    }
    for (baud, framing) in lines {
        scan.tried += 1;
        if is_serial {
            output::message(&format!("asking at {baud} {}", framing.name()));
        } else {
            output::message(&format!("asking units {first} to {last}"));
        }
        let mut client = open(wire, baud, framing, tap)?;
        for unit in first..=last {
            client.set_unit(unit);
            match client.ask(&[3, 0, 0, 0, 1], "one register") {
                Ok(_) | Err(LinkError::Exception { .. }) => scan.units.push(unit),
                Err(error @ LinkError::Gone { .. }) => return Err(error.into()),
                Err(_) => {}
            }
        }
        if let Some(unit) = scan.units.first() {
            (wire.baud, wire.framing, wire.unit) = (baud, framing, *unit);
            scan.found = Some((baud, framing));
        }
        drop(client);
        std::thread::sleep(SETTLING);
        if scan.found.is_some() {
            break;
        }
    }
    Ok(scan)
}

fn open(
    wire: &WireArguments,
    baud: u32,
    framing: Framing,
    tap: &Tap,
) -> Result<RawClient, Failure> {
    let mut line = wire.clone();
    (line.baud, line.framing) = (baud, framing);
    let mut settings = line.settings();
    let wire_time =
        Duration::from_secs_f64(f64::from(framing.bits_per_char()) * 32.0 / f64::from(baud));
    settings.timeout = settings.timeout.min(PATIENCE + wire_time);
    Ok(RawClient::open(&line.target()?, &settings, tap.file())?)
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

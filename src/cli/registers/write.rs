//! `registers write`: guarded, because a register of a drive may start a motor.

use std::fmt::Write as _;
use std::io::{BufRead, IsTerminal, Write as _};
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use super::super::failure::{Failure, LINK, USAGE};
use super::super::output;
use super::super::wire::{Tap, WireArguments};
use super::{failure, number, value};
use crate::drive::{
    LinkError, MOST_WRITTEN, RawClient, RawCounters, ReadRequest, RegisterTable, WriteFunction,
    read_batch, registers,
};

/// Write holding registers once, read them back and compare; asks before, or needs --yes
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench registers write 100 1500 --port /dev/ttyUSB0          shows what changes, then asks
  drivebench registers write 0x2000 18 3000 --host 192.168.1.7:502 --yes --hardware

A register of a drive may start a motor. A write is never repeated by itself: when its reply is lost, what the unit
holds is read and shown. --hardware is needed with --yes for anything that does not identify itself as our emulator.")]
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a command line, each independent of the others"
)]
pub(in super::super) struct Arguments {
    /// Protocol address of the first register, from 0
    #[arg(value_parser = number)]
    address: u16,
    /// Values, one for each register from there on
    #[arg(required = true, value_name = "VALUE", value_parser = value, allow_negative_numbers = true)]
    values: Vec<u16>,
    #[command(flatten)]
    wire: WireArguments,
    /// Function code 16 for a single register too; many drives have only one of 6 and 16
    #[arg(long)]
    multiple: bool,
    /// Write without a question
    #[arg(long)]
    yes: bool,
    /// The unit is real and may move something (needed with --yes)
    #[arg(long)]
    hardware: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The result as JSON.
#[derive(Serialize)]
struct WriteResult<'a> {
    address: u16,
    /// Null where the registers cannot be read.
    before: Option<Vec<u16>>,
    written: &'a [u16],
    after: Option<Vec<u16>>,
    /// The registers read back what was written.
    confirmed: bool,
    /// Why the write itself was not acknowledged.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    is_emulator: bool,
    counters: RawCounters,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let (address, values) = (arguments.address, arguments.values.as_slice());
    let count = u16::try_from(values.len()).unwrap_or(u16::MAX);
    if values.len() > MOST_WRITTEN || address.checked_add(count - 1).is_none() {
        let headline = format!(
            "{} at {address} do not fit one request",
            registers(count.into())
        );
        let help = format!("at most {MOST_WRITTEN} registers, up to address 65535");
        return Err(Failure::with_help(USAGE, headline, help));
    }
    let tap = Tap::create(arguments.wire.tap.as_deref())?;
    let mut client = arguments.wire.open(&tap)?;
    let is_emulator = is_emulator(&mut client)?;
    let before = read_back(&mut client, address, count);
    if let Err(error @ (LinkError::Timeout { .. } | LinkError::Gone { .. })) = before {
        return Err(error.into());
    }
    let before = before.ok();
    announce(address, before.as_deref(), values);
    consent(arguments, is_emulator)?;
    let function = if values.len() > 1 || arguments.multiple {
        WriteFunction::Multiple
    } else {
        WriteFunction::Single
    };
    let written = client.write(function, address, values);
    // Whether it was acknowledged or not, what counts is what the unit holds.
    let after = read_back(&mut client, address, count);
    let confirmed = after.as_ref().is_ok_and(|after| after == values);
    let result = WriteResult {
        address,
        before,
        written: values,
        after: after.as_ref().ok().cloned(),
        confirmed,
        error: written.as_ref().err().map(ToString::to_string),
        is_emulator,
        counters: client.counters(),
    };
    drop(client);
    drop(tap);
    output::result(&result, arguments.json, text)?;
    match (written, after) {
        (Err(error), _) | (Ok(()), Err(error)) => Err(failure(error)),
        (Ok(()), Ok(_)) if confirmed => Ok(()),
        (Ok(()), Ok(after)) => Err(Failure::with_help(
            LINK,
            format!("the unit acknowledged {values:?} at {address} and holds {after:?}"),
            "the register may be limited, clear itself, or be writable only in another state; see the drive's manual",
        )),
    }
}

/// Only what says so itself is an emulator; a unit that answers otherwise, or not, counts as hardware.
fn is_emulator(client: &mut RawClient) -> Result<bool, Failure> {
    match client.identify() {
        Ok(identity) => Ok(identity.is_some_and(|identity| identity.is_emulator)),
        Err(error) if error.is_transient() => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// The values now, vouched for.
fn read_back(client: &mut RawClient, address: u16, count: u16) -> Result<Vec<u16>, LinkError> {
    let request = ReadRequest {
        table: RegisterTable::Holding,
        address,
        count,
    };
    let never = AtomicBool::new(false);
    let reads = read_batch(client, &[request], 1, &never).reads;
    reads
        .into_iter()
        .next()
        .map_or(Ok(Vec::new()), |read| read.values)
}

/// Told before anything is asked or done.
fn announce(address: u16, before: Option<&[u16]>, values: &[u16]) {
    for (index, value) in values.iter().enumerate() {
        let there = before
            .and_then(|before| before.get(index))
            .map_or("?".to_owned(), ToString::to_string);
        output::message(&format!(
            "{:>5}  {there} -> {value} (0x{value:04x})",
            usize::from(address) + index
        ));
    }
}

fn consent(arguments: &Arguments, is_emulator: bool) -> Result<(), Failure> {
    if arguments.yes {
        if is_emulator || arguments.hardware {
            return Ok(());
        }
        return Err(Failure::with_help(
            USAGE,
            "the unit does not identify itself as an emulator: nothing was written",
            "add --hardware when a real drive may get this value, with the emergency stop within reach",
        ));
    }
    let mut terminal = std::io::stdin().lock();
    if arguments.json || !std::io::stdin().is_terminal() || !std::io::stderr().is_terminal() {
        return Err(Failure::with_help(
            USAGE,
            "nothing was written: there is nobody to ask",
            "add --yes to write without a question",
        ));
    }
    let mut answer = String::new();
    let mut stderr = std::io::stderr();
    let asked = write!(stderr, "write? [y/N] ").and_then(|()| stderr.flush());
    let heard = asked.and_then(|()| terminal.read_line(&mut answer));
    if heard.is_ok() && matches!(answer.trim(), "y" | "Y" | "yes") {
        return Ok(());
    }
    Err(Failure::with_help(
        USAGE,
        "nothing was written",
        "answer y to write",
    ))
}

fn text(result: &WriteResult<'_>) -> String {
    let mut text = String::new();
    let confirmed = if result.confirmed {
        "confirmed by reading back"
    } else {
        "NOT confirmed"
    };
    let _ = writeln!(
        text,
        "{} at {}: {confirmed}",
        registers(result.written.len()),
        result.address
    );
    if let Some(after) = result.after.as_ref().filter(|_| !result.confirmed) {
        let _ = writeln!(text, "the unit holds {after:?}");
    }
    text
}

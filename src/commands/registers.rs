//! `registers`: raw Modbus registers of any unit.
//!
//! ```text
//! read  -> batch of reads -> values, rates, counters
//! write -> present and new values -> consent -> write once -> read back
//! ```
//!
//! Writing needs consent, because a register of a drive may start a motor.

use std::fmt::Write as _;

use clap::Subcommand;
use serde::Serialize;

use crate::commands::arguments::WireArguments;
use crate::runtime::failure::Failure;
use crate::runtime::output::{Terminal, lines};
use crate::runtime::{output, signals};
use drivebench_link::{
    Batch, LinkError, MOST_READ, MOST_WRITTEN, RawClient, RawCounters, ReadRequest, RegisterTable,
    WriteFunction, WriteOutcome, Written, read_batch, registers,
};

/// Read or write raw Modbus registers of any unit, over a serial port or TCP
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench registers read 0:16 --port /dev/ttyUSB0 --baud 19200 --framing 8E1 --unit 3
  drivebench registers write 100 1500 --host 192.168.1.7:502")]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Read(ReadArguments),
    Write(WriteArguments),
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    match &arguments.command {
        Command::Read(arguments) => read(arguments, terminal),
        Command::Write(arguments) => write(arguments, terminal),
    }
}

/// What a register takes: as [`number`], or negative in two's complement.
fn value(text: &str) -> Result<u16, String> {
    match text.parse::<i16>() {
        Ok(negative) if negative < 0 => Ok(u16::from_be_bytes(negative.to_be_bytes())),
        _ => number(text).map_err(|_| {
            format!("{text:?} is not a number from -32768 to 65535 (0x... for hexadecimal)")
        }),
    }
}

/// Decimal, or hexadecimal with 0x.
fn number(text: &str) -> Result<u16, String> {
    let parsed = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u16::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    };
    parsed
        .ok_or_else(|| format!("{text:?} is not a number from 0 to 65535 (0x... for hexadecimal)"))
}

/// Read registers by protocol address; exit status 0 when every read is answered, 3 otherwise
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench registers read 10 --port /dev/ttyUSB0
  drivebench registers read 0:16 0x2100:4 --host 192.168.1.7:502 --unit 2 --json
  drivebench registers read 0:10 --port drive.pty --repeat 1000 --gap-us 0     how fast is this line?

Addresses are those of the protocol, from 0: register 40001 of a manual is address 0.")]
struct ReadArguments {
    /// Registers to read: ADDRESS, or ADDRESS:COUNT
    #[arg(required = true, value_name = "ADDRESS[:COUNT]", value_parser = span)]
    spans: Vec<(u16, u16)>,
    #[command(flatten)]
    wire: WireArguments,
    /// Input registers instead of holding registers
    #[arg(long)]
    input: bool,
    /// Rounds of all reads; the values of the last are shown
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    repeat: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn span(text: &str) -> Result<(u16, u16), String> {
    let (address, count) = text.split_once(':').unwrap_or((text, "1"));
    let (address, count) = (number(address)?, number(count)?);
    if !(1..=MOST_READ).contains(&count) {
        let most = format!("1 to {MOST_READ}, what one request can carry");
        return Err(format!("{count} registers are not {most}"));
    }
    let last = address.checked_add(count - 1);
    let beyond = || format!("{count} registers at {address} reach beyond address 65535");
    last.map(|_| (address, count)).ok_or_else(beyond)
}

fn read(arguments: &ReadArguments, terminal: &Terminal) -> Result<(), Failure> {
    let table = if arguments.input { RegisterTable::Input } else { RegisterTable::Holding };
    let request = |&(address, count): &(u16, u16)| ReadRequest { table, address, count };
    let requests: Vec<_> = arguments.spans.iter().map(request).collect();
    let stop = signals::flag()?;
    let tap = arguments.wire.tap(terminal)?;
    let mut client = arguments.wire.open(&tap, terminal)?;
    let batch = read_batch(&mut client, &requests, arguments.repeat, &stop);
    let counters = client.counters();
    drop(client);
    drop(tap);
    let result = ReadResult::of(&batch, counters);
    terminal.result(&result, arguments.json, ReadResult::text)?;
    if batch.is_interrupted {
        let headline = format!("interrupted after {} of the reads", batch.asked);
        return Err(Failure::interrupted(headline));
    }
    verdict(batch)
}

/// Write holding registers once, read them back and compare; needs consent at the terminal, or --yes
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench registers write 100 1500 --port /dev/ttyUSB0          shows what changes, then needs a yes
  drivebench registers write 0x2000 18 3000 --host 192.168.1.7:502 --yes --hardware

A register of a drive may start a motor. A write is never repeated by itself: when its reply is lost, what the unit
holds is read and shown. --hardware is needed with --yes for anything that does not identify itself as our emulator.")]
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a command line, each independent of the others"
)]
struct WriteArguments {
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

fn write(arguments: &WriteArguments, terminal: &Terminal) -> Result<(), Failure> {
    let (address, values) = (arguments.address, arguments.values.as_slice());
    let count = u16::try_from(values.len()).unwrap_or(u16::MAX);
    if values.len() > MOST_WRITTEN || address.checked_add(count - 1).is_none() {
        let headline = format!("{} at {address} do not fit one request", registers(count.into()));
        let help = format!("at most {MOST_WRITTEN} registers, up to address 65535");
        return Err(Failure::usage(headline, help));
    }
    let tap = arguments.wire.tap(terminal)?;
    let mut client = arguments.wire.open(&tap, terminal)?;
    let (result, verdict) = write_once(&mut client, arguments, count, terminal)?;
    drop(client);
    drop(tap);
    terminal.result(&result, arguments.json, WriteResult::text)?;
    verdict
}

fn consent(arguments: &WriteArguments, is_emulator: bool) -> Result<(), Failure> {
    if arguments.yes {
        if is_emulator || arguments.hardware {
            return Ok(());
        }
        return Err(Failure::usage(
            "the unit does not identify itself as an emulator: nothing was written",
            "add --hardware when a real drive may get this value, with the emergency stop within reach",
        ));
    }
    let answer = if arguments.json { None } else { output::ask("write? [y/N] ") };
    match answer.as_deref().map(str::trim) {
        Some("y" | "Y" | "yes") => Ok(()),
        Some(_) => Err(Failure::usage("nothing was written", "answer y to write")),
        None => Err(Failure::usage(
            "nothing was written: there is no person at a terminal",
            "add --yes to write without a question",
        )),
    }
}

/// The result as JSON.
#[derive(Serialize)]
struct ReadResult {
    reads: Vec<ReadOutcome>,
    /// Reads of all rounds.
    asked: u64,
    answered: u64,
    rate_hz: Option<f64>,
    p50_us: Option<f64>,
    p99_us: Option<f64>,
    worst_us: Option<f64>,
    counters: RawCounters,
}

#[derive(Serialize)]
struct ReadOutcome {
    address: u16,
    #[serde(skip_serializing_if = "Option::is_none")]
    values: Option<Vec<u16>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

impl ReadResult {
    fn of(batch: &Batch, counters: RawCounters) -> Self {
        let us = |time_s: Option<f64>| time_s.map(|time_s| time_s * 1e6);
        let reads = batch.reads.iter().map(|read| ReadOutcome {
            address: read.request.address,
            values: read.values.as_ref().ok().cloned(),
            error: read.values.as_ref().err().map(ToString::to_string),
        });
        Self {
            reads: reads.collect(),
            asked: batch.asked,
            answered: batch.answered,
            rate_hz: batch.rate_hz(),
            p50_us: us(batch.quantile_s(0.5)),
            p99_us: us(batch.quantile_s(0.99)),
            worst_us: us(batch.quantile_s(1.0)),
            counters,
        }
    }

    /// The registers, and the counters where requests have failed.
    fn text(&self) -> String {
        let mut text = String::new();
        for read in &self.reads {
            if let Some(error) = &read.error {
                let _ = writeln!(text, "{:>5}  error: {error}", read.address);
            }
            let lines = read.values.as_deref().unwrap_or_default().chunks(8);
            for (index, line) in lines.enumerate() {
                let decimal: Vec<String> = line.iter().map(|value| format!("{value:>5}")).collect();
                let hexadecimal: Vec<String> = line.iter().map(|v| format!("{v:04x}")).collect();
                let (decimal, hexadecimal) = (decimal.join(" "), hexadecimal.join(" "));
                let address = usize::from(read.address) + index * 8;
                let _ = writeln!(text, "{address:>5}  {decimal:<48} {hexadecimal}");
            }
        }
        let c = &self.counters;
        let r = &c.requests;
        if let (true, Some(rate_hz), Some(p50), Some(p99), Some(worst)) = (
            self.asked > self.reads.len() as u64,
            self.rate_hz,
            self.p50_us,
            self.p99_us,
            self.worst_us,
        ) {
            let _ = writeln!(
                text,
                "{} of {} reads answered, {rate_hz:.0} per second; round trip {p50:.0} us (median), {p99:.0} us (99 %), {worst:.0} us (worst)",
                self.answered, self.asked
            );
        }
        let busy = (c.busy_repeats > 0).then_some(c.busy_repeats);
        lines(&mut text, "reads repeated because the unit was busy: ", busy);
        // A refused probe that the line is in step is no refused read.
        let is_clean = self.answered == self.asked
            && self.reads.iter().all(|read| read.error.is_none())
            && r.timeout + r.crc + r.stale + r.mismatch + r.aborted == 0;
        if !is_clean {
            let probes = match c.probes {
                0 => String::new(),
                1 => " and 1 probe that the line is in step".to_owned(),
                count => format!(" and {count} probes that the line is in step"),
            };
            let _ = writeln!(
                text,
                "{} requests{probes}: {} ok, {} timeout, {} crc, {} stale, {} mismatch, {} exception, {} aborted",
                r.sent - c.probes,
                r.ok,
                r.timeout,
                r.crc,
                r.stale,
                r.mismatch,
                r.exception,
                r.aborted
            );
        }
        text
    }
}

/// Every read was answered, or the first that was not is the failure.
fn verdict(batch: Batch) -> Result<(), Failure> {
    if batch.is_all_answered() {
        return Ok(());
    }
    let missing = batch.asked - batch.answered.min(batch.asked);
    match batch.reads.into_iter().find_map(|read| read.values.err()) {
        Some(error) => Err(error.into()),
        None => Err(Failure::link(
            format!("{missing} of {} reads got no answer", batch.asked),
            "see the counters: timeout (cable, power), crc (noise, baud rate), stale (late replies: a longer --timeout-ms)",
        )),
    }
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
    outcome: WriteOutcome,
    /// The unit accepted the write before it carried it out (exception 05): how long the registers were read again, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    accepted_s: Option<f64>,
    /// Why the registers cannot be read back.
    #[serde(skip_serializing_if = "Option::is_none")]
    unreadable: Option<String>,
    /// Why the write itself was not acknowledged.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    is_emulator: bool,
    counters: RawCounters,
}

impl WriteResult<'_> {
    fn text(&self) -> String {
        let mut text = String::new();
        let (what, address) = (registers(self.written.len()), self.address);
        let taken = match self.accepted_s {
            Some(_) => "accepted (exception 0x05 acknowledge)",
            None => "acknowledged",
        };
        let outcome = match (self.outcome, self.accepted_s) {
            (WriteOutcome::Confirmed, Some(waited_s)) => {
                format!("{taken}, confirmed by reading back after {waited_s:.2} s")
            }
            (WriteOutcome::Confirmed, None) => "confirmed by reading back".to_owned(),
            (WriteOutcome::Unreadable, _) => format!("{taken}, cannot be read back"),
            (WriteOutcome::Pending, Some(waited_s)) => {
                format!("{taken}, NOT carried out within {waited_s:.0} s: it may still act")
            }
            _ => "NOT confirmed".to_owned(),
        };
        let _ = writeln!(text, "{what} at {address}: {outcome}");
        lines(&mut text, "reading back: ", &self.unreadable);
        let after = self.after.as_ref().filter(|_| !self.confirmed);
        lines(&mut text, "the unit holds ", after.map(|after| format!("{after:?}")));
        text
    }
}

/// Shows the present and the new values, writes with consent, and reads back; the result, and its failure.
fn write_once<'a>(
    client: &mut RawClient,
    arguments: &'a WriteArguments,
    count: u16,
    terminal: &Terminal,
) -> Result<(WriteResult<'a>, Result<(), Failure>), Failure> {
    let (address, values) = (arguments.address, arguments.values.as_slice());
    let is_emulator = is_emulator(client)?;
    let before = client.read_back(address, count);
    if let Err(
        error @ (LinkError::Timeout { .. } | LinkError::Unexpected { .. } | LinkError::Gone { .. }),
    ) = before
    {
        return Err(error.into());
    }
    let before = before.ok();
    for (index, value) in values.iter().enumerate() {
        let present = before.as_ref().and_then(|before| before.get(index));
        let present = present.map_or("?".to_owned(), ToString::to_string);
        let address = usize::from(address) + index;
        terminal.message(&format!("{address:>5}  {present} -> {value} (0x{value:04x})"));
    }
    consent(arguments, is_emulator)?;
    let function = if values.len() > 1 || arguments.multiple {
        WriteFunction::Multiple
    } else {
        WriteFunction::Single
    };
    let done = client.write_and_read_back(function, address, values);
    let result = WriteResult {
        address,
        before,
        written: values,
        after: done.after.as_ref().ok().cloned(),
        confirmed: done.outcome == WriteOutcome::Confirmed,
        outcome: done.outcome,
        accepted_s: done.accepted_s,
        unreadable: done.after.as_ref().err().map(ToString::to_string),
        error: done.acknowledged.as_ref().err().map(ToString::to_string),
        is_emulator,
        counters: client.counters(),
    };
    Ok((result, write_verdict(done, address, values)))
}

/// Good: acknowledged or accepted, and confirmed as far as the unit gives its registers.
fn write_verdict(done: Written, address: u16, values: &[u16]) -> Result<(), Failure> {
    let is_taken = done.acknowledged.is_ok() || done.accepted_s.is_some();
    match (done.outcome, done.acknowledged, done.after) {
        (WriteOutcome::Confirmed | WriteOutcome::Unreadable, ..) if is_taken => Ok(()),
        (WriteOutcome::Differs, _, Ok(after)) => Err(Failure::link(
            format!("the unit acknowledged {values:?} at {address} and holds {after:?}"),
            "the register may be limited, clear itself, or be writable only in another state; see the drive's manual",
        )),
        (_, Err(error), _) | (_, _, Err(error)) => Err(error.into()),
        (_, Ok(()), Ok(_)) => Ok(()),
    }
}

/// Only a unit that identifies itself as an emulator is one; any other counts as hardware.
fn is_emulator(client: &mut RawClient) -> Result<bool, Failure> {
    match client.identify() {
        Ok(identity) => Ok(identity.is_some_and(|identity| identity.is_emulator)),
        Err(error) if error.is_transient() => Ok(false),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_spans_are_read_in_both_bases_and_bounded() {
        for (text, expected) in [
            ("-1", Some(0xFFFF)),
            ("-32768", Some(0x8000)),
            ("65535", Some(0xFFFF)),
            ("0x10", Some(16)),
            ("-32769", None),
            ("65536", None),
            ("1.5", None),
            ("", None),
        ] {
            assert_eq!(value(text).ok(), expected, "value {text}");
        }
        for (text, expected) in [
            ("10", Some((10, 1))),
            ("0x2100:0x10", Some((0x2100, 16))),
            ("65535:1", Some((65_535, 1))),
            ("", None),
            (":", None),
            ("a", None),
            ("-1", None),
            ("65536", None),
            ("0:0", None),
            ("0:126", None),
            ("65535:2", None),
            ("1:2:3", None),
        ] {
            assert_eq!(span(text).ok(), expected, "span {text}");
        }
    }
}

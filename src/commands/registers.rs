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
use crate::commands::register_values::{
    Address, ByteOrder, Format, Guess, Value, ValueType, cell, guesses,
};
use crate::runtime::{Failure, Terminal, lines, output, signals};
use drivebench_link::{
    Batch, CellTable, LinkError, MOST_READ, MOST_WRITTEN, RawClient, RawCounters, ReadRequest,
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

/// As [`cell`], or an error.
fn number(text: &str) -> Result<u16, String> {
    cell(text)
        .ok_or_else(|| format!("{text:?} is not a number from 0 to 65535 (0x... for hexadecimal)"))
}

/// Read registers by protocol address; exit status 0 when every read is answered, 3 otherwise
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench registers read 10 --port /dev/ttyUSB0
  drivebench registers read 0:16 0x2100:4 --host 192.168.1.7:502 --unit 2 --json
  drivebench registers read 400:4 --as f32 --order CDAB --port /dev/ttyUSB0
  drivebench registers read 4x0401:4 --guess --port /dev/ttyUSB0               which type and order could it be?
  drivebench registers read 0:10 --port drive.pty --repeat 1000 --gap-us 0     how fast is this line?

Addresses are those of the protocol, from 0: register 40001 of a manual is address 0, and may be given as 4x1 (input
register 30001 as 3x1) or with six digits as 400001 (300001). 40001 itself is the protocol address 40001.")]
struct ReadArguments {
    /// Registers to read: ADDRESS, or ADDRESS:COUNT; without COUNT one value
    #[arg(required = true, value_name = "ADDRESS[:COUNT]", value_parser = span)]
    spans: Vec<Span>,
    #[command(flatten)]
    wire: WireArguments,
    /// Input registers instead of holding registers
    #[arg(long)]
    input: bool,
    #[command(flatten)]
    typed: Typed,
    /// Show every reading of the registers that looks plausible, and why
    #[arg(long, conflicts_with = "kind")]
    guess: bool,
    /// Rounds of all reads; the values of the last are shown
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    repeat: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Registers to read, as they are given.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Span {
    address: Address,
    count: Option<u16>,
}

fn span(text: &str) -> Result<Span, String> {
    let (address, count) = match text.split_once(':') {
        Some((address, count)) => (address, Some(number(count)?)),
        None => (text, None),
    };
    let address = Address::parse(address)?;
    if let Some(count) = count.filter(|count| !(1..=MOST_READ).contains(count)) {
        let most = format!("1 to {MOST_READ}, what one request can carry");
        return Err(format!("{count} registers are not {most}"));
    }
    Ok(Span { address, count })
}

impl Span {
    /// The request, with the registers that the values need.
    fn request(&self, is_input: bool, format: Option<Format>) -> Result<ReadRequest, Failure> {
        let Address { number: address, table, .. } = self.address;
        let table = match (table, is_input) {
            (Some(CellTable::Holding), true) => {
                let headline = format!("{} is a holding register", self.text());
                return Err(Failure::usage(headline, "leave --input out, or give 3x..."));
            }
            (Some(table), _) => table,
            (None, true) => CellTable::Input,
            (None, false) => CellTable::Holding,
        };
        let each = format.map_or(1, Format::registers);
        let count = self.count.unwrap_or(each);
        if !count.is_multiple_of(each) {
            return Err(Failure::usage(
                format!("{count} registers at {} are no whole number of values", self.text()),
                format!("a value of this type takes {each} registers: {}:{each}", self.text()),
            ));
        }
        if address.checked_add(count - 1).is_none() {
            return Err(Failure::usage(
                format!("{count} registers at {address} reach beyond address 65535"),
                "a lower address or fewer registers",
            ));
        }
        Ok(ReadRequest { table, address, count })
    }

    fn text(&self) -> String {
        self.address.notation.clone().unwrap_or_else(|| self.address.number.to_string())
    }
}

/// How the values are typed.
#[derive(clap::Args)]
struct Typed {
    /// Type of the values; without it each is one register
    #[arg(long = "as", value_enum, value_name = "TYPE")]
    kind: Option<ValueType>,
    /// Order of the bytes of a value on the line, the highest is A
    #[arg(long, value_enum, ignore_case = true, requires = "kind", default_value = "ABCD")]
    order: ByteOrder,
}

impl Typed {
    fn format(&self) -> Result<Option<Format>, Failure> {
        let format = self.kind.map(|kind| Format::new(kind, self.order)).transpose();
        format.map_err(|headline| Failure::usage(headline, "ABCD is the order of the standard"))
    }
}

fn read(arguments: &ReadArguments, terminal: &Terminal) -> Result<(), Failure> {
    let format = arguments.typed.format()?;
    let request = |span: &Span| span.request(arguments.input, format);
    let requests = arguments.spans.iter().map(request).collect::<Result<Vec<_>, _>>()?;
    for remark in arguments.spans.iter().filter_map(|span| span.address.remark()) {
        terminal.message(&remark);
    }
    let stop = signals::flag()?;
    let tap = arguments.wire.tap(terminal)?;
    let mut client = arguments.wire.open(&tap, terminal)?;
    let batch = read_batch(&mut client, &requests, arguments.repeat, &stop);
    let counters = client.counters();
    drop(client);
    drop(tap);
    let result = ReadResult::of(&batch, counters, arguments, format);
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
  drivebench registers write 4x0401 49.98 --as f32 --order CDAB --port /dev/ttyUSB0
  drivebench registers write 0x2000 18 3000 --host 192.168.1.7:502 --yes --hardware

A register of a drive may start a motor. A write is never repeated by itself: when its reply is lost, what the unit
holds is read and shown. --hardware is needed with --yes for anything that does not identify itself as our emulator.")]
struct WriteArguments {
    /// Protocol address of the first register, from 0; or as manuals count: 4x1, 400001
    #[arg(value_parser = Address::parse)]
    address: Address,
    /// Values from there on; without --as one for each register
    #[arg(required = true, value_name = "VALUE", allow_negative_numbers = true)]
    values: Vec<String>,
    #[command(flatten)]
    typed: Typed,
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
    let address = arguments.address.number;
    if arguments.address.table == Some(CellTable::Input) {
        return Err(Failure::usage(
            format!("{address} is an input register, which nothing writes"),
            "holding registers are 4x1, 400001, or protocol addresses",
        ));
    }
    let format = arguments.typed.format()?;
    let encoded = arguments.values.iter().map(|text| match format {
        Some(format) => format.encode(text),
        None => value(text).map(|word| vec![word]),
    });
    let encoded = encoded.collect::<Result<Vec<_>, _>>();
    let values = encoded.map(|values| values.concat()).map_err(|headline| {
        Failure::usage(headline, "--as names another type (u16, i16, u32, i32, f32, text)")
    })?;
    let values = values.as_slice();
    let count = u16::try_from(values.len()).unwrap_or(u16::MAX);
    if values.len() > MOST_WRITTEN || address.checked_add(count - 1).is_none() {
        let headline = format!("{} at {address} do not fit one request", registers(count.into()));
        let help = format!("at most {MOST_WRITTEN} registers, up to address 65535");
        return Err(Failure::usage(headline, help));
    }
    if let Some(remark) = arguments.address.remark() {
        terminal.message(&remark);
    }
    let tap = arguments.wire.tap(terminal)?;
    let mut client = arguments.wire.open(&tap, terminal)?;
    let (result, verdict) = write_once(&mut client, arguments, (values, format), terminal)?;
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
    /// `input`; absent for holding registers.
    #[serde(skip_serializing_if = "Option::is_none")]
    table: Option<&'static str>,
    /// The address as it was given, where it is no protocol address.
    #[serde(skip_serializing_if = "Option::is_none")]
    notation: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    values: Option<Vec<u16>>,
    #[serde(flatten)]
    format: Option<Format>,
    /// The values by type and order.
    #[serde(skip_serializing_if = "Option::is_none")]
    decoded: Option<Vec<Value>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    guesses: Option<Vec<Guess>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

impl ReadOutcome {
    /// The values with their registers, or the registers alone.
    fn text(&self) -> String {
        let mut text = String::new();
        if let Some(error) = &self.error {
            let _ = writeln!(text, "{:>5}  error: {error}", self.address);
        }
        let registers = self.values.as_deref().unwrap_or_default();
        let hexadecimal = |registers: &[u16]| {
            registers.iter().map(|v| format!("{v:04x}")).collect::<Vec<_>>().join(" ")
        };
        if let Some(decoded) = self.decoded.as_ref().filter(|_| !registers.is_empty()) {
            let each = registers.len() / decoded.len().max(1);
            for (index, (value, own)) in decoded.iter().zip(registers.chunks(each)).enumerate() {
                let address = usize::from(self.address) + index * each;
                let (value, own) = (value.text(), hexadecimal(own));
                let _ = writeln!(text, "{address:>5}  {value:<16} {own}");
            }
            return text;
        }
        for (index, line) in registers.chunks(8).enumerate() {
            let decimal: Vec<String> = line.iter().map(|value| format!("{value:>5}")).collect();
            let (decimal, hexadecimal) = (decimal.join(" "), hexadecimal(line));
            let address = usize::from(self.address) + index * 8;
            let _ = writeln!(text, "{address:>5}  {decimal:<48} {hexadecimal}");
        }
        lines(&mut text, "", self.guesses.iter().flatten().map(Guess::line));
        text
    }
}

impl ReadResult {
    fn of(
        batch: &Batch,
        counters: RawCounters,
        arguments: &ReadArguments,
        format: Option<Format>,
    ) -> Self {
        let us = |time_s: Option<f64>| time_s.map(|time_s| time_s * 1e6);
        let reads = batch.reads.iter().zip(&arguments.spans).map(|(read, span)| {
            let address = read.request.address;
            let registers = read.values.as_deref().unwrap_or_default();
            ReadOutcome {
                address,
                table: (read.request.table == CellTable::Input).then_some("input"),
                notation: span.address.notation.clone(),
                values: read.values.as_ref().ok().cloned(),
                format,
                decoded: format.map(|format| format.decode(registers)),
                guesses: arguments.guess.then(|| guesses(address, registers)),
                error: read.values.as_ref().err().map(ToString::to_string),
            }
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
            text.push_str(&read.text());
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
        text.push_str(&strays_text(c));
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

/// Replies that came with stray bytes, where there were some.
pub(super) fn strays_text(counters: &RawCounters) -> String {
    let answered = counters.requests.ok + counters.requests.exception;
    match counters.line.stray_replies {
        0 => String::new(),
        count => format!(
            "{count} of {answered} replies came with stray bytes around them, which were dropped: bias or termination of the line, or the turnaround of the adapter\n"
        ),
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

#[derive(Serialize)]
struct WriteResult<'a> {
    address: u16,
    /// Null where the registers cannot be read.
    before: Option<Vec<u16>>,
    written: &'a [u16],
    after: Option<Vec<u16>>,
    #[serde(flatten)]
    format: Option<Format>,
    /// What they hold now, by type and order.
    #[serde(skip_serializing_if = "Option::is_none")]
    decoded: Option<Vec<Value>>,
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
        if let Some(format) = self.format {
            let held = self.decoded.iter().flatten().map(Value::text).collect::<Vec<_>>().join(" ");
            lines(
                &mut text,
                &format!("as {} ", format.name()),
                Some(held).filter(|h| !h.is_empty()),
            );
        }
        let after = self.after.as_ref().filter(|_| !self.confirmed);
        lines(&mut text, "the unit holds ", after.map(|after| format!("{after:?}")));
        text
    }
}

/// Shows the present and the new values, writes with consent, and reads back; the result, and its failure.
fn write_once<'a>(
    client: &mut RawClient,
    arguments: &WriteArguments,
    (values, format): (&'a [u16], Option<Format>),
    terminal: &Terminal,
) -> Result<(WriteResult<'a>, Result<(), Failure>), Failure> {
    let address = arguments.address.number;
    let count = u16::try_from(values.len()).unwrap_or(u16::MAX);
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
        format,
        decoded: format.map(|format| format.decode(done.after.as_deref().unwrap_or_default())),
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
        let wrong = ["", ":", "a", "-1", "65536", "0:0", "0:126", "65535:2", "1:2:3"];
        let float = Format::new(ValueType::F32, ByteOrder::Cdab).ok();
        for (text, format, expected) in [
            ("10", None, Some((10, 1))),
            ("0x2100:0x10", None, Some((0x2100, 16))),
            ("65535:1", None, Some((65_535, 1))),
            ("4x11:2", None, Some((10, 2))),
            ("10", float, Some((10, 2))),
            ("10:4", float, Some((10, 4))),
            ("10:3", float, None),
            ("65535", float, None),
        ]
        .into_iter()
        .chain(wrong.map(|text| (text, None, None)))
        {
            let request = span(text).ok().and_then(|span| span.request(false, format).ok());
            let found = request.map(|request| (request.address, request.count));
            assert_eq!(found, expected, "span {text}");
        }
        assert!(span("4x1").unwrap().request(true, None).is_err(), "a holding register");
        let input = span("3x1").unwrap().request(false, None).unwrap();
        assert_eq!((input.table, input.address), (CellTable::Input, 0));
    }
}

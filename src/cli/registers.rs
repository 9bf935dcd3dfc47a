//! `registers`: raw Modbus registers, read and written, of any unit.
//!
//! ```text
//! registers read  -> batch of reads -> app::registers: values that are vouched for, rates, counters
//! registers write -> app::registers: what is there, what is to come -> yes? -> write once -> read back
//! ```

use clap::Subcommand;

use super::arguments::WireArguments;
use super::failure::Failure;
use super::{output, signals};
use crate::app::registers::{ReadResult, WriteResult, verdict, write_once};
use drivebench_link::{MOST_READ, MOST_WRITTEN, ReadRequest, RegisterTable, read_batch, registers};

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

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.command {
        Command::Read(arguments) => read(arguments),
        Command::Write(arguments) => write(arguments),
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

fn read(arguments: &ReadArguments) -> Result<(), Failure> {
    let table = if arguments.input {
        RegisterTable::Input
    } else {
        RegisterTable::Holding
    };
    let spans = arguments.spans.iter();
    let requests = spans.map(|&(address, count)| ReadRequest {
        table,
        address,
        count,
    });
    let requests: Vec<ReadRequest> = requests.collect();
    let stop = signals::flag()?;
    let tap = arguments.wire.tap()?;
    let mut client = arguments.wire.open(&tap)?;
    let batch = read_batch(&mut client, &requests, arguments.repeat, &stop);
    let counters = client.counters();
    drop(client);
    drop(tap);
    let result = ReadResult::of(&batch, counters);
    output::result(&result, arguments.json, ReadResult::text)?;
    if batch.is_interrupted {
        let headline = format!("interrupted after {} of the reads", batch.asked);
        return Err(Failure::interrupted(headline));
    }
    verdict(batch)
}

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

fn write(arguments: &WriteArguments) -> Result<(), Failure> {
    let (address, values) = (arguments.address, arguments.values.as_slice());
    let count = u16::try_from(values.len()).unwrap_or(u16::MAX);
    if values.len() > MOST_WRITTEN || address.checked_add(count - 1).is_none() {
        let headline = format!(
            "{} at {address} do not fit one request",
            registers(count.into())
        );
        let help = format!("at most {MOST_WRITTEN} registers, up to address 65535");
        return Err(Failure::usage(headline, help));
    }
    let tap = arguments.wire.tap()?;
    let mut client = arguments.wire.open(&tap)?;
    let consent = |is_emulator| consent(arguments, is_emulator);
    let (result, verdict) = write_once(&mut client, address, values, arguments.multiple, consent)?;
    drop(client);
    drop(tap);
    output::result(&result, arguments.json, WriteResult::text)?;
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
    let answer = if arguments.json {
        None
    } else {
        output::ask("write? [y/N] ")
    };
    match answer.as_deref().map(str::trim) {
        Some("y" | "Y" | "yes") => Ok(()),
        Some(_) => Err(Failure::usage("nothing was written", "answer y to write")),
        None => Err(Failure::usage(
            "nothing was written: there is nobody to ask",
            "add --yes to write without a question",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_register_takes_what_sixteen_bits_hold_signed_or_not() {
        assert_eq!(value("-1"), Ok(0xFFFF));
        assert_eq!(value("-32768"), Ok(0x8000));
        assert_eq!(value("65535"), Ok(0xFFFF));
        assert_eq!(value("0x10"), Ok(16));
        for wrong in ["-32769", "65536", "1.5", ""] {
            assert!(value(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn spans_are_read_in_both_bases_and_bounded() {
        assert_eq!(span("10"), Ok((10, 1)));
        assert_eq!(span("0x2100:0x10"), Ok((0x2100, 16)));
        assert_eq!(span("65535:1"), Ok((65_535, 1)));
        for wrong in [
            "", ":", "a", "-1", "65536", "0:0", "0:126", "65535:2", "1:2:3",
        ] {
            assert!(span(wrong).is_err(), "{wrong}");
        }
    }
}

//! `registers`: raw Modbus registers, read and written, of any unit.
//!
//! ```text
//! registers read  -> batch of reads -> values that are vouched for, rates, counters   (read.rs)
//! registers write -> what is there, what is to come -> yes? -> write once -> read back (write.rs)
//! ```

mod read;
mod write;

use clap::Subcommand;

use super::failure::{Failure, LINK};
use crate::drive::LinkError;

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
    Read(read::Arguments),
    Write(write::Arguments),
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.command {
        Command::Read(arguments) => read::execute(arguments),
        Command::Write(arguments) => write::execute(arguments),
    }
}

/// What a link error means to someone who named the registers himself.
fn failure(error: LinkError) -> Failure {
    match error {
        LinkError::Exception { .. } => Failure::with_help(
            LINK,
            error.to_string(),
            "the unit has no such register, or not so many in one request; addresses count from 0 (40001 is 0)",
        ),
        LinkError::Gone { .. } => Failure::with_help(
            LINK,
            error.to_string(),
            "the cable or the peer went away: check it, and ask again",
        ),
        other => other.into(),
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
}

//! `registers read`.

use std::fmt::Write as _;

use serde::Serialize;

use super::super::failure::{Failure, INTERRUPTED, LINK};
use super::super::wire::{Tap, WireArguments};
use super::super::{output, signals};
use super::{failure, number};
use crate::drive::{Batch, MOST_READ, RawCounters, Read, ReadRequest, RegisterTable, read_batch};

/// Values on one line of the text.
const A_LINE: usize = 8;

/// Read registers by protocol address; exit status 0 when every read is answered, 3 otherwise
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench registers read 10 --port /dev/ttyUSB0
  drivebench registers read 0:16 0x2100:4 --host 192.168.1.7:502 --unit 2 --json
  drivebench registers read 0:10 --port drive.pty --repeat 1000 --gap-us 0     how fast is this line?

Addresses are those of the protocol, from 0: register 40001 of a manual is address 0.")]
pub(in super::super) struct Arguments {
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
        return Err(format!(
            "{count} registers are not 1 to {MOST_READ}, what one request can carry"
        ));
    }
    if address.checked_add(count - 1).is_none() {
        return Err(format!(
            "{count} registers at {address} reach beyond address 65535"
        ));
    }
    Ok((address, count))
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

impl From<&Read> for ReadOutcome {
    fn from(read: &Read) -> Self {
        Self {
            address: read.request.address,
            values: read.values.as_ref().ok().cloned(),
            error: read.values.as_ref().err().map(ToString::to_string),
        }
    }
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let table = if arguments.input {
        RegisterTable::Input
    } else {
        RegisterTable::Holding
    };
    let requests: Vec<ReadRequest> = arguments
        .spans
        .iter()
        .map(|&(address, count)| ReadRequest {
            table,
            address,
            count,
        })
        .collect();
    let stop = signals::flag()?;
    let tap = Tap::create(arguments.wire.tap.as_deref())?;
    let mut client = arguments.wire.open(&tap)?;
    let batch = read_batch(&mut client, &requests, arguments.repeat, &stop);
    let counters = client.counters();
    drop(client);
    drop(tap);
    let us = |time_s: Option<f64>| time_s.map(|time_s| time_s * 1e6);
    let result = ReadResult {
        reads: batch.reads.iter().map(ReadOutcome::from).collect(),
        asked: batch.asked,
        answered: batch.answered,
        rate_hz: batch.rate_hz(),
        p50_us: us(batch.quantile_s(0.5)),
        p99_us: us(batch.quantile_s(0.99)),
        worst_us: us(batch.quantile_s(1.0)),
        counters,
    };
    output::result(&result, arguments.json, text)?;
    if batch.is_interrupted {
        let headline = format!("interrupted after {} of the reads", batch.asked);
        return Err(Failure::new(INTERRUPTED, headline));
    }
    verdict(batch)
}

/// Every read was answered, or the first that was not is the failure.
fn verdict(batch: Batch) -> Result<(), Failure> {
    if batch.is_all_answered() {
        return Ok(());
    }
    let missing = batch.asked - batch.answered.min(batch.asked);
    match batch.reads.into_iter().find_map(|read| read.values.err()) {
        Some(error) => Err(failure(error)),
        None => Err(Failure::with_help(
            LINK,
            format!("{missing} of {} reads got no answer", batch.asked),
            "see the counters: timeout (cable, power), crc (noise, baud rate), stale (late replies: a longer --timeout-ms)",
        )),
    }
}

fn text(result: &ReadResult) -> String {
    let mut text = String::new();
    for read in &result.reads {
        if let Some(error) = &read.error {
            let _ = writeln!(text, "{:>5}  error: {error}", read.address);
        }
        let lines = read.values.as_deref().unwrap_or_default().chunks(A_LINE);
        for (index, line) in lines.enumerate() {
            let decimal: Vec<String> = line.iter().map(|value| format!("{value:>5}")).collect();
            let hexadecimal: Vec<String> = line.iter().map(|v| format!("{v:04x}")).collect();
            let _ = writeln!(
                text,
                "{:>5}  {:<48} {}",
                usize::from(read.address) + index * A_LINE,
                decimal.join(" "),
                hexadecimal.join(" ")
            );
        }
    }
    let c = &result.counters;
    let r = &c.requests;
    if let (true, Some(rate_hz), Some(p50), Some(p99), Some(worst)) = (
        result.asked > result.reads.len() as u64,
        result.rate_hz,
        result.p50_us,
        result.p99_us,
        result.worst_us,
    ) {
        let _ = writeln!(
            text,
            "{} of {} reads answered, {rate_hz:.0} per second; round trip {p50:.0} us (median), {p99:.0} us (99 %), {worst:.0} us (worst)",
            result.answered, result.asked
        );
    }
    // What a probe that the line is in step was refused is no refusal of anything that was asked for.
    let is_clean = result.answered == result.asked
        && result.reads.iter().all(|read| read.error.is_none())
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

#[cfg(test)]
mod tests {
    use super::*;

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

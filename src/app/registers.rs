//! Raw registers: what a batch of reads brought, and a write that is shown before it is made, made once, and read back.
//!
//! Writing is guarded, because a register of a drive may start a motor.

use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use super::failure::Failure;
use super::output::{self, lines};
use drivebench_link::{
    Batch, LinkError, RawClient, RawCounters, ReadRequest, RegisterTable, WriteFunction,
    read_batch, registers,
};

/// What a link error means to someone who named the registers himself.
fn failure(error: LinkError) -> Failure {
    match error {
        LinkError::Exception { .. } => Failure::link(
            error.to_string(),
            "the unit has no such register, or not so many in one request; addresses count from 0 (40001 is 0)",
        ),
        LinkError::Gone { .. } => {
            let help = "the cable or the peer went away: check it, and ask again";
            Failure::link(error.to_string(), help)
        }
        other => other.into(),
    }
}

/// Values on one line of the text.
const A_LINE: usize = 8;

/// The result as JSON.
#[derive(Serialize)]
pub(crate) struct ReadResult {
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
    pub(crate) fn of(batch: &Batch, counters: RawCounters) -> Self {
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

    /// For a person: the registers, and the counters where not all went well.
    pub(crate) fn text(&self) -> String {
        let result = self;
        let mut text = String::new();
        for read in &result.reads {
            if let Some(error) = &read.error {
                let _ = writeln!(text, "{:>5}  error: {error}", read.address);
            }
            let lines = read.values.as_deref().unwrap_or_default().chunks(A_LINE);
            for (index, line) in lines.enumerate() {
                let decimal: Vec<String> = line.iter().map(|value| format!("{value:>5}")).collect();
                let hexadecimal: Vec<String> = line.iter().map(|v| format!("{v:04x}")).collect();
                let (decimal, hexadecimal) = (decimal.join(" "), hexadecimal.join(" "));
                let address = usize::from(read.address) + index * A_LINE;
                let _ = writeln!(text, "{address:>5}  {decimal:<48} {hexadecimal}");
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
}

/// Every read was answered, or the first that was not is the failure.
pub(crate) fn verdict(batch: Batch) -> Result<(), Failure> {
    if batch.is_all_answered() {
        return Ok(());
    }
    let missing = batch.asked - batch.answered.min(batch.asked);
    match batch.reads.into_iter().find_map(|read| read.values.err()) {
        Some(error) => Err(failure(error)),
        None => Err(Failure::link(
            format!("{missing} of {} reads got no answer", batch.asked),
            "see the counters: timeout (cable, power), crc (noise, baud rate), stale (late replies: a longer --timeout-ms)",
        )),
    }
}

/// The result as JSON.
#[derive(Serialize)]
pub(crate) struct WriteResult<'a> {
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

impl WriteResult<'_> {
    pub(crate) fn text(&self) -> String {
        let result = self;
        let mut text = String::new();
        let (what, address) = (registers(result.written.len()), result.address);
        let confirmed = if result.confirmed {
            "confirmed by reading back"
        } else {
            "NOT confirmed"
        };
        let _ = writeln!(text, "{what} at {address}: {confirmed}");
        let after = result.after.as_ref().filter(|_| !result.confirmed);
        lines(
            &mut text,
            "the unit holds ",
            after.map(|after| format!("{after:?}")),
        );
        text
    }
}

/// Shows what is there and what is to come, writes where `consent` lets it (told whether the unit is an emulator), and reads
/// back; the result, and what is wrong with it.
pub(crate) fn write_once<'a>(
    client: &mut RawClient,
    address: u16,
    values: &'a [u16],
    multiple: bool,
    consent: impl FnOnce(bool) -> Result<(), Failure>,
) -> Result<(WriteResult<'a>, Result<(), Failure>), Failure> {
    let count = u16::try_from(values.len()).unwrap_or(u16::MAX);
    let is_emulator = is_emulator(client)?;
    let before = read_back(client, address, count);
    if let Err(error @ (LinkError::Timeout { .. } | LinkError::Gone { .. })) = before {
        return Err(error.into());
    }
    let before = before.ok();
    announce(address, before.as_deref(), values);
    consent(is_emulator)?;
    let function = if values.len() > 1 || multiple {
        WriteFunction::Multiple
    } else {
        WriteFunction::Single
    };
    let written = client.write(function, address, values);
    // Whether it was acknowledged or not, what counts is what the unit holds.
    let after = read_back(client, address, count);
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
    let verdict = match (written, after) {
        (Err(error), _) | (Ok(()), Err(error)) => Err(failure(error)),
        (Ok(()), Ok(_)) if confirmed => Ok(()),
        (Ok(()), Ok(after)) => Err(Failure::link(
            format!("the unit acknowledged {values:?} at {address} and holds {after:?}"),
            "the register may be limited, clear itself, or be writable only in another state; see the drive's manual",
        )),
    };
    Ok((result, verdict))
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
    let read = reads.into_iter().next();
    read.map_or(Ok(Vec::new()), |read| read.values)
}

/// Told before anything is asked or done.
fn announce(address: u16, before: Option<&[u16]>, values: &[u16]) {
    for (index, value) in values.iter().enumerate() {
        let there = before.and_then(|before| before.get(index));
        let there = there.map_or("?".to_owned(), ToString::to_string);
        let address = usize::from(address) + index;
        output::message(&format!("{address:>5}  {there} -> {value} (0x{value:04x})"));
    }
}

//! The Modbus link: one exchange is one request of function code 23, which writes the command and reads the sample.
//!
//! ```text
//! exchange: gap, listen -> FC23 { sequence, control, set-point | 16 registers } -> only a reply that echoes the sequence
//! read:     gap, listen, [suspect? silence, probe], [looks like a recent one? silence] -> FC03 | 04
//! ```
//!
//! A command is its own proof: its sequence number comes back with the sample. The reply to a plain read says neither
//! what was read nor when: only function, unit and length. Two that look alike are kept apart by a silence in which
//! every copy of the earlier reply would have come.
//!
//! This file owns the clock of the exchanges.
//! bus.rs shows the link as registers, for drives with a map of their own.

mod bus;

use std::borrow::Cow;
use std::time::{Duration, Instant};

use firmware_protocol::registers::{
    COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS, IDENTITY_WORDS, SEQUENCE_ECHO,
    TELEMETRY_ADDRESS, TELEMETRY_WORDS,
};
use firmware_protocol::{DriveCommand, Telemetry};
use tokio::runtime::Runtime;
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Error, ExceptionCode, Request, Response, Slave};

use super::burst::Burst;
use super::clock_map::ClockMap;
use super::guard::{Guard, Leftover, LineCounts, Port, now};
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use super::raw::registers;
use super::reply::{Echo, FrameKind};
use super::tally::{RoundTrips, Tally};
use super::timeline::{Timeline, control, identity, identity_error, low_word};
use super::timing::{LineTiming, wait_until};
use crate::sample::{Command, Demand, DriveState, Sample};

pub use bus::ModbusBus;

/// Times that a question without effect is asked before it counts as failed.
const READ_ATTEMPTS: usize = 3;
/// Times that a stop is asked for.
const STOP_ATTEMPTS: usize = 5;
/// Probes of one resynchronisation.
const PROBES: usize = 6;
/// Commands that fail one after the other before the line is given time to fall silent: the first may have been bad luck.
const FAILURES_BEFORE_SILENCE: u32 = 2;
/// Where the sequence number stands in the PDU of the reply: behind function, length, and the registers before it.
const ECHO_AT: usize = 2 + 2 * (SEQUENCE_ECHO.address - TELEMETRY_ADDRESS) as usize;
/// A line that talks for so many times the silence that is waited for is given up.
const SILENCE_PATIENCE: u32 = 4;
/// RTU frames of a command and of its reply.
pub(super) const COMMAND_BYTES: usize = 13 + 2 * COMMAND_WORDS;
pub(super) const TELEMETRY_BYTES: usize = 5 + 2 * TELEMETRY_WORDS;

/// Which of the two register tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegisterTable {
    Holding,
    Input,
}

/// A drive behind Modbus RTU or TCP.
pub struct ModbusLink {
    name: String,
    // The order matters: what uses the runtime goes before it.
    context: Context,
    guard: Guard,
    runtime: Runtime,
    kind: FrameKind,
    unit: u8,
    timing: LineTiming,
    tally: Tally,
    timeline: Timeline,
    epoch: Instant,
    last_seq: u64,
    nonce: u16,
    /// Something came in that was not asked for, or did not come: what comes next may be old.
    suspect: bool,
    /// Distance of captured samples as the drive tells it, s; 0: it captures nothing.
    capture_period_s: f64,
    /// Lengths of the replies to the latest plain reads, and when those ended.
    recent: Vec<(usize, Instant)>,
    /// Commands without a sample since the last one that had one.
    failed_in_a_row: u32,
    gone: bool,
}

/// What an exchange gave, with the host times of its ends, s since the epoch.
struct Answer<T> {
    value: T,
    sent_s: f64,
    received_s: f64,
}

impl ModbusLink {
    /// A link over a port that was opened within `runtime`.
    pub(super) fn new(
        name: String,
        runtime: Runtime,
        port: Box<dyn Port>,
        kind: FrameKind,
        unit: u8,
        timing: LineTiming,
        epoch: Instant,
    ) -> Self {
        let guard = Guard::new(port, kind);
        let [.., high, low] = std::process::id().to_be_bytes();
        Self {
            context: attach(&guard, kind, unit),
            name,
            guard,
            runtime,
            kind,
            unit,
            timing,
            tally: Tally::default(),
            timeline: Timeline::default(),
            epoch,
            last_seq: 0,
            nonce: u16::from_be_bytes([high, low]),
            // A reply to whoever used the line before us may be under way.
            suspect: kind == FrameKind::Rtu,
            capture_period_s: 0.0,
            recent: Vec::new(),
            failed_in_a_row: 0,
            gone: false,
        }
    }

    /// Raw registers, 1 to 125 of them.
    pub fn read_registers(
        &mut self,
        table: RegisterTable,
        address: u16,
        count: u16,
    ) -> Result<Vec<u16>, LinkError> {
        let what = format!("read {} at {address}", registers(count.into()));
        let request = || match table {
            RegisterTable::Holding => Request::ReadHoldingRegisters(address, count),
            RegisterTable::Input => Request::ReadInputRegisters(address, count),
        };
        let words = usize::from(count);
        self.read_with_retries(
            &what,
            8,
            5 + 2 * words,
            request,
            |response| match response {
                Response::ReadHoldingRegisters(values) | Response::ReadInputRegisters(values)
                    if values.len() == words =>
                {
                    Ok(values)
                }
                other => Err(format!("{other:?}")),
            },
        )
        .map(|answer| answer.value)
    }

    /// Writes raw registers, 1 to 123 of them; never repeated by itself.
    pub fn write_registers(&mut self, address: u16, values: &[u16]) -> Result<(), LinkError> {
        let what = format!("write {} at {address}", registers(values.len()));
        let allowed = self.timing.allowed(9 + 2 * values.len(), 8);
        self.prove_fresh()?;
        let request = Request::WriteMultipleRegisters(address, Cow::Borrowed(values));
        self.call(request, &what, allowed, |response| match response {
            Response::WriteMultipleRegisters(..) => Ok(()),
            other => Err(format!("{other:?}")),
        })
        .map(|answer| answer.value)
    }

    /// One command on the wire. Only a reply that carries its number is its sample.
    fn command(&mut self, command: Command) -> Result<Sample, LinkError> {
        let seq = low_word(command.seq);
        self.guard.expect(Echo {
            at: ECHO_AT,
            bytes: seq.to_be_bytes(),
        });
        let words: [u16; COMMAND_WORDS] = DriveCommand {
            seq,
            control: control(command.demand),
        }
        .to_registers();
        self.last_seq = command.seq;
        let request = Request::ReadWriteMultipleRegisters(
            TELEMETRY_ADDRESS,
            quantity(TELEMETRY_WORDS),
            COMMAND_ADDRESS,
            Cow::Borrowed(&words),
        );
        let allowed = self.timing.allowed(COMMAND_BYTES, TELEMETRY_BYTES);
        let answer = self.call(request, "the command", allowed, |response| match response {
            Response::ReadWriteMultipleRegisters(values) => telemetry(&values),
            other => Err(format!("{other:?}")),
        });
        self.failed_in_a_row = match &answer {
            Ok(_) => 0,
            Err(_) => self.failed_in_a_row.saturating_add(1),
        };
        let Answer {
            value,
            sent_s,
            received_s,
        } = answer?;
        Ok(self
            .timeline
            .sample(&value, command.seq, sent_s, received_s))
    }

    /// Reads the drive's clock: raw, us, and on the time axis of the samples, s.
    fn note_clock(&mut self) -> Result<(u32, f64), LinkError> {
        let ask = || Request::ReadHoldingRegisters(TELEMETRY_ADDRESS, quantity(TELEMETRY_WORDS));
        let bytes = 5 + 2 * TELEMETRY_WORDS;
        let answer =
            self.read_with_retries("the telemetry", 8, bytes, ask, |response| match response {
                Response::ReadHoldingRegisters(values) => telemetry(&values),
                other => Err(format!("{other:?}")),
            })?;
        let time_us = answer.value.time_us;
        let time_s = self
            .timeline
            .note(time_us, answer.sent_s, answer.received_s);
        Ok((time_us, time_s))
    }

    /// A question without effect on the drive may be asked again.
    fn read_with_retries<T>(
        &mut self,
        what: &str,
        request_bytes: usize,
        reply_bytes: usize,
        request: impl Fn() -> Request<'static>,
        check: impl Fn(Response) -> Result<T, String>,
    ) -> Result<Answer<T>, LinkError> {
        let mut attempt = 1;
        loop {
            let allowed = self.timing.allowed(request_bytes, reply_bytes);
            let result = self
                .prove_fresh()
                .and_then(|()| self.keep_apart(reply_bytes))
                .and_then(|()| self.call(request(), what, allowed, &check));
            self.recent.push((reply_bytes, now()));
            match result {
                Err(error) if error.is_transient() && attempt < READ_ATTEMPTS => attempt += 1,
                result => return result,
            }
        }
    }

    /// Waits out the gap before a request and looks at what came meanwhile: nobody asked for it.
    fn listen(&mut self) -> Result<(), LinkError> {
        self.live()?;
        if self.kind == FrameKind::Rtu {
            wait_until(self.guard.last_activity() + self.timing.gap());
        }
        let strays = self.runtime.block_on(self.guard.begin());
        self.suspect |= strays.map_err(|error| self.lost(&error))? > 0;
        Ok(())
    }

    /// Waits until nothing of an earlier exchange can come any more.
    fn silence(&mut self) -> Result<(), LinkError> {
        let quiet = self.timing.quiet();
        let silence = self.guard.silence(quiet, now() + SILENCE_PATIENCE * quiet);
        match self.runtime.block_on(silence) {
            Ok(true) => Ok(()),
            Ok(false) => Err(LinkError::Corrupt {
                link: self.name.clone(),
                reason: "the line is never silent: something talks all the time".to_owned(),
            }),
            Err(error) => Err(self.lost(&error)),
        }
    }

    /// Makes sure that what comes next is not a reply to something older: silence for the longest turnaround, then a
    /// probe with a number of its own that the drive sends back (function code 08).
    fn prove_fresh(&mut self) -> Result<(), LinkError> {
        self.listen()?;
        if self.kind == FrameKind::Tcp {
            return Ok(());
        }
        let mut probes = 0;
        while self.suspect {
            self.silence()?;
            let result = self.probe();
            probes += 1;
            match result {
                // What came during the probe, or comes in the gap behind it, was not asked for either.
                Ok(()) => self.listen()?,
                Err(error) if !error.is_transient() || probes == PROBES => return Err(error),
                Err(_) => {}
            }
        }
        Ok(())
    }

    /// Keeps replies apart that look alike: waits until no copy of an earlier one can come any more.
    fn keep_apart(&mut self, reply_bytes: usize) -> Result<(), LinkError> {
        let quiet = self.timing.quiet();
        self.recent
            .retain(|(_, ended)| now().saturating_duration_since(*ended) < quiet);
        let alike = self.recent.iter().any(|(bytes, _)| *bytes == reply_bytes);
        if alike && self.kind == FrameKind::Rtu {
            self.silence()?;
        }
        Ok(())
    }

    /// One probe. The guard compares all its bytes.
    fn probe(&mut self) -> Result<(), LinkError> {
        self.nonce = self.nonce.wrapping_mul(25_173).wrapping_add(13_849);
        let [high, low] = self.nonce.to_be_bytes();
        let request = Request::Custom(8, Cow::Owned(vec![0, 0, high, low]));
        let allowed = self.timing.allowed(8, 8);
        self.listen()?;
        self.call(request, "the probe", allowed, |_| Ok(()))
            .map(drop)
    }

    /// One request and its reply, booked in the statistics; who calls has listened. `check` turns the reply into a
    /// value or says what is wrong with it.
    fn call<T>(
        &mut self,
        request: Request<'_>,
        what: &str,
        allowed: Duration,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>, LinkError> {
        // What came before the request has been judged.
        self.guard.take_anomaly();
        let sent = now();
        let deadline = sent + allowed;
        let reply = self.runtime.block_on(async {
            tokio::time::timeout_at(deadline.into(), self.context.call(request)).await
        });
        let received = now();
        let result = match reply {
            Ok(Ok(Ok(response))) => check(response).map_err(|reason| self.mismatch(reason)),
            Ok(Ok(Err(code))) => Err(self.exception(what, code)),
            Ok(Err(Error::Protocol(error))) => Err(self.mismatch(error.to_string())),
            Ok(Err(Error::Transport(error))) => Err(self.broken(&error)),
            Err(_) => Err(self.missing(what, allowed)),
        };
        // A reply that carries its own number ends every doubt about what came before it.
        self.suspect = self.guard.take_anomaly() || matches!(&result, Err(e) if e.is_transient());
        if result.is_err() && self.kind == FrameKind::Rtu {
            // A request that was cut off must not stay in the client's buffer. Over TCP the client keeps the
            // transaction number, and the guard drops replies to older ones.
            self.context = attach(&self.guard, self.kind, self.unit);
        }
        self.tally
            .settle(&result, received.duration_since(sent).as_secs_f64());
        result.map(|value| Answer {
            value,
            sent_s: self.host_s(sent),
            received_s: self.host_s(received),
        })
    }

    fn host_s(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.epoch).as_secs_f64()
    }

    fn live(&self) -> Result<(), LinkError> {
        if self.gone {
            return Err(LinkError::Gone {
                link: self.name.clone(),
                reason: "it broke before".to_owned(),
            });
        }
        Ok(())
    }

    fn lost(&mut self, error: &std::io::Error) -> LinkError {
        self.close();
        LinkError::Gone {
            link: self.name.clone(),
            reason: error.to_string(),
        }
    }

    fn broken(&mut self, error: &std::io::Error) -> LinkError {
        if error.kind() == std::io::ErrorKind::InvalidData {
            LinkError::Corrupt {
                link: self.name.clone(),
                reason: error.to_string(),
            }
        } else {
            self.lost(error)
        }
    }

    fn mismatch(&self, reason: String) -> LinkError {
        LinkError::Mismatch {
            link: self.name.clone(),
            reason,
        }
    }

    fn exception(&self, what: &str, code: ExceptionCode) -> LinkError {
        LinkError::Exception {
            link: self.name.clone(),
            request: what.to_owned(),
            code: code.into(),
            name: exception_name(code),
        }
    }

    /// No reply in time: what came instead tells the class.
    fn missing(&self, what: &str, allowed: Duration) -> LinkError {
        match self.guard.leftover() {
            Leftover::Nothing => LinkError::Timeout {
                link: self.name.clone(),
                deadline_ms: u64::try_from(allowed.as_millis()).unwrap_or(u64::MAX),
                request: what.to_owned(),
            },
            Leftover::Stale => LinkError::Stale {
                link: self.name.clone(),
                reason: format!("only late answers came after {what}"),
            },
            Leftover::Foreign => {
                self.mismatch(format!("only frames that do not answer {what} came"))
            }
            Leftover::Damaged(bytes) => LinkError::Corrupt {
                link: self.name.clone(),
                reason: format!("{bytes} bytes without a valid frame came in reply to {what}"),
            },
        }
    }
}

impl DriveLink for ModbusLink {
    fn name(&self) -> LinkName {
        LinkName(self.name.clone())
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        let block = self.read_registers(
            RegisterTable::Holding,
            IDENTITY_ADDRESS,
            quantity(IDENTITY_WORDS),
        )?;
        let block = block
            .as_slice()
            .try_into()
            .map_err(|_| self.mismatch(format!("{} registers of identity", block.len())))?;
        let block = firmware_protocol::Identity::from_registers(block)
            .map_err(|error| identity_error(&self.name, error))?;
        let mut identity = identity(&block);
        // Names are a comfort that a drive need not offer.
        let ask = || Request::ReadDeviceIdentification(ReadCode::Regular, 0);
        let names = self.read_with_retries("the device identification", 7, 256, ask, |response| {
            match response {
                Response::ReadDeviceIdentification(names) => Ok(names.device_id_objects),
                other => Err(format!("{other:?}")),
            }
        });
        match names {
            Ok(names) => {
                let text = |id| {
                    names
                        .value
                        .iter()
                        .find(|object| object.id == id)
                        .and_then(|object| object.value_as_str())
                };
                text(0).unwrap_or_default().clone_into(&mut identity.vendor);
                let product = text(4).or_else(|| text(1)).unwrap_or_default();
                product.clone_into(&mut identity.product);
                if let Some(revision) = text(2) {
                    revision.clone_into(&mut identity.firmware);
                }
            }
            Err(LinkError::Exception { .. }) => {}
            Err(error) => return Err(error),
        }
        self.capture_period_s = f64::from(block.capture_period_us) * 1e-6;
        // The origin of the time axis.
        self.note_clock()?;
        Ok(identity)
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        self.listen()?;
        let waits = self.failed_in_a_row >= FAILURES_BEFORE_SILENCE && self.kind == FrameKind::Rtu;
        // A stop goes out at once, also where the line is never silent.
        if waits && command.demand.energises() {
            self.silence()?;
        }
        self.command(command)
    }

    /// Goes out at once even on a suspect line: the echo of its own sequence number proves that it was applied.
    fn stop(&mut self) -> Result<(), LinkError> {
        let stop = Command {
            seq: self.last_seq.wrapping_add(1),
            demand: Demand::Stop,
        };
        let mut last = LinkError::Corrupt {
            link: self.name.clone(),
            reason: format!("the drive still runs after {STOP_ATTEMPTS} requests to stop"),
        };
        for _ in 0..STOP_ATTEMPTS {
            self.listen()?;
            match self.command(stop) {
                Ok(sample) if sample.state != Some(DriveState::Running) => return Ok(()),
                Ok(_) => {}
                Err(error @ LinkError::Gone { .. }) => return Err(error),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn close(&mut self) {
        self.gone = true;
        self.guard.close();
    }

    fn statistics(&self) -> LinkStatistics {
        self.tally.statistics
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        self.timing.shortest_cycle_s(COMMAND_BYTES, TELEMETRY_BYTES)
    }

    fn round_trips(&self) -> Option<&RoundTrips> {
        Some(&self.tally.round_trips)
    }

    fn line(&self) -> Option<LineCounts> {
        Some(self.guard.line())
    }

    fn burst(&mut self) -> Option<&mut dyn Burst> {
        (self.capture_period_s > 0.0).then_some(self as &mut dyn Burst)
    }

    fn clock_map(&self) -> Option<&ClockMap> {
        Some(&self.timeline.map)
    }
}

fn attach(guard: &Guard, kind: FrameKind, unit: u8) -> Context {
    match kind {
        FrameKind::Rtu => rtu::attach_slave(guard.clone(), Slave(unit)),
        FrameKind::Tcp => tcp::attach_slave(guard.clone(), Slave(unit)),
    }
}

fn telemetry(values: &[u16]) -> Result<Telemetry, String> {
    let block: &[u16; TELEMETRY_WORDS] = values
        .try_into()
        .map_err(|_| format!("it has {} registers, not {TELEMETRY_WORDS}", values.len()))?;
    Ok(Telemetry::from_registers(block))
}

/// A block of the register table as a quantity of a request.
fn quantity(words: usize) -> u16 {
    u16::try_from(words).expect("blocks of the register table fit a request")
}

const fn exception_name(code: ExceptionCode) -> &'static str {
    match code {
        ExceptionCode::IllegalFunction => "illegal function",
        ExceptionCode::IllegalDataAddress => "illegal data address",
        ExceptionCode::IllegalDataValue => "illegal data value",
        ExceptionCode::ServerDeviceFailure => "device failure",
        ExceptionCode::Acknowledge => "acknowledge: it takes long",
        ExceptionCode::ServerDeviceBusy => "device busy",
        ExceptionCode::MemoryParityError => "memory parity error",
        ExceptionCode::GatewayPathUnavailable => "gateway path unavailable",
        ExceptionCode::GatewayTargetDevice => "the gateway's device does not answer",
        ExceptionCode::Custom(_) => "a code of the maker",
    }
}

#[path = "modbus_burst.rs"]
mod burst;

#[cfg(test)]
#[path = "modbus_tests.rs"]
mod tests;

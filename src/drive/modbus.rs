//! The Modbus link: one exchange is one request of function code 23, which writes the command and reads the sample.
//!
//! ```text
//! exchange: [suspect? silence, probe] -> gap -> FC23 { sequence, control, set-point | 16 registers } -> echo = sequence?
//! ```
//!
//! This file owns the clock of the exchanges.
//! bus.rs shows the link as registers, for drives with a map of their own.

mod bus;

use std::borrow::Cow;
use std::time::{Duration, Instant};

use firmware_protocol::registers::{
    COMMAND_ADDRESS, COMMAND_WORDS, IDENTITY_ADDRESS, IDENTITY_WORDS, TELEMETRY_ADDRESS,
    TELEMETRY_WORDS,
};
use firmware_protocol::{DriveCommand, Telemetry};
use tokio::runtime::Runtime;
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Error, ExceptionCode, Request, Response, Slave};

use super::clock_map::ClockMap;
use super::guard::{Guard, Leftover, LineCounts, Port, now};
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use super::reply::FrameKind;
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
/// Bytes of an RTU frame beside its PDU.
const RTU_EXTRA: usize = 3;

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
        let what = format!("read {count} registers at {address}");
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
        let what = format!("write {} registers at {address}", values.len());
        let deadline = self.deadline(9 + 2 * values.len(), 8);
        self.prove_fresh(deadline)?;
        let request = Request::WriteMultipleRegisters(address, Cow::Borrowed(values));
        self.call(request, &what, deadline, |response| match response {
            Response::WriteMultipleRegisters(..) => Ok(()),
            other => Err(format!("{other:?}")),
        })
        .map(|answer| answer.value)
    }

    /// What the line carried beside replies.
    pub fn line(&self) -> LineCounts {
        self.guard.line()
    }

    fn deadline(&self, request_bytes: usize, reply_bytes: usize) -> Instant {
        let probe = if self.suspect && self.kind == FrameKind::Rtu {
            self.timing.quiet() + self.timing.allowed(8, 8)
        } else {
            Duration::ZERO
        };
        now() + probe + self.timing.allowed(request_bytes, reply_bytes)
    }

    /// One command on the wire. A wrong echo means that the sample is that of another command.
    fn command(&mut self, command: Command, deadline: Instant) -> Result<Sample, LinkError> {
        let seq = low_word(command.seq);
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
        let answer = self.call(request, "the command", deadline, |response| {
            let Response::ReadWriteMultipleRegisters(values) = response else {
                return Err(format!("{response:?}"));
            };
            let telemetry = telemetry(&values)?;
            if telemetry.seq == seq {
                Ok(telemetry)
            } else {
                Err(format!(
                    "it carries sequence number {}, the request had {seq}",
                    telemetry.seq
                ))
            }
        })?;
        let Answer {
            value,
            sent_s,
            received_s,
        } = answer;
        Ok(self
            .timeline
            .sample(&value, command.seq, sent_s, received_s))
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
            let deadline = self.deadline(request_bytes, reply_bytes);
            let result = self
                .prove_fresh(deadline)
                .and_then(|()| self.call(request(), what, deadline, &check));
            match result {
                Err(error) if error.is_transient() && attempt < READ_ATTEMPTS => attempt += 1,
                result => return result,
            }
        }
    }

    /// Makes sure that what comes next is not a reply to something older: silence for the longest turnaround, then a
    /// probe with a number of its own that the drive sends back (function code 08).
    fn prove_fresh(&mut self, deadline: Instant) -> Result<(), LinkError> {
        self.live()?;
        let strays = self.runtime.block_on(self.guard.begin());
        let strays = strays.map_err(|error| self.lost(&error))?;
        self.suspect |= strays > 0;
        if !self.suspect || self.kind == FrameKind::Tcp {
            return Ok(());
        }
        let silence = self.guard.silence(self.timing.quiet(), deadline);
        match self.runtime.block_on(silence) {
            Ok(true) => {}
            Ok(false) => {
                return Err(LinkError::Corrupt {
                    link: self.name.clone(),
                    reason: "the line is never silent: something talks all the time".to_owned(),
                });
            }
            Err(error) => return Err(self.lost(&error)),
        }
        let mut last = None;
        for _ in 0..PROBES {
            if now() >= deadline {
                break;
            }
            self.nonce = self.nonce.wrapping_mul(25_173).wrapping_add(13_849);
            let [high, low] = self.nonce.to_be_bytes();
            let request = Request::Custom(8, Cow::Owned(vec![0, 0, high, low]));
            let probe_deadline = deadline.min(now() + self.timing.allowed(8, 8));
            // The guard has compared all bytes.
            match self.call(request, "the probe", probe_deadline, |_| Ok(())) {
                Ok(_) => {
                    self.suspect = false;
                    return Ok(());
                }
                Err(error) if error.is_transient() => last = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(last.unwrap_or_else(|| self.timeout("the probe", deadline, now())))
    }

    /// One request and its reply, booked in the statistics. `check` turns the reply into a value or says what is
    /// wrong with it.
    fn call<T>(
        &mut self,
        request: Request<'_>,
        what: &str,
        deadline: Instant,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Answer<T>, LinkError> {
        self.live()?;
        let strays = self.runtime.block_on(self.guard.begin());
        let strays = strays.map_err(|error| self.lost(&error))?;
        self.suspect |= strays > 0;
        if self.kind == FrameKind::Rtu {
            wait_until(self.guard.last_activity() + self.timing.gap());
        }
        let sent = now();
        let reply = self.runtime.block_on(async {
            tokio::time::timeout_at(deadline.into(), self.context.call(request)).await
        });
        let received = now();
        let result = match reply {
            Ok(Ok(Ok(response))) => check(response).map_err(|reason| self.mismatch(reason)),
            Ok(Ok(Err(code))) => Err(self.exception(what, code)),
            Ok(Err(Error::Protocol(error))) => Err(self.mismatch(error.to_string())),
            Ok(Err(Error::Transport(error))) => Err(self.broken(&error)),
            Err(_) => Err(self.missing(what, deadline, sent)),
        };
        self.suspect |= self.guard.take_anomaly() || matches!(&result, Err(e) if e.is_transient());
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
        self.gone = true;
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
    fn missing(&self, what: &str, deadline: Instant, sent: Instant) -> LinkError {
        match self.guard.leftover() {
            Leftover::Nothing => self.timeout(what, deadline, sent),
            Leftover::Foreign => {
                self.mismatch(format!("only frames that do not answer {what} came"))
            }
            Leftover::Damaged(bytes) => LinkError::Corrupt {
                link: self.name.clone(),
                reason: format!("{bytes} bytes without a valid frame came in reply to {what}"),
            },
        }
    }

    fn timeout(&self, what: &str, deadline: Instant, sent: Instant) -> LinkError {
        let allowed = deadline.saturating_duration_since(sent).as_millis();
        LinkError::Timeout {
            link: self.name.clone(),
            deadline_ms: u64::try_from(allowed).unwrap_or(u64::MAX),
            request: what.to_owned(),
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
        // The origin of the time axis.
        let ask = || Request::ReadHoldingRegisters(TELEMETRY_ADDRESS, quantity(TELEMETRY_WORDS));
        let bytes = 5 + 2 * TELEMETRY_WORDS;
        let answer =
            self.read_with_retries("the telemetry", 8, bytes, ask, |response| match response {
                Response::ReadHoldingRegisters(values) => telemetry(&values),
                other => Err(format!("{other:?}")),
            })?;
        self.timeline
            .note(answer.value.time_us, answer.sent_s, answer.received_s);
        Ok(identity)
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        let request_bytes = 10 + 2 * COMMAND_WORDS + RTU_EXTRA;
        let deadline = self.deadline(request_bytes, 2 + 2 * TELEMETRY_WORDS + RTU_EXTRA);
        self.prove_fresh(deadline)?;
        self.command(command, deadline)
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
            let deadline = now() + self.timing.allowed(21, 37);
            match self.command(stop, deadline) {
                Ok(sample) if sample.state != Some(DriveState::Running) => return Ok(()),
                Ok(_) => {}
                Err(error @ LinkError::Gone { .. }) => return Err(error),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn statistics(&self) -> LinkStatistics {
        self.tally.statistics
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        self.timing.shortest_cycle_s(21, 37)
    }

    fn round_trips(&self) -> Option<&RoundTrips> {
        Some(&self.tally.round_trips)
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

#[cfg(test)]
#[path = "modbus_tests.rs"]
mod tests;

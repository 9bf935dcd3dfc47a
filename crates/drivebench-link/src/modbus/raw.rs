//! Modbus client for raw registers of any unit, for the register commands of the program.
//!
//! ```text
//! read_batch: reads, again and again -> values that are proven to be current
//! RawClient:  proof by trial (proof.rs), since no profile describes the unit
//! ```

#[cfg(test)]
mod tests;
mod written;

use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use tokio_modbus::prelude::ReadCode;
use tokio_modbus::{Request, Response};

use super::{Client, Question, identification};
use crate::cell_bus::{Put, ReadRequest, registers};
use crate::framing::{FrameKind, Turn};
use crate::link::{Identity, LinkError, LinkStatistics, Result};
use crate::open::{Target, open_line};
use crate::own::{IDENTITY, OwnLink};
use crate::proof::{Policy, Proof};
use crate::settings::{Framing, LinkSettings, Protocol};
use crate::tap::TapFile;
use crate::timeline::identity;
use crate::timing::wait_until;
use crate::transaction::LineCounts;
use crate::waiting::now;
use drivebench_model::numerics::count::whole;

pub use written::{WriteOutcome, Written};

/// Every request ends in exactly one class of the statistics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RawCounters {
    #[serde(flatten)]
    pub requests: LinkStatistics,
    /// Requests among `sent` that only proved that the line is in step.
    pub probes: u64,
    pub resynchronisations: u64,
    /// Reads among `sent` that were repeated because the unit was busy (exceptions 05 and 06).
    pub busy_repeats: u64,
    #[serde(flatten)]
    pub line: LineCounts,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriteFunction {
    /// Function code 6: one register.
    Single,
    /// Function code 16: any number.
    Multiple,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawSettings {
    /// Baud rate of a serial port for which the target names none.
    pub baud: u32,
    pub framing: Framing,
    /// Unit for which the target names none.
    pub unit: u8,
    /// Time for one exchange, from the request to the whole reply.
    pub timeout: Duration,
    /// Silence before a request; `None`: that of the standard for the baud rate.
    pub gap: Option<Duration>,
    /// Over a network: frames of RTU, as transparent converters carry them.
    pub rtu_over_tcp: bool,
}

impl RawSettings {
    fn link(&self) -> LinkSettings {
        let rtu = if self.rtu_over_tcp { Protocol::ModbusRtuOverTcp } else { Protocol::default() };
        LinkSettings {
            protocol: rtu,
            baud: self.baud,
            unit: self.unit,
            framing: self.framing,
            reply_ms: 0.0,
            gap_us: self.gap.map(|gap| gap.as_secs_f64() * 1e6),
            deadline_ms: Some(self.timeout.as_secs_f64() * 1e3),
            emulated: false,
        }
    }
}

/// A blocking Modbus client for raw registers.
pub struct RawClient {
    link: OwnLink<Client>,
    /// Settings of a serial line, for messages.
    at: String,
}

impl RawClient {
    /// Opens the port or connects; nothing is sent yet.
    ///
    /// # Errors
    /// [`LinkError::Open`], with what to do about it.
    pub fn open(target: &Target, settings: &RawSettings, tap: Option<&TapFile>) -> Result<Self> {
        // The kernel may put off the end of a sleep by 50 us to save wake-ups; where it refuses, gaps are a little longer.
        #[cfg(target_os = "linux")]
        let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
        let mut link = open_line(target, &settings.link(), now(), tap)?;
        let at = match (target, settings.gap) {
            (Target::Serial { baud, .. }, _) => {
                let baud = baud.unwrap_or(settings.baud);
                format!(" at {baud} {}", settings.framing.name())
            }
            (Target::Tcp { .. }, _) if settings.rtu_over_tcp => String::new(),
            (Target::Tcp { .. }, gap) => {
                // A network needs no silence; one that is set is kept.
                let gap_s = gap.unwrap_or_default().as_secs_f64();
                link.exchange.core.timing = link.exchange.core.timing.with_gap(gap_s);
                String::new()
            }
        };
        Ok(Self::over(link, settings.timeout, at))
    }

    fn over(mut link: OwnLink<Client>, timeout: Duration, at: String) -> Self {
        if link.exchange.kind == FrameKind::Rtu {
            // Silence after which an adapter has handed over all it had (the latency timer of FTDI is 16 ms).
            let quiet = Duration::from_millis(20).max(link.exchange.core.timing.gap());
            let quiet = quiet + link.exchange.core.timing.network_delay();
            link.exchange.proof = Proof::new(Policy::Trial(timeout), quiet, now());
        }
        let unit = link.language.unit;
        let mut client = Self { link, at };
        client.name_unit(unit);
        client
    }

    fn name_unit(&mut self, unit: u8) {
        self.link.exchange.addressee = format!(" of unit {unit}{}", self.at);
    }

    pub fn set_unit(&mut self, unit: u8) {
        self.link.language.unit = unit;
        self.link.language.attach(&self.link.exchange);
        self.name_unit(unit);
        self.link.exchange.proof.forget_unit();
    }

    pub fn counters(&self) -> RawCounters {
        RawCounters {
            requests: self.link.exchange.core.tally.statistics,
            probes: self.link.exchange.probes,
            resynchronisations: self.link.exchange.resynchronisations,
            busy_repeats: self.link.busy_repeats,
            line: self.link.exchange.filter.inner().reception.line,
        }
    }

    /// Time from the request to the whole reply, of the last exchange that got one.
    pub const fn last_round_trip(&self) -> Duration {
        self.link.exchange.last_round_trip
    }

    pub const fn has_answered(&self) -> bool {
        self.link.exchange.proof.has_answered
    }

    /// Reads registers, once; again for a while where the unit is busy. That the reply is not one to an equal earlier request is only proved by [`RawClient::verify`].
    pub fn read(&mut self, request: ReadRequest) -> Result<Vec<u16>> {
        let (what, allowed) = (request.text(), self.allowed());
        let read = |link: &mut OwnLink<Client>| link.turn(Turn::read(request), &what, allowed);
        let values = self.link.while_busy(read)?.value;
        self.link.exchange.proof.readable(request);
        Ok(values)
    }

    /// Writes registers, once without repetition: after an error it is unknown whether the write was applied.
    pub fn write(&mut self, function: WriteFunction, address: u16, values: &[u16]) -> Result<()> {
        let what = format!("write {} at {address}", registers(values.len()));
        let is_single = function == WriteFunction::Single && values.len() == 1;
        let put = Put { function: if is_single { 6 } else { 16 }, address, cells: values };
        let allowed = self.allowed();
        self.link.turn(Turn::write(put), &what, allowed).map(drop)
    }

    fn allowed(&self) -> Duration {
        self.link.exchange.core.timing.allowed(0, 0)
    }

    /// Whether every reply since the last proof answered its own request: true if a probe returned alone. After `false` the line is
    /// synchronised again.
    pub fn verify(&mut self) -> Result<bool> {
        if !self.has_answered() {
            return Ok(true);
        }
        let before = self.link.exchange.proof.anomalies;
        self.link.exchange.proof.doubt();
        self.link.in_step(&[])?;
        Ok(self.link.exchange.proof.anomalies == before)
    }

    /// Synchronises the line so that the reply to this request is unambiguous.
    fn prove_for(&mut self, request: ReadRequest) -> Result<()> {
        let proof = &mut self.link.exchange.proof;
        if proof.could_confuse(&request.pdu()) || !proof.is_proven {
            proof.doubt();
        }
        self.link.in_step(&request.pdu())
    }

    /// An accepted reply has become doubtful: it is counted as stale.
    const fn withdraw(&mut self) {
        self.link.exchange.core.tally.statistics.withdraw();
    }

    /// Identity of a unit with our register map; `None`: another unit, which counts as hardware.
    pub fn identify(&mut self) -> Result<Option<Identity>> {
        let mut block = self.read(IDENTITY);
        if block.is_ok() && !self.verify()? {
            self.withdraw();
            block = read_proven(self, IDENTITY);
        }
        let block = match block {
            Err(LinkError::Exception { .. }) => return Ok(None),
            block => block?,
        };
        let block = block.as_slice().try_into().map(firmware_protocol::Identity::from_registers);
        Ok(block.ok().and_then(Result::ok).map(|block| identity(&block)))
    }

    /// Vendor, product and revision as the unit gives them; empty where it does not.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only: a unit that has no names is no fault.
    pub fn names(&mut self) -> Result<Vec<String>> {
        self.texts(ReadCode::Basic, 0, "the device identification")
    }

    /// One object of the identification; `None` where the unit does not have it.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only.
    pub fn object(&mut self, object: u8) -> Result<Option<String>> {
        let what = "an object of the identification";
        Ok(self.texts(ReadCode::Specific, object, what)?.into_iter().next())
    }

    fn texts(&mut self, code: ReadCode, object: u8, what: &str) -> Result<Vec<String>> {
        let question = identification(code, object, what, self.allowed());
        let texts = |response| match response {
            Response::ReadDeviceIdentification(names) => {
                let values = names.device_id_objects.into_iter().map(|object| object.value);
                Ok(values.map(|value| String::from_utf8_lossy(&value).into_owned()).collect())
            }
            other => Err(format!("{other:?}")),
        };
        Ok(self.optional(question, texts)?.unwrap_or_default())
    }

    /// Whether the unit sends a number back; `None` where it has never answered anything.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only.
    pub fn sends_back(&mut self) -> Result<Option<bool>> {
        if !self.has_answered() {
            return Ok(None);
        }
        let data = [0, 0, 0x5A, 0xC3];
        let request = Request::Custom(8, Cow::Owned(data.to_vec()));
        let [a, b, c, d] = data;
        let allowed = self.allowed();
        let question = Question::plain(request, [8, a, b, c, d], "the diagnostic echo", allowed);
        Ok(Some(self.optional(question, |_| Ok(()))?.is_some()))
    }

    /// Reply to a request that not every unit supports.
    fn optional<T>(
        &mut self,
        question: Question<'_>,
        check: impl FnOnce(Response) -> Result<T, String>,
    ) -> Result<Option<T>> {
        if !self.has_answered() {
            return Ok(None);
        }
        match self.link.ask(question, check) {
            Ok(answer) => Ok(Some(answer.value)),
            Err(error @ LinkError::Gone { .. }) => Err(error),
            Err(LinkError::Exception { .. }) => Ok(None),
            Err(_) => {
                // Silence after which a server that took an unknown request for the start of another frame accepts requests again
                // (libmodbus: one second).
                wait_until(now() + Duration::from_millis(1200));
                Ok(None)
            }
        }
    }
}

#[derive(Debug)]
pub struct Read {
    pub request: ReadRequest,
    pub values: Result<Vec<u16>>,
}

#[derive(Debug, Default)]
pub struct Batch {
    /// The last round, in the order of the requests.
    pub reads: Vec<Read>,
    /// Reads that were answered, of all rounds; those that were repeated for safety are not among them.
    pub answered: u64,
    pub asked: u64,
    /// Time of all rounds without the proofs, s.
    pub elapsed_s: f64,
    /// Round trips of the answered reads, ascending.
    pub round_trips: Vec<Duration>,
    /// Raised flag: not all rounds were done.
    pub is_interrupted: bool,
}

impl Batch {
    pub fn rate_hz(&self) -> Option<f64> {
        (self.answered > 0 && self.elapsed_s > 0.0).then(|| self.answered as f64 / self.elapsed_s)
    }

    /// Quantile of the round trips, s.
    pub fn quantile_s(&self, share: f64) -> Option<f64> {
        let last = self.round_trips.len().checked_sub(1)?;
        let index = whole((share.clamp(0.0, 1.0) * last as f64).round());
        self.round_trips.get(index).map(Duration::as_secs_f64)
    }

    pub fn is_all_answered(&self) -> bool {
        self.answered == self.asked && self.reads.iter().all(|read| read.values.is_ok())
    }
}

/// Reads each request once a round. A round ends early when `stop` is raised or the port is gone.
///
/// RTU does not distinguish a late or repeated reply to an equal request from the right one. Therefore the last round has a proof
/// between reads whose replies could be exchanged and one at its end. Values that are not proved are read again one by one, each
/// after a proof of its own; or they end as errors.
pub fn read_batch(
    client: &mut RawClient,
    requests: &[ReadRequest],
    rounds: u64,
    stop: &AtomicBool,
) -> Batch {
    let mut batch = Batch::default();
    let mut round_trips = Vec::new();
    let begun = now();
    let mut proving = Duration::ZERO;
    let mut unambiguous = vec![false; requests.len()];
    for round in 0..rounds {
        let anomalies = client.link.exchange.proof.anomalies;
        let is_last = round + 1 == rounds;
        for (index, request) in requests.iter().enumerate() {
            if is_last && client.link.exchange.proof.could_confuse(&request.pdu()) {
                let before = now();
                // A line that cannot be synchronised fails in the read itself and in the proof at the end.
                let _ = client.verify();
                proving += now().duration_since(before);
            }
            let values = client.read(*request);
            unambiguous[index] = client.link.exchange.proof.is_unambiguous;
            batch.asked += 1;
            if let Err(gone @ LinkError::Gone { .. }) = &values {
                // No value of this round is proved, and the remaining requests are missing.
                let none =
                    |request: &ReadRequest| Read { request: *request, values: Err(gone.clone()) };
                batch.reads = requests.iter().map(none).collect();
                batch.asked = rounds * requests.len() as u64;
                batch.elapsed_s = elapsed_s(begun + proving);
                batch.round_trips = sorted(round_trips);
                return batch;
            }
            if values.is_ok() {
                batch.answered += 1;
                round_trips.push(client.last_round_trip());
            }
            let read = Read { request: *request, values };
            match batch.reads.get_mut(index) {
                Some(old) => *old = read,
                None => batch.reads.push(read),
            }
        }
        batch.is_interrupted = !is_last && stop.load(Ordering::Acquire);
        if is_last || batch.is_interrupted {
            batch.elapsed_s = elapsed_s(begun + proving);
            verify_round(client, &mut batch, &unambiguous, anomalies);
            break;
        }
    }
    batch.round_trips = sorted(round_trips);
    batch
}

fn elapsed_s(since: Instant) -> f64 {
    now().saturating_duration_since(since).as_secs_f64()
}

fn sorted(mut round_trips: Vec<Duration>) -> Vec<Duration> {
    round_trips.sort_unstable();
    round_trips
}

/// Proves that the replies of the round belong to their requests, or repeats the doubtful ones.
fn verify_round(client: &mut RawClient, batch: &mut Batch, unambiguous: &[bool], anomalies: u64) {
    let is_answer = |read: &Read| matches!(read.values, Ok(_) | Err(LinkError::Exception { .. }));
    let is_late = |read: &Read| matches!(read.values, Err(LinkError::Stale { .. }));
    let reads = || batch.reads.iter().zip(unambiguous);
    let has_late = reads().any(|(read, _)| is_late(read));
    let doubtful = reads().any(|(read, unambiguous)| is_answer(read) && !unambiguous);
    if doubtful && !has_late {
        let proof = client.verify();
        if matches!(proof, Ok(true)) && client.link.exchange.proof.anomalies == anomalies {
            return;
        }
    }
    for (read, unambiguous) in batch.reads.iter_mut().zip(unambiguous) {
        let asks = if is_answer(read) {
            !unambiguous
        } else {
            // A unit that answers one request late has answered this one as well.
            has_late && matches!(&read.values, Err(error) if error.is_transient())
        };
        if !asks {
            continue;
        }
        let was_answered = read.values.is_ok();
        if was_answered {
            client.withdraw();
        }
        read.values = read_proven(client, read.request);
        batch.answered += u64::from(!was_answered && read.values.is_ok());
    }
}

fn read_proven(client: &mut RawClient, request: ReadRequest) -> Result<Vec<u16>> {
    let mut last = None;
    // Times that doubtful values are read again, each between two proofs.
    for _ in 0..3 {
        let values = client.prove_for(request).and_then(|()| client.read(request));
        match &values {
            Ok(_) | Err(LinkError::Exception { .. })
                if client.link.exchange.proof.is_unambiguous =>
            {
                return values;
            }
            Ok(_) => client.withdraw(),
            Err(LinkError::Exception { .. }) => {}
            Err(error) if error.is_transient() => last = values.err(),
            Err(_) => return values,
        }
    }
    Err(last.unwrap_or_else(|| {
        LinkError::Corrupt(
            client.link.exchange.core.name.clone(),
            format!(
                "the reply for {} registers at {} cannot be vouched for: replies come out of step",
                request.count, request.address
            ),
        )
    }))
}

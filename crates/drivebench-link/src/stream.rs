//! The stream link: COBS frames with the number of their request, and the burst capture.
//!
//! A late answer carries the number of its own request, so no resynchronisation is needed: answers that do not fit are dropped.
//! This file owns the clock of its exchanges.

use std::io;
use std::time::{Duration, Instant};

use firmware_protocol::stream::{
    CaptureStatus, Decoder, ErrorCode, Frame, FrameError, MAX_FRAME, Message, encode,
};
use firmware_protocol::{CaptureControl, CaptureState, Telemetry};

use super::burst::{Burst, Capture};
use super::exceptions::Requested;
use super::link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics, Result, RoundTrips};
use super::link_core::{Answer, LinkCore, own_link, retried, stop_confirmed};
use super::port::{Closed, TimedPort};
use super::timeline::{identity, signed_difference};
use super::timing::LineTiming;
use super::transaction::{Leftover, LineCounts};
use super::unexpected::Unexpected;
use super::waiting::now;
use drivebench_model::sample::{Command, Sample};

/// Bytes of a command and of its telemetry, with COBS and delimiters.
pub(super) const COMMAND_BYTES: usize = 18;
pub(super) const TELEMETRY_BYTES: usize = 52;

pub struct StreamLink {
    core: LinkCore,
    port: Box<dyn TimedPort>,
    decoder: Decoder,
    /// Bytes in the decoder: those since the last delimiter, and when the first of them came.
    pending: u64,
    pending_since: Instant,
    line: LineCounts,
    /// Number of the last request that is no command.
    question: u16,
    /// The decoder of the drive may hold the rest of a broken frame: a delimiter is sent first.
    suspect: bool,
}

/// Value of an answer, with the drive time at which it was formed, us.
type Timed<T> = (T, u32);

/// What came that was no answer.
#[derive(Default)]
struct Wreckage {
    bytes: usize,
    stale: usize,
    foreign: usize,
}

impl Wreckage {
    /// The class that it makes of a missing answer.
    const fn leftover(&self) -> Leftover {
        match *self {
            Self { foreign: 1.., .. } => Leftover::Unexpected(Unexpected::Frame),
            Self { stale: 1.., .. } => Leftover::Stale,
            Self { bytes: 0, .. } => Leftover::Nothing,
            Self { bytes, .. } => Leftover::Damaged(bytes),
        }
    }
}

impl StreamLink {
    pub(super) fn new(
        name: String,
        port: Box<dyn TimedPort>,
        timing: LineTiming,
        epoch: Instant,
    ) -> Self {
        Self {
            core: LinkCore::new(name, timing, epoch),
            port,
            decoder: Decoder::new(),
            pending: 0,
            pending_since: now(),
            line: LineCounts::default(),
            question: 0,
            suspect: true,
        }
    }

    /// Telemetry without a command; does not restart the watchdog.
    pub(super) fn telemetry(&mut self) -> Result<Telemetry> {
        let question = Message::TelemetryRequest;
        let answer = self.read_with_retries(&question, "the telemetry", telemetry)?;
        Ok(answer.value.0)
    }

    /// A request without side effects may be repeated.
    fn read_with_retries<T>(
        &mut self,
        message: &Message,
        what: &str,
        check: impl Fn(&Message) -> Option<T>,
    ) -> Result<Answer<Timed<T>>> {
        retried(|| self.ask_numbered(message, what, &check))
    }

    fn ask_numbered<T>(
        &mut self,
        message: &Message,
        what: &str,
        check: impl Fn(&Message) -> Option<T>,
    ) -> Result<Answer<Timed<T>>> {
        self.question = self.question.wrapping_add(1);
        let allowed = self.core.timing.unhurried(COMMAND_BYTES, MAX_FRAME);
        self.ask(&Frame::ask(self.question, *message), what, allowed, check)
    }

    /// One request and its answer, counted in the statistics.
    fn ask<T>(
        &mut self,
        question: &Frame,
        what: &str,
        allowed: Duration,
        check: impl Fn(&Message) -> Option<T>,
    ) -> Result<Answer<Timed<T>>> {
        self.core.live()?;
        self.drop_leftovers()?;
        let sent = now();
        let deadline = self.core.bound.earlier(sent + allowed);
        let mut wreckage = Wreckage::default();
        let result = self
            .send(question, deadline)
            .map_err(|error| self.lost(&error))
            .and_then(|()| self.receive(question.seq, what, deadline, &mut wreckage, check))
            .and_then(|found| {
                let waited = deadline.saturating_duration_since(sent);
                found.ok_or_else(|| wreckage.leftover().error(&self.core.name, what, waited))
            });
        let received = now();
        self.suspect = matches!(&result, Err(error) if error.is_transient());
        let core = &mut self.core;
        let took_s = received.duration_since(sent).as_secs_f64();
        core.tally.settle(&result, took_s);
        result.map(|(value, answered)| Answer {
            value,
            span: core.span(sent, answered),
            complete_s: core.host_s(received),
        })
    }

    /// Drops what came too late. A frame whose delimiter was lost must not take the next one with it.
    fn drop_leftovers(&mut self) -> Result<()> {
        let mut bytes = [0; 512];
        // A line that sends faster than it is read must not block.
        for _ in 0..128 {
            match self.port.read_within(&mut bytes, Duration::ZERO) {
                Ok(0) => break,
                Ok(count) => {
                    let at = now();
                    for byte in &bytes[..count] {
                        if let Some((frame, length, _)) = self.take(*byte, at) {
                            self.line.bytes_dropped += length;
                            self.line.stale_frames += u64::from(frame.is_ok());
                        }
                    }
                }
                Err(error) => return Err(self.lost(&error)),
            }
        }
        self.line.bytes_dropped += std::mem::take(&mut self.pending);
        self.decoder = Decoder::new();
        Ok(())
    }

    /// Takes a byte; gives the frame that it ends, its length on the line, and when its first byte came.
    fn take(&mut self, byte: u8, at: Instant) -> Option<(Result<Frame, FrameError>, u64, Instant)> {
        self.line.bytes_received += 1;
        if self.pending == 0 {
            self.pending_since = at;
        }
        self.pending += 1;
        let frame = self.decoder.push(byte)?;
        Some((frame, std::mem::take(&mut self.pending), self.pending_since))
    }

    fn send(&mut self, question: &Frame, deadline: Instant) -> io::Result<()> {
        let delimiter: &[u8] = if self.suspect { &[0] } else { &[] };
        let bytes = [delimiter, &encode(question)].concat();
        let mut at = 0;
        // What does not get out in time ends as a timeout of the answer.
        while at < bytes.len() && now() < deadline {
            let left = deadline.saturating_duration_since(now());
            let count = self.port.write_within(&bytes[at..], left)?;
            self.line.bytes_sent += count as u64;
            at += count;
        }
        self.core.is_unsent = at < bytes.len();
        Ok(())
    }

    /// The answer, and when its first byte came; `None`: not in time.
    fn receive<T>(
        &mut self,
        seq: u16,
        what: &str,
        deadline: Instant,
        wreckage: &mut Wreckage,
        check: impl Fn(&Message) -> Option<T>,
    ) -> Result<Option<(Timed<T>, Instant)>> {
        let mut bytes = [0; 512];
        loop {
            let left = deadline.saturating_duration_since(now());
            if left.is_zero() {
                return Ok(None);
            }
            let count =
                self.port.read_within(&mut bytes, left).map_err(|error| self.lost(&error))?;
            wreckage.bytes += count;
            let mut answer = None;
            let at = now();
            for byte in &bytes[..count] {
                let Some((frame, length, first)) = self.take(*byte, at) else {
                    continue;
                };
                let before = self.line.bytes_accepted;
                match frame {
                    Ok(frame) if frame.seq == seq && answer.is_none() => {
                        if let Message::Error(refusal) = &frame.message {
                            self.line.bytes_accepted += length;
                            answer = Some(Err(self.refused(what, refusal.code)));
                        } else if let Some(value) = check(&frame.message) {
                            self.line.bytes_accepted += length;
                            answer = Some(Ok(((value, frame.time_us), first)));
                        } else {
                            self.line.foreign_frames += 1;
                            wreckage.foreign += 1;
                        }
                    }
                    Ok(_) => {
                        self.line.stale_frames += 1;
                        wreckage.stale += 1;
                    }
                    Err(FrameError::Version(found)) => {
                        answer.get_or_insert(Err(LinkError::Version {
                            link: self.core.name.clone(),
                            found: found.into(),
                            expected: firmware_protocol::PROTOCOL_VERSION,
                        }));
                    }
                    Err(_) => {}
                }
                if self.line.bytes_accepted == before {
                    self.line.bytes_dropped += length;
                }
            }
            if let Some(answer) = answer {
                return answer.map(Some);
            }
        }
    }

    fn refused(&self, what: &str, code: ErrorCode) -> LinkError {
        LinkError::Exception {
            link: self.core.name.clone(),
            request: what.to_owned(),
            code: code.code(),
            name: match code {
                ErrorCode::UnknownMessage => "unknown message",
                ErrorCode::BadPayload => "bad payload",
                ErrorCode::OutOfRange => "out of range",
                ErrorCode::NotSupported => "not supported",
                ErrorCode::DeviceFailure => "device failure",
            },
            requested: Requested::default(),
        }
    }

    fn lost(&mut self, error: &io::Error) -> LinkError {
        self.close();
        self.core.gone(error)
    }

    fn stop_once(&mut self, stop: Command) -> Result<Sample> {
        self.exchange(stop)
    }
}

fn telemetry(message: &Message) -> Option<Telemetry> {
    match message {
        Message::Telemetry(telemetry) => Some(*telemetry),
        _ => None,
    }
}

fn capture_status(message: &Message) -> Option<CaptureStatus> {
    match message {
        Message::CaptureStatus(status) => Some(*status),
        _ => None,
    }
}

impl DriveLink for StreamLink {
    own_link!(core);

    fn identify(&mut self) -> Result<Identity> {
        let answer =
            self.read_with_retries(&Message::Hello, "the identity", |message| match message {
                Message::Identity(identity) => Some(*identity),
                _ => None,
            })?;
        let (block, drive_us) = answer.value;
        self.core.timeline.note(drive_us, answer.span);
        self.core.capture_period_s = f64::from(block.capture_period_us) * 1e-6;
        Ok(identity(&block))
    }

    fn exchange(&mut self, command: Command) -> Result<Sample> {
        self.core.is_unsent = true;
        let question = Frame::command(self.core.command(command));
        let allowed = self.core.timing.allowed(COMMAND_BYTES, TELEMETRY_BYTES);
        let answer = self.ask(&question, "the command", allowed, telemetry)?;
        let answer =
            Answer { value: answer.value.0, span: answer.span, complete_s: answer.complete_s };
        Ok(self.core.sample(command, &answer))
    }

    fn close(&mut self) {
        self.core.gone = true;
        self.port = Box::new(Closed);
    }

    fn line(&self) -> Option<LineCounts> {
        Some(self.line)
    }
}

impl Burst for StreamLink {
    fn arm(&mut self) -> Result<()> {
        let question = Message::CaptureArm(CaptureControl::Arm);
        let answer = self.ask_numbered(&question, "start of a capture", capture_status);
        answer.map(drop)
    }

    fn fetch(&mut self) -> Result<Option<Capture>> {
        let question = Message::CaptureStatusRequest;
        let what = "the state of the capture";
        let answer = self.read_with_retries(&question, what, capture_status)?;
        let (status, drive_us) = answer.value;
        if status.state != CaptureState::Complete {
            return Ok(None);
        }
        let now_s = self.core.timeline.note(drive_us, answer.span);
        let age_us = signed_difference(drive_us, status.first_time_us);
        let first_s = now_s - f64::from(age_us) * 1e-6;
        let period_s = self.core.capture_period_s;
        let name = self.core.name.clone();
        let capture = Capture::collect(&name, first_s, period_s, status.count, |index| {
            let question = Message::CaptureRequest(index);
            let block =
                self.read_with_retries(&question, "captured samples", |message| match message {
                    Message::CaptureBlock(block)
                        if block.index == index && !block.samples().is_empty() =>
                    {
                        Some(block.samples().to_vec())
                    }
                    _ => None,
                })?;
            Ok(block.value.0)
        });
        capture.map(Some)
    }
}

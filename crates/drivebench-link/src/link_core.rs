//! State of a link: statistics, time axis, time bound of an exchange, confirmation of a stop.

use std::io;
use std::time::Instant;

use firmware_protocol::{DriveCommand, Telemetry};

use super::cell_bus::Span;
use super::link::{LinkError, Result, Tally};
use super::timeline::{self, Timeline};
use super::timing::LineTiming;
use super::transaction::Bound;
use super::waiting::now;
use drivebench_model::sample::{Command, Demand, DriveState, Sample};

/// Attempts of a request without side effects.
pub(super) const READ_ATTEMPTS: usize = 3;

pub(super) struct LinkCore {
    pub(super) name: String,
    pub(super) timing: LineTiming,
    pub(super) tally: Tally,
    pub(super) timeline: Timeline,
    pub(super) bound: Bound,
    /// Period of captured samples as reported by the drive, s; 0: no capture.
    pub(super) capture_period_s: f64,
    pub(super) gone: bool,
    /// The last command has not been sent.
    pub(super) is_unsent: bool,
    pub(super) epoch: Instant,
    last_seq: u64,
}

/// Value of an exchange with its host times, s since the epoch.
pub(super) struct Answer<T> {
    pub(super) value: T,
    pub(super) span: Span,
    pub(super) complete_s: f64,
}

impl LinkCore {
    pub(super) fn new(name: String, timing: LineTiming, epoch: Instant) -> Self {
        Self {
            name,
            timing,
            tally: Tally::default(),
            timeline: Timeline::default(),
            bound: Bound::default(),
            capture_period_s: 0.0,
            gone: false,
            is_unsent: false,
            epoch,
            last_seq: 0,
        }
    }

    pub(super) fn host_s(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.epoch).as_secs_f64()
    }

    pub(super) fn span(&self, asked: Instant, answered: Instant) -> Span {
        Span::new(self.host_s(asked), self.host_s(answered))
    }

    /// An error once the link is gone.
    pub(super) fn live(&self) -> Result<()> {
        if self.gone {
            return Err(LinkError::Gone(self.name.clone(), "it broke before".to_owned()));
        }
        Ok(())
    }

    pub(super) fn gone(&self, error: &io::Error) -> LinkError {
        LinkError::Gone(self.name.clone(), error.to_string())
    }

    pub(super) fn command(&mut self, command: Command) -> DriveCommand {
        self.last_seq = command.seq;
        timeline::command(command)
    }

    pub(super) fn sample(&mut self, command: Command, answer: &Answer<Telemetry>) -> Sample {
        let mut sample = self.timeline.sample(&answer.value, command.seq, answer.span);
        sample.host_time_s = Some(answer.complete_s);
        sample
    }

    pub(super) fn stop_command(&mut self) -> Command {
        self.bound.set(f64::INFINITY, now());
        Command { seq: self.last_seq.wrapping_add(1), demand: Demand::Stop }
    }
}

/// Repeats a request without side effects until it succeeds or fails otherwise than by a transient error.
pub(super) fn retried<T>(mut request: impl FnMut() -> Result<T>) -> Result<T> {
    let result = (1..READ_ATTEMPTS)
        .map(|_| request())
        .find(|result| !matches!(result, Err(error) if error.is_transient()));
    result.unwrap_or_else(request)
}

/// Requests a stop up to five times, until the reply to that very command reports that the drive does not run.
pub fn stop_confirmed(name: &str, mut request: impl FnMut() -> Result<Sample>) -> Result<()> {
    let attempts = 5;
    let unstopped = |what: &str| {
        let text = format!("the drive answers, and {what} after {attempts} requests to stop");
        LinkError::Unstopped(name.to_owned(), text)
    };
    let mut last = unstopped("has not confirmed anything");
    for _ in 0..attempts {
        match request() {
            Ok(sample) if sample.applied.is_some() && sample.state != Some(DriveState::Running) => {
                return Ok(());
            }
            Ok(sample) if sample.state == Some(DriveState::Running) => {
                last = unstopped("still runs");
            }
            Ok(_) => last = unstopped("does not confirm that it has stopped"),
            Err(error @ LinkError::Gone { .. }) => return Err(error),
            Err(error) => last = error,
        }
    }
    Err(last)
}

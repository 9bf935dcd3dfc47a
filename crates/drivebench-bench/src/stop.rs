//! Times of a stop: from the decision to the request on the line and to the drive's confirmation; and the rows of the record
//! before it. Times are arguments.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::session::Phase;
use super::trip::TripKind;
use drivebench_link::LinkError;

/// The stop of a run whose output was on. Times count from the decision that the output has to be zero: for a value beyond its
/// limit the end of the reply with it, for a silent link the end of the allowed silence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stop {
    pub cause: String,
    /// The trip that decided it; null: another cause.
    #[serde(default)]
    pub trip: Option<TripKind>,
    /// The decision, from the start of the run, s.
    #[serde(default)]
    pub at_s: Option<f64>,
    /// Duration of the ramp down, ms; null where the output was cut at once.
    pub ramp_ms: Option<f64>,
    /// Until the first request to stop was handed to the line, ms; null: none got out.
    pub sent_after_ms: Option<f64>,
    /// Until the drive reported that its output is off, ms; null: it never did.
    pub confirmed_after_ms: Option<f64>,
    /// Attempts to stop until then: those of the cycles, and the last one, in which the link itself repeats its request.
    pub attempts: u64,
    /// Last exception of the drive instead of its confirmation; null: none, or it was confirmed.
    pub last_refusal: Option<String>,
    /// Command silence after which the drive stops the motor by itself, s; null: not known, or waived.
    pub watchdog_s: Option<f64>,
}

impl Stop {
    pub fn short(&self) -> String {
        let at = self.at_s.map_or_else(String::new, |at_s| format!(" at {at_s:.2} s"));
        let cause = &self.cause;
        match self.confirmed_after_ms {
            Some(ms) => format!("stopped: {cause}{at}, zero confirmed after {ms:.0} ms"),
            None => format!("stop NOT confirmed: {cause}{at}"),
        }
    }

    pub fn sentence(&self) -> String {
        let after_ramp =
            self.ramp_ms.map_or_else(String::new, |ms| format!(" and a ramp of {ms:.0} ms"));
        let cause = format!("{}{after_ramp}", self.cause);
        let attempts = match self.attempts {
            1 => "1 attempt".to_owned(),
            count => format!("{count} attempts"),
        };
        let answer = self
            .last_refusal
            .as_ref()
            .map_or_else(String::new, |answer| format!("; last answer: {answer}"));
        let sent = self.sent_after_ms.map_or_else(
            || format!("after {cause} no request to stop got out"),
            |ms| format!("sent {ms:.1} ms after {cause}"),
        );
        match (self.confirmed_after_ms, self.watchdog_s) {
            (Some(ms), _) => format!("stop {sent}, confirmed after {ms:.1} ms ({attempts})"),
            (None, Some(watchdog_s)) => format!(
                "stop NOT confirmed by the drive: {sent}, {attempts}; without commands its watchdog stops the motor after {watchdog_s} s{answer}"
            ),
            (None, None) => format!(
                "stop NOT confirmed by the drive: {sent}, {attempts}; no watchdog is known to stop it: see that the shaft stands still{answer}"
            ),
        }
    }
}

/// The last two seconds of a run that tripped, and the rows after, as rows of its `samples.csv`: the first is row 1. On the
/// samples' time axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LastSeconds {
    /// Of the decision, s.
    pub time_s: f64,
    pub from_row: usize,
    pub to_row: usize,
}

#[derive(Debug, Default)]
pub(super) struct StopWatch {
    was_on: bool,
    began_s: Option<f64>,
    ramp_s: Option<f64>,
    decided_s: Option<f64>,
    cause: (&'static str, Option<TripKind>),
    sent_s: Option<f64>,
    confirmed_s: Option<f64>,
    attempts: u64,
    last_refusal: Option<String>,
    rows: usize,
    /// Times of the last rows until the decision.
    row_times_s: VecDeque<f64>,
    /// Time of the decision on the samples' axis, and row after which it came.
    decided_at: Option<(f64, usize)>,
}

impl StopWatch {
    /// The phase after a step of the session; `cause` of a decision to stop. `drive_minus_host_s`: offset of the samples' time
    /// axis.
    pub(super) fn phase(
        &mut self,
        now_s: f64,
        phase: Phase,
        drive_minus_host_s: f64,
        cause: impl FnOnce() -> (&'static str, Option<TripKind>),
    ) {
        self.was_on |= phase.is_energised();
        if !self.was_on {
            return;
        }
        if phase == Phase::Running {
            self.began_s.get_or_insert(now_s);
        }
        if phase == Phase::RampDown {
            self.ramp_s.get_or_insert(now_s);
        }
        if (phase == Phase::Stopping || phase.is_final()) && self.decided_s.is_none() {
            self.decided_s = Some(now_s);
            self.cause = cause();
            self.decided_at = Some((now_s + drive_minus_host_s, self.rows));
        }
    }

    /// A request to stop, and whether it got out.
    pub(super) fn requested(&mut self, at_s: f64, is_sent: bool) {
        if self.decided_s.is_some() && self.confirmed_s.is_none() {
            self.attempts += 1;
            if is_sent {
                self.sent_s.get_or_insert(at_s);
            }
        }
    }

    /// Answer to a request to stop: an exception is kept until another answer.
    pub(super) fn answered<T>(&mut self, answer: &Result<T, LinkError>) {
        match answer {
            Ok(_) => self.last_refusal = None,
            Err(LinkError::Exception { request, code, name, .. }) => {
                self.last_refusal = Some(format!("exception {code:#04x} {name} to {request}"));
            }
            Err(_) => {}
        }
    }

    pub(super) fn confirmed(&mut self, now_s: f64) {
        if self.decided_s.is_some() {
            self.confirmed_s.get_or_insert(now_s);
        }
    }

    pub(super) const fn withdraw(&mut self) {
        self.confirmed_s = None;
    }

    /// Rows of the record, as they are handed to it.
    pub(super) fn rows(&mut self, times_s: impl Iterator<Item = f64>) {
        for time_s in times_s {
            self.rows += 1;
            if self.decided_at.is_some() {
                continue;
            }
            self.row_times_s.push_back(time_s);
            while (self.row_times_s.front()).is_some_and(|first_s| time_s - first_s > 2.0) {
                self.row_times_s.pop_front();
            }
        }
    }

    /// `None`: the output was never on.
    pub(super) fn stop(&self, watchdog_s: Option<f64>) -> Option<Stop> {
        let decided_s = self.decided_s?;
        let after_ms = |at_s: f64| 1e3 * (at_s - decided_s).max(0.0);
        Some(Stop {
            cause: self.cause.0.to_owned(),
            trip: self.cause.1,
            at_s: self.began_s.map(|began_s| decided_s - began_s),
            ramp_ms: self.ramp_s.map(|ramp_s| 1e3 * (decided_s - ramp_s)),
            sent_after_ms: self.sent_s.map(after_ms),
            confirmed_after_ms: self.confirmed_s.map(after_ms),
            attempts: self.attempts,
            last_refusal: (self.last_refusal.clone()).filter(|_| self.confirmed_s.is_none()),
            watchdog_s,
        })
    }

    /// `None`: nothing was recorded until then.
    pub(super) fn last_seconds(&self) -> Option<LastSeconds> {
        let (time_s, row) = self.decided_at?;
        let from_row = row + 1 - self.row_times_s.len().min(row);
        (self.rows >= from_row && !self.row_times_s.is_empty()).then_some(LastSeconds {
            time_s,
            from_row,
            to_row: self.rows,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::has;
    use drivebench_link::Requested;

    #[test]
    fn a_stop_is_timed_from_its_decision() {
        let mut watch = StopWatch::default();
        assert_eq!(watch.stop(None), None);
        watch.phase(0.0, Phase::Running, 5.0, || ("nothing", None));
        for k in 0..500_u32 {
            watch.rows(std::iter::once(5.0 + 0.01 * f64::from(k)));
        }
        watch.phase(4.995, Phase::Stopping, 5.0, || ("over-current", Some(TripKind::OverCurrent)));
        // A later finding is not the cause.
        watch.phase(5.0, Phase::LinkLost, 5.0, || ("the loss of the link", None));
        watch.requested(4.996, false);
        watch.requested(5.005, true);
        watch.rows([10.01, 10.02].into_iter());
        watch.confirmed(5.020);
        watch.requested(5.1, true);
        let stop = watch.stop(Some(0.2)).unwrap();
        assert_eq!((stop.attempts, stop.trip), (2, Some(TripKind::OverCurrent)));
        assert_eq!(stop.short(), "stopped: over-current at 5.00 s, zero confirmed after 25 ms");
        assert_eq!(
            stop.sentence(),
            "stop sent 10.0 ms after over-current, confirmed after 25.0 ms (2 attempts)"
        );
        let last = watch.last_seconds().unwrap();
        assert_eq!((last.from_row, last.to_row), (300, 502));
        let busy = LinkError::Exception {
            link: "x".to_owned(),
            request: "the command".to_owned(),
            code: 6,
            name: "device busy",
            requested: Requested::default(),
        };
        watch.answered::<()>(&Err(busy));
        assert_eq!(watch.stop(None).unwrap().last_refusal, None);
        watch.withdraw();
        let stop = watch.stop(Some(0.2)).unwrap();
        has(stop.sentence(), "NOT confirmed");
        has(stop.sentence(), "0.2 s; last answer: exception 0x06 device busy to the command");
        has(stop.sentence(), "its watchdog stops the motor after 0.2 s");
    }

    #[test]
    fn the_ramp_counts_apart_and_an_unsent_request_is_named() {
        let mut watch = StopWatch::default();
        watch.phase(1.0, Phase::RampDown, 0.0, || ("nothing", None));
        watch.phase(1.5, Phase::Stopping, 0.0, || ("the end", None));
        watch.requested(1.5, false);
        let stop = watch.stop(None).unwrap();
        assert_eq!((stop.ramp_ms, stop.sent_after_ms), (Some(500.0), None));
        has(stop.sentence(), "after the end and a ramp of 500 ms no request");
        has(stop.sentence(), "no watchdog is known");
        assert_eq!(watch.last_seconds(), None);
    }
}

//! Reconnection after a run that lost its drive: open the link, compare the identity, and bring the drive to rest. Nothing
//! re-arms.
//!
//! ```text
//! run -> link lost -> [ pause -> open -> same identity? -> zero reference, stop -> confirmed? ] -> safe
//!                          ^--- no answer --------'             '-- another drive: nothing is written
//! ```
//!
//! The run stays lost; the results here are events after its last row.

use std::sync::mpsc::Receiver;

use serde::Serialize;

use super::clock::Clock;
use super::session::{Intent, Phase};
use super::snapshot::SnapshotCell;
use crate::recording::{Event, Record};
use drivebench_link::{DriveLink, Identity, LinkError, Reopening, another_drive};
use drivebench_model::sample::{Command, Demand, DriveState};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ReopenEnding {
    /// The same drive is back, and reports its output off.
    Stopped,
    /// The same drive is back and took the stop; it does not report whether its output is off.
    StopUnconfirmed,
    /// Another drive answers: nothing was written.
    AnotherDrive,
    /// The time was over.
    GivenUp,
    /// The user ended the search.
    Interrupted,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reopened {
    pub ending: ReopenEnding,
    pub attempts: u32,
    /// From the last valid reply of the run to the end of the search, s.
    pub downtime_s: f64,
    /// The last identity found.
    pub identity: Option<Identity>,
    /// The reported state after the stop.
    pub state: Option<&'static str>,
    pub text: String,
}

impl Reopened {
    /// Whether the drive is back and safe, so that a new run may be started by hand.
    pub const fn is_safe(&self) -> bool {
        matches!(self.ending, ReopenEnding::Stopped)
    }
}

/// The lost drive, the bench of its run, and the limits of the search.
pub struct LostDrive<'a> {
    pub clock: &'a mut dyn Clock,
    /// The run's, still open.
    pub recorder: &'a mut dyn Record,
    /// Stop requested; the request is not consumed.
    pub stopped: &'a dyn Fn() -> bool,
    pub intents: &'a Receiver<Intent>,
    pub snapshots: &'a SnapshotCell,
    pub link: &'a str,
    pub before: &'a Identity,
    pub end: RunEnd,
    /// Number of the last exchange.
    pub seq: u64,
    /// `None`: until the user ends it.
    pub limit_s: Option<f64>,
    /// Draws the jitter of the pauses.
    pub seed: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RunEnd {
    /// From host time to the samples' time axis, s.
    pub drive_minus_host_s: f64,
    /// Host time of the last valid reply, s.
    pub last_reply_s: f64,
}

type Open<'a> = &'a mut dyn FnMut() -> Result<Box<dyn DriveLink>, LinkError>;

/// Searches until the drive is found, the time is over or the user ends it; `open` opens the link anew. Returns the link only
/// of the same drive.
pub fn reopen(lost: LostDrive<'_>, open: Open<'_>) -> (Reopened, Option<Box<dyn DriveLink>>) {
    let reopening = Reopening::new(lost.clock.now_s(), lost.limit_s, lost.seed);
    Search { lost, reopening, last_reason: String::new(), identity: None }.search(open)
}

enum Attempt {
    /// Tried again.
    Failed(String),
    AnotherDrive(String),
    SameDrive(Box<dyn DriveLink>, Option<DriveState>),
}

struct Search<'a> {
    lost: LostDrive<'a>,
    reopening: Reopening,
    /// A repeated reason is reported once.
    last_reason: String,
    identity: Option<Identity>,
}

impl Search<'_> {
    fn search(&mut self, open: Open<'_>) -> (Reopened, Option<Box<dyn DriveLink>>) {
        let lost = self
            .event("link_lost")
            .with("link", self.lost.link)
            .with("watchdog_s", self.lost.before.watchdog_s)
            .with("reopens_for_s", self.lost.limit_s);
        self.lost.recorder.event(lost);
        loop {
            let Some(due_s) = self.reopening.due_s() else {
                let reason = match self.last_reason.as_str() {
                    "" => "there was no time for an attempt",
                    reason => reason,
                };
                let text = format!("given up: {reason}");
                return (self.end(ReopenEnding::GivenUp, None, &text), None);
            };
            if !self.wait_until(due_s) {
                let text = "the search for it was ended by hand";
                return (self.end(ReopenEnding::Interrupted, None, text), None);
            }
            let attempt = self.reopening.attempt();
            self.show(format!("link lost, reopening (attempt {attempt})…"), None, None);
            match self.attempt(open) {
                Attempt::Failed(reason) => {
                    if reason != self.last_reason {
                        let event = self
                            .event("reopen_failed")
                            .with("attempt", attempt)
                            .with("reason", reason.as_str());
                        self.lost.recorder.event(event);
                        self.last_reason = reason;
                    }
                    self.reopening.failed(self.lost.clock.now_s());
                }
                Attempt::AnotherDrive(reason) => {
                    let text = format!("identity mismatch: {reason}; nothing was written to it");
                    return (self.end(ReopenEnding::AnotherDrive, None, &text), None);
                }
                Attempt::SameDrive(link, state) => {
                    let confirms = link.confirms_stop();
                    let (ending, how) = if confirms {
                        (ReopenEnding::Stopped, "stop confirmed")
                    } else {
                        (
                            ReopenEnding::StopUnconfirmed,
                            "stop taken but not confirmed: this drive does not report whether its output is off, see that the shaft stands still",
                        )
                    };
                    let fault =
                        if state == Some(DriveState::Fault) { "; it is in fault" } else { "" };
                    let text = format!(
                        "the same drive is back, zero reference and stop sent, {how}; nothing is armed{fault}"
                    );
                    let state = state.filter(|_| confirms);
                    return (self.end(ending, state, &text), Some(link));
                }
            }
        }
    }

    fn attempt(&mut self, open: Open<'_>) -> Attempt {
        let mut link = match open() {
            Ok(link) => link,
            Err(error @ LinkError::Identity { .. }) => {
                return Attempt::AnotherDrive(error.to_string());
            }
            Err(error) => return Attempt::Failed(error.to_string()),
        };
        let identity = match link.recognise() {
            Ok(identity) => identity,
            Err(error @ (LinkError::Identity { .. } | LinkError::Version { .. })) => {
                return Attempt::AnotherDrive(error.to_string());
            }
            Err(error) => return Attempt::Failed(error.to_string()),
        };
        let difference = another_drive(self.lost.before, &identity);
        self.identity = Some(identity);
        if let Some(reason) = difference {
            return Attempt::AnotherDrive(reason);
        }
        if let Err(error) = link.bring_to_rest() {
            return Attempt::Failed(format!(
                "the drive is back, and was not brought to rest: {error}"
            ));
        }
        let seq = self.lost.seq.wrapping_add(1);
        match link.exchange(Command { seq, demand: Demand::Disable }) {
            Ok(sample) if sample.state == Some(DriveState::Running) => {
                Attempt::Failed("the drive is back, and reports that it runs".to_owned())
            }
            Ok(sample) => Attempt::SameDrive(link, sample.state),
            Err(error) => Attempt::Failed(error.to_string()),
        }
    }

    /// False: the user ends the search, which is noticed within 50 ms.
    fn wait_until(&mut self, due_s: f64) -> bool {
        loop {
            let leaves = |intent| matches!(intent, Intent::Stop | Intent::Quit);
            if (self.lost.stopped)() || self.lost.intents.try_iter().any(leaves) {
                return false;
            }
            let now_s = self.lost.clock.now_s();
            if now_s >= due_s {
                return true;
            }
            self.lost.clock.sleep_until_s(due_s.min(now_s + 0.05));
        }
    }

    fn end(&mut self, ending: ReopenEnding, state: Option<DriveState>, text: &str) -> Reopened {
        let downtime_s = (self.lost.clock.now_s() - self.lost.end.last_reply_s).max(0.0);
        let (link, attempts) = (self.lost.link, self.reopening.attempts());
        let reopened = Reopened {
            ending,
            attempts,
            downtime_s,
            identity: self.identity.take(),
            state: state.map(DriveState::name),
            text: format!("{link}: {text} ({attempts} attempts in {downtime_s:.1} s)"),
        };
        let mut event = self.event("reopened");
        if let Ok(serde_json::Value::Object(details)) = serde_json::to_value(&reopened) {
            event.details.extend(details);
        }
        self.lost.recorder.event(event);
        let is_safe = reopened.is_safe() && state != Some(DriveState::Fault);
        let phase = is_safe.then_some(Phase::Safe);
        self.show(reopened.text.clone(), phase, state);
        reopened
    }

    fn event(&self, kind: &str) -> Event {
        let now_s = self.lost.clock.now_s();
        let time_s = now_s + self.lost.end.drive_minus_host_s;
        Event::new(time_s, Some(self.lost.seq), kind).with("host_time_s", now_s)
    }

    /// The state before the loss is not shown any more.
    fn show(&self, text: String, phase: Option<Phase>, state: Option<DriveState>) {
        let mut snapshot = (*self.lost.snapshots.latest()).clone();
        snapshot.reopening = Some(text);
        snapshot.phase = phase.or(snapshot.phase);
        snapshot.drive_state = state;
        self.lost.snapshots.publish(snapshot);
    }
}

#[cfg(test)]
mod tests;

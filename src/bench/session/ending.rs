//! How a session ends: ramp down, stop until it is confirmed, say how it went.

use serde_json::json;

use super::{Action, Level, Notice, Outcome, Phase, STOP_SILENCE_S, Session, notice};
use crate::bench::guard::Trip;
use crate::drive::{CommandTimes, LinkError};

const TOLD_NOTHING: &str = "stop unconfirmed: the drive took it, and does not tell whether its output is off; see that the shaft stands still";

/// What the drive tells of its state, and how long that is waited for.
pub(super) struct DriveWord {
    /// Whether the drive tells that its output is off.
    pub(super) tells_stop: bool,
    /// Longest wait for its word that it has stopped, s.
    pub(super) stop_time_s: f64,
    /// When it was heard last, s.
    pub(super) heard_s: f64,
    /// It was seen to run, or does not tell whether it does.
    pub(super) has_run: bool,
    /// The session ended without its word that the output is off.
    pub(super) unconfirmed: bool,
}

impl Default for DriveWord {
    fn default() -> Self {
        Self {
            tells_stop: true,
            stop_time_s: CommandTimes::default().stop_s,
            heard_s: 0.0,
            has_run: false,
            unconfirmed: false,
        }
    }
}

impl Session {
    pub(super) fn end(&mut self, outcome: Outcome, now_s: f64, actions: &mut Vec<Action>) {
        self.ending = Some(outcome);
        self.ramp_since_s = now_s;
        self.guard.begin_stop(now_s);
        self.enter(Phase::RampDown, now_s, actions);
    }

    pub(super) fn trip(&mut self, now_s: f64, trip: &Trip, actions: &mut Vec<Action>) {
        let detail = json!({ "trip": trip });
        self.event(now_s, "trip", detail, actions);
        if self.phase.is_final() {
            return;
        }
        notice(actions, Level::Error, trip.reason.clone());
        // What made it stop is the reason, not what else is found while it stops.
        let has_reason = matches!(self.ending, Some(Outcome::LinkLost { .. }));
        if self.phase != Phase::Stopping || !has_reason {
            self.ending = Some(if trip.kind.is_link() {
                Outcome::LinkLost {
                    reason: trip.reason.clone(),
                }
            } else {
                Outcome::Tripped(trip.clone())
            });
        }
        self.stop_now(now_s, actions);
    }

    pub(super) fn stop_now(&mut self, now_s: f64, actions: &mut Vec<Action>) {
        self.stopping_since_s = now_s;
        if self.ramp_since_s <= self.started_s.unwrap_or(now_s) {
            self.ramp_since_s = now_s;
        }
        self.enter(Phase::Stopping, now_s, actions);
    }

    pub(super) fn finish_if_late(&mut self, now_s: f64, actions: &mut Vec<Action>) {
        let waited_s = now_s - self.stopping_since_s;
        let silent_s = now_s - self.word.heard_s;
        if waited_s > self.word.stop_time_s || waited_s.min(silent_s) > STOP_SILENCE_S {
            self.finish(false, now_s, actions);
        }
    }

    pub(super) fn finish(&mut self, confirmed: bool, now_s: f64, actions: &mut Vec<Action>) {
        let mut outcome = self.ending.take().unwrap_or(Outcome::Stopped);
        if !confirmed && outcome == Outcome::Done {
            outcome = Outcome::LinkLost {
                reason: "the drive did not confirm that its output is off".to_owned(),
            };
        }
        let phase = match &outcome {
            Outcome::Done => Phase::Done,
            Outcome::Stopped | Outcome::Interrupted | Outcome::NotStarted { .. } => Phase::Stopped,
            Outcome::Tripped(_) => Phase::Tripped,
            Outcome::LinkLost { .. } => Phase::LinkLost,
        };
        self.word.unconfirmed = !confirmed;
        if confirmed && !self.word.tells_stop {
            notice(actions, Level::Warning, TOLD_NOTHING.to_owned());
        }
        self.enter(phase, now_s, actions);
        self.event(
            now_s,
            "finished",
            json!({ "outcome": outcome.name(), "stop_confirmed": confirmed && self.word.tells_stop }),
            actions,
        );
        actions.push(Action::Finished(outcome));
    }

    /// What is to be said after the link's own last stop, and how that failed, where the session ended without the drive's
    /// word.
    pub fn last_word(&self, failed: Option<&LinkError>) -> Option<Notice> {
        if !self.word.unconfirmed {
            return None;
        }
        let (level, text) = match failed {
            None if self.word.tells_stop => (
                Level::Warning,
                "the drive confirmed its stop only when it was told once more, after the run"
                    .to_owned(),
            ),
            None => (Level::Warning, TOLD_NOTHING.to_owned()),
            // It answers, or was not seen to run: no watchdog has acted.
            Some(error @ (LinkError::Refused { .. } | LinkError::Sequence { .. })) => (
                Level::Error,
                format!("stop NOT confirmed by the drive: {error}; see that the shaft stands still"),
            ),
            Some(_) if !self.word.has_run => (
                Level::Error,
                "stop NOT confirmed by the drive, which was not seen to run; see that the shaft stands still"
                    .to_owned(),
            ),
            Some(_) => (
                Level::Error,
                "stop NOT confirmed by the drive: its watchdog must have stopped the motor"
                    .to_owned(),
            ),
        };
        Some(Notice { level, text })
    }
}

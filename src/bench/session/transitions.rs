//! How a session changes its phase: what a person asks for, the order of a brake, ramp down, a stop until it is confirmed,
//! and how it went.

use serde_json::json;

use super::{Action, Intent, Level, Notice, Outcome, Phase, STOP_SILENCE_S, Session, notice};
use crate::bench::bench_file::Brake;
use crate::bench::guard::Trip;
use crate::drive::{CommandTimes, LinkError};
use crate::sample::{Channel, DriveState};

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

/// The order of a brake that holds a load: torque, then release; rest, then the brake, then the output off.
///
/// The drive works the brake (or a relay on its "running" output): no register of ours does. What the session can keep is
/// the order and the times: it holds the load by torque while the brake opens, and again until it has closed. After a trip
/// the drive's own stop acts, and with it its brake.
#[derive(Clone, Copy, Debug)]
pub(super) struct BrakeOrder {
    brake: Brake,
    /// Since when the drive runs with the holding torque, s.
    held_since_s: Option<f64>,
    /// Since when the shaft rests under it at the end, s.
    resting_since_s: Option<f64>,
}

impl BrakeOrder {
    pub(super) const fn new(brake: Brake) -> Self {
        Self {
            brake,
            held_since_s: None,
            resting_since_s: None,
        }
    }
}

impl Session {
    pub(super) fn intent(&mut self, now_s: f64, intent: &Intent, actions: &mut Vec<Action>) {
        let detail = match intent {
            Intent::Mark(text) => json!({ "intent": intent.name(), "text": text }),
            _ => json!({ "intent": intent.name() }),
        };
        self.event(now_s, "intent", detail, actions);
        let refused = match intent {
            Intent::Arm => self.arm(now_s, actions),
            Intent::Start => {
                let result = if self.phase == Phase::Safe {
                    self.arm(now_s, actions)
                } else {
                    Ok(())
                };
                let is_armed = self.phase == Phase::Armed;
                self.start_wanted |= is_armed;
                let refused = || format!("cannot start: the session is {}", self.phase.name());
                result.and(is_armed.then_some(()).ok_or_else(refused))
            }
            Intent::Stop => {
                self.stop(now_s, Outcome::Stopped, actions);
                Ok(())
            }
            Intent::Quit => {
                self.stop(now_s, Outcome::Interrupted, actions);
                Ok(())
            }
            Intent::ResetFault if self.phase.is_energised() => {
                Err("a fault is reset only with the output off".to_owned())
            }
            Intent::ResetFault => {
                self.reset_wanted = true;
                Ok(())
            }
            Intent::Rearm => self.rearm(now_s, actions),
            Intent::Mark(_) => Ok(()),
        };
        if let Err(reason) = refused {
            self.event(
                now_s,
                "refused",
                json!({ "intent": intent.name(), "reason": reason }),
                actions,
            );
            notice(actions, Level::Warning, reason);
        }
    }

    /// Output on at zero, if motor and drive are at rest and what is limited can be watched.
    fn arm(&mut self, now_s: f64, actions: &mut Vec<Action>) -> Result<(), String> {
        if self.phase != Phase::Safe {
            return Err(format!("cannot arm: the session is {}", self.phase.name()));
        }
        let sample = self
            .drive
            .as_ref()
            .ok_or("cannot arm: no valid sample yet")?;
        if let Some(hindrance) = sample.hindrance {
            return Err(format!("cannot arm: {}", hindrance.sentence()));
        }
        self.guard
            .check_rest(sample)
            .map_err(|error| format!("cannot arm: {error}"))?;
        let needs_angle = self.guard.limits().travel_rad.is_some();
        for (channel, needed) in [
            (Channel::Current, true),
            (Channel::Speed, true),
            (Channel::Angle, needs_angle),
        ] {
            if needed && !self.guard.has_seen(channel) {
                return Err(format!(
                    "cannot arm: the drive gives no {}, so its limit cannot be watched",
                    channel.name()
                ));
            }
        }
        self.guard.begin(now_s, sample);
        self.enter(Phase::Armed, now_s, actions);
        Ok(())
    }

    /// From an ended session back to safe, explicitly; the ended run stays ended.
    fn rearm(&mut self, now_s: f64, actions: &mut Vec<Action>) -> Result<(), String> {
        if !self.phase.is_final() {
            return Err(format!(
                "nothing to re-arm: the session is {}",
                self.phase.name()
            ));
        }
        self.guard
            .rearm(now_s, self.drive.as_ref())
            .map_err(|error| format!("cannot re-arm: {error}"))?;
        self.start_wanted = false;
        self.started_s = None;
        self.segment = None;
        self.ending = None;
        self.enter(Phase::Safe, now_s, actions);
        Ok(())
    }

    /// First request: ramp down. Second request: zero output at once.
    fn stop(&mut self, now_s: f64, outcome: Outcome, actions: &mut Vec<Action>) {
        match self.phase {
            Phase::Connecting | Phase::Safe | Phase::RampDown => {
                self.ending = Some(outcome);
                self.stop_now(now_s, actions);
            }
            Phase::Armed | Phase::Running => self.end(outcome, now_s, actions),
            // The program is over and the output going to zero: whoever asks to stop now must not see a next run begin.
            Phase::Stopping if matches!(self.ending, Some(Outcome::Done)) => {
                self.ending = Some(outcome);
            }
            _ => {}
        }
    }

    /// Whether the load may move: the drive has held it for as long as the brake takes to open.
    pub(super) fn is_brake_open(&mut self, now_s: f64, actions: &mut Vec<Action>) -> bool {
        let runs = self.drive_state() != Some(DriveState::Disabled) && !self.shaping.any();
        let Some(order) = self.brake.as_mut() else {
            return true;
        };
        order.resting_since_s = None;
        if !runs {
            order.held_since_s = None;
            return false;
        }
        let begins = order.held_since_s.is_none();
        let since_s = *order.held_since_s.get_or_insert(now_s);
        let release_s = order.brake.release_s;
        let open = now_s - since_s >= release_s;
        if begins {
            let detail = json!({ "brake": "releases", "seconds": release_s });
            self.event(now_s, "brake", detail, actions);
        }
        open
    }

    /// Whether the output may go off: the shaft has rested for as long as the brake takes to close.
    pub(super) fn is_brake_shut(&mut self, now_s: f64, actions: &mut Vec<Action>) -> bool {
        let Some(order) = self.brake.as_mut() else {
            return true;
        };
        order.held_since_s = None;
        let begins = order.resting_since_s.is_none();
        let since_s = *order.resting_since_s.get_or_insert(now_s);
        let apply_s = order.brake.apply_s;
        if begins {
            let detail = json!({ "brake": "applies", "seconds": apply_s });
            self.event(now_s, "brake", detail, actions);
        }
        now_s - since_s >= apply_s
    }

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

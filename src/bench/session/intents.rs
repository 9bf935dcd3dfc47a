//! What a session does when it is asked for something.

use serde_json::json;

use super::{Action, Intent, Level, Outcome, Phase, Session, notice};
use crate::sample::Channel;

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
                if self.phase == Phase::Armed {
                    self.start_wanted = true;
                    result
                } else {
                    result.and(Err(format!(
                        "cannot start: the session is {}",
                        self.phase.name()
                    )))
                }
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
}

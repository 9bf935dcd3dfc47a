//! Whether the drive's own watchdog works: the host stops talking on purpose.

use super::still::Still;
use super::{Checker, Reached};
use crate::bench::limits::Limits;
use crate::drive::LinkError;
use crate::sample::{Demand, DriveState};

/// Longest watchdog that is accepted, s (LINKS.md 5.2).
pub(in crate::bench) const LONGEST_WATCHDOG_S: f64 = 1.0;
/// Silence of the proof, in watchdog times.
const SILENCE_IN_WATCHDOGS: f64 = 1.5;
/// The shaft is seen to stand at zero for so long, and so many cycles, before nobody looks at it, s.
const STANDS_S: f64 = 0.1;
const STANDS_CYCLES: f64 = 3.0;

const WATCHDOG: &str = "watchdog";

pub(super) const AT_ZERO_HELP: &str = "the drive was stopped at once: check the set-points' address, scale and word order, and what the profile's enable command writes; an output with an offset does this too";

impl Checker<'_> {
    /// Enables at zero, stops talking on purpose, and wants to hear that the drive gave up by itself.
    pub(super) fn watchdog(&mut self, limits: &Limits, waived: bool) -> Result<bool, LinkError> {
        const HELP: &str = "set the drive's command watchdog to 1 s or less (watchdog.set_ms of its profile), or waive it explicitly (--waive-watchdog)";
        let Some(watchdog_s) = self.report.identity.watchdog_s else {
            let text = "the drive tells of no watchdog".to_owned();
            return Ok(self.note_or_waive(WATCHDOG, false, waived, text, HELP));
        };
        if !(watchdog_s > 0.0 && watchdog_s <= LONGEST_WATCHDOG_S) {
            let text = format!("{watchdog_s} s, at most {LONGEST_WATCHDOG_S} s is allowed");
            return Ok(self.note_or_waive(WATCHDOG, false, waived, text, HELP));
        }
        let mut still = self.still(limits);
        match self.runs_at_zero(&mut still)? {
            Reached::Yes => {}
            Reached::Never => {
                let waited_s = self.times().enable_s;
                let text = format!("the drive does not run at zero within {waited_s:.2} s");
                return Ok(self.note(WATCHDOG, false, text, "check the drive's enable input"));
            }
            Reached::Moved(text) => return Ok(self.moved_at_zero("", &text)),
        }
        let silence_s = SILENCE_IN_WATCHDOGS * watchdog_s + self.period_s;
        let quiet_from_s = self.clock.now_s();
        self.clock.sleep_until_s(quiet_from_s + silence_s);
        let after = self.answer(Demand::Disable)?;
        if let Some(text) = still.moved(&after) {
            let when = format!(", seen after {silence_s:.3} s of silence");
            return Ok(self.moved_at_zero(&when, &text));
        }
        let tripped = after.state == Some(DriveState::Fault) || after.fault.is_some();
        let text = format!(
            "set to {watchdog_s} s; after {silence_s:.3} s of silence at zero the drive was in {}{}",
            after.state.map_or("no known state", DriveState::name),
            after
                .fault
                .filter(|code| *code != 0)
                .map_or_else(String::new, |code| format!(", code {code:#06x}"))
        );
        if tripped {
            self.report.watchdog_proven_s = Some(silence_s);
            let cleared = |state| state != DriveState::Fault;
            match self.until_still(Demand::ResetFault, &mut still, cleared)? {
                Reached::Yes => {}
                Reached::Never => {
                    let waited_s = self.times().reset_s;
                    let text = format!("{text}; it does not reset within {waited_s:.2} s");
                    return Ok(self.note(WATCHDOG, false, text, "reset the drive by hand"));
                }
                Reached::Moved(text) => return Ok(self.moved_at_zero(" with the reset", &text)),
            }
        }
        Ok(self.note_or_waive(WATCHDOG, tripped, waived, text, HELP))
    }

    /// Enables at zero, and looks for a while whether the shaft stands there.
    fn runs_at_zero(&mut self, still: &mut Still) -> Result<Reached, LinkError> {
        let zero = self.zero;
        let runs = |state| state == DriveState::Running;
        let reached = self.until_still(zero, still, runs)?;
        if !matches!(reached, Reached::Yes) {
            return Ok(reached);
        }
        let begin_s = self.clock.now_s();
        let end_s = begin_s + STANDS_S.max(STANDS_CYCLES * self.period_s);
        while self.clock.now_s() < end_s {
            let next_s = self.clock.now_s() + self.period_s;
            self.clock.sleep_until_s(next_s);
            match self.exchange(zero) {
                Ok(sample) => {
                    if let Some(text) = still.moved(&sample) {
                        return Ok(Reached::Moved(text));
                    }
                }
                Err(error) if error.is_transient() => {}
                Err(error) => return Err(error),
            }
        }
        Ok(Reached::Yes)
    }

    /// Whoever asked for the checks stops the drive with the next request; this is no matter of waivers.
    fn moved_at_zero(&mut self, when: &str, what: &str) -> bool {
        let text = format!("the shaft moved at zero reference{when}: {what}");
        self.note(WATCHDOG, false, text, AT_ZERO_HELP)
    }
}

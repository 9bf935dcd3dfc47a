//! State machine of a command of the profile: write, wait for a status, delay; and of a stop, in which every write is sent at once
//! whatever the result of the others. [`Sequence`] is pure: its inputs are time and status.
//!
//! ```text
//! stop:     write -> write -> wait -> write   each write goes out although the one before was refused or not acknowledged;
//!                                             what was not acknowledged goes out again with the next exchange
//! in fault: write -> write -> write           no waits: the output is off, and the control words must be cleared
//! ```

use super::ProfiledLink;
use crate::cell_bus::CellBus;
use crate::link::{DriveLink as _, LinkError, Result};
use crate::polling_backoff::is_busy;
use crate::register_map::{Step, Write};

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Next {
    /// Write this and confirm it with [`Sequence::go_on`].
    Write(Write),
    Wait,
    Done,
    Failed {
        step: usize,
        reason: String,
    },
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sequence {
    pub(super) command: &'static str,
    steps: Vec<Step>,
    /// Steps in front of those of the profile; they have no number.
    before: usize,
    at: usize,
    since_s: f64,
    /// The first step whose write went out and was not acknowledged.
    unacknowledged: Option<usize>,
    /// What the drive refused first, in words, and since when, s.
    refused: Option<(String, f64)>,
    /// A write was refused for good.
    pub(super) is_denied: bool,
}

impl Sequence {
    pub(super) fn new(command: &'static str, steps: &[Step], now_s: f64) -> Self {
        Self {
            command,
            steps: steps.to_vec(),
            before: 0,
            at: 0,
            since_s: now_s,
            unacknowledged: None,
            refused: None,
            is_denied: false,
        }
    }

    /// The same with steps of the program's own in front.
    pub(super) fn preceded(mut self, first: Vec<Step>) -> Self {
        self.before = first.len();
        self.steps.splice(0..0, first);
        self
    }

    /// Steps as the profile counts them.
    pub(super) fn steps(&self) -> usize {
        self.steps.len() - self.before
    }

    /// `status` gives the bits of a signal and the time at which they were read, s: a reading from before the step is not used.
    pub(super) fn next(&mut self, now_s: f64, status: impl Fn(&str) -> Option<(u32, f64)>) -> Next {
        while let Some(step) = self.steps.get(self.at) {
            match step {
                Step::Write(write) => return Next::Write(write.clone()),
                Step::Delay { seconds } if now_s - self.since_s < *seconds => return Next::Wait,
                Step::Delay { .. } => self.go_on(now_s),
                Step::Wait { condition, within_s, error } => {
                    let fresh =
                        status(&condition.signal).filter(|(_, read_s)| *read_s >= self.since_s);
                    if fresh.is_some_and(|(bits, _)| condition.holds(bits)) {
                        self.go_on(now_s);
                    } else if now_s - self.since_s > *within_s {
                        let bits_text = |(bits, _)| format!("is {bits:#06x}");
                        let status = fresh.map_or_else(|| "was not read".to_owned(), bits_text);
                        return Next::Failed {
                            step: self.step(),
                            reason: format!(
                                "{}: {} {status} after {within_s} s ({}){}",
                                error.as_deref().unwrap_or("the status did not come"),
                                condition.signal,
                                condition.expected(),
                                self.refusal()
                            ),
                        };
                    } else {
                        return Next::Wait;
                    }
                }
            }
        }
        Next::Done
    }

    /// The write of this step went out, and whether the drive has it is not known: what follows goes out all the same.
    pub(super) fn unacknowledged(&mut self, now_s: f64) {
        self.unacknowledged.get_or_insert(self.at);
        self.go_on(now_s);
    }

    /// Whether a write is still to be sent again.
    pub(super) const fn is_unacknowledged(&self) -> bool {
        self.unacknowledged.is_some()
    }

    /// What is to be sent again, in order: from the first write that was not acknowledged up to where the command is.
    fn again(&mut self) -> Vec<(usize, Write)> {
        let from = self.unacknowledged.take().unwrap_or(self.at);
        let passed = self.steps.get(from..self.at).unwrap_or_default();
        let writes = (from..).zip(passed).filter_map(|(at, step)| match step {
            Step::Write(write) => Some((at, write.clone())),
            _ => None,
        });
        writes.collect()
    }

    /// The drive refused a write of this command; returns for how long it has done so, s. The first refusal is kept: it is
    /// why a status that is waited for later does not come.
    pub(super) fn refused(&mut self, now_s: f64, why: String) -> f64 {
        let (_, since_s) = self.refused.get_or_insert((why, now_s));
        now_s - *since_s
    }

    /// The step that is at hand, as the profile counts it.
    pub(super) fn step(&self) -> usize {
        (self.at + 1).saturating_sub(self.before)
    }

    fn refusal(&self) -> String {
        self.refused.as_ref().map_or_else(String::new, |(why, _)| format!("; before that {why}"))
    }

    /// This step is over: its write has been acknowledged, or its wait has ended or does not matter any more.
    pub(super) const fn go_on(&mut self, now_s: f64) {
        self.at += 1;
        self.since_s = now_s;
    }
}

/// Result of a write of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum WriteEnd {
    /// The drive has it, or will not take it: it does not go out again.
    Settled,
    /// Unknown, or the drive was busy: it is sent again.
    Unacknowledged,
}

impl<B: CellBus> ProfiledLink<B> {
    /// Takes a stop as far as it goes now. What comes back beside what is next is the first write that was refused or not
    /// acknowledged: it has kept none of the others from going out.
    pub(super) fn descend(&mut self, sequence: &mut Sequence) -> Result<(Next, Option<LinkError>)> {
        self.points.is_urgent = true;
        let mut first = None;
        for (at, write) in sequence.again() {
            if self.leave(sequence, &write, &mut first)? == WriteEnd::Unacknowledged {
                sequence.unacknowledged.get_or_insert(at);
            }
        }
        loop {
            let faulty = self.reported("fault") == Some(true);
            let readings = &self.readings;
            match sequence.next(self.bus.now_s(), |name| readings.status(name)) {
                Next::Write(write) => {
                    let left = self.leave(sequence, &write, &mut first)?;
                    let now_s = self.bus.now_s();
                    match left {
                        WriteEnd::Unacknowledged => sequence.unacknowledged(now_s),
                        WriteEnd::Settled => sequence.go_on(now_s),
                    }
                }
                // A drive in fault has its output off, whatever its stop command waits for.
                Next::Wait | Next::Failed { .. } if faulty => sequence.go_on(self.bus.now_s()),
                next => return Ok((next, first)),
            }
        }
    }

    /// One write of a stop.
    fn leave(
        &mut self,
        sequence: &mut Sequence,
        write: &Write,
        first: &mut Option<LinkError>,
    ) -> Result<WriteEnd> {
        let written = self.points.carry(&mut far_end!(self), write);
        let now_s = self.bus.now_s();
        let error = match written {
            Ok(()) => {
                self.kicked_s = now_s;
                return Ok(WriteEnd::Settled);
            }
            Err(error @ LinkError::Gone { .. }) => return Err(error),
            // Its state shows whether it carries out what it accepts; while it runs, the stop begins again.
            Err(LinkError::Exception { code: 5, .. }) if self.confirms_stop() => {
                self.kicked_s = now_s;
                return Ok(WriteEnd::Settled);
            }
            Err(error) => error,
        };
        let later = error.is_transient()
            || matches!(&error, LinkError::Exception { code, .. } if is_busy(*code));
        sequence.refused(now_s, error.to_string());
        sequence.is_denied |= !later;
        first.get_or_insert(error);
        Ok(if later { WriteEnd::Unacknowledged } else { WriteEnd::Settled })
    }

    /// One pass of a command to its end, with the time that its steps take.
    pub(super) fn carry_out(&mut self, command: &'static str) -> Result<()> {
        let mut sequence = Sequence::new(command, self.way_down(command), self.bus.now_s());
        let mut first = None;
        loop {
            self.points.begin();
            let (next, error) = self.descend(&mut sequence)?;
            first = first.or(error);
            match next {
                Next::Done => return first.map_or(Ok(()), Err),
                Next::Failed { step, reason } => {
                    return Err(self.broken_off(command, (step, sequence.steps()), reason));
                }
                Next::Wait | Next::Write(_) => drop(self.look()?),
            }
        }
    }

    /// Reads the status after a pause; a lost reply does not end a stop and is returned.
    fn look(&mut self) -> Result<Option<LinkError>> {
        let now_s = self.bus.now_s();
        // Period of the status reads during a stop, s.
        self.bus.pause_until_s(now_s + 0.02);
        match self.readings.read_fast(&mut self.bus, None) {
            Err(error) if error.is_transient() => Ok(Some(error)),
            read => read.map(|_| None),
        }
    }

    /// Reads, which such a watchdog does not count, until the drive shows that nothing commands it, or its time is over.
    pub(super) fn outlast_watchdog(&mut self) -> Result<()> {
        let until_s = self.bus.now_s() + self.map.released_after_s().unwrap_or(0.0);
        while self.reported("running") == Some(true) && self.bus.now_s() < until_s {
            self.look()?;
        }
        Ok(())
    }

    /// Whether the drive reports within a few seconds that it does not run; only a status read after the stop counts. Without a status
    /// signal the acknowledged writes count.
    pub(super) fn rests(&mut self) -> Result<bool> {
        let stopped_s = self.bus.now_s();
        if !self.confirms_stop() {
            return self.look().map(|_| true);
        }
        loop {
            let lost = self.look()?;
            match (self.state_since("running", stopped_s), lost) {
                (Some(false), _) => return Ok(true),
                // A drive that reports that it runs so long after its stop command was carried out has not stopped, s.
                _ if self.bus.now_s() <= stopped_s + 2.0 => {}
                (None, Some(lost)) => return Err(lost),
                _ => return Ok(false),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::register_map::Condition;

    fn write(name: &str, value: f64) -> Step {
        Step::Write(Write { set_point: name.to_owned(), value, mask: None })
    }

    fn steps() -> Vec<Step> {
        vec![
            write("word", 6.0),
            Step::Delay { seconds: 0.5 },
            Step::Wait {
                condition: Condition {
                    signal: "status".to_owned(),
                    mask: 0x6F,
                    pattern: 0x21,
                    negated: false,
                    or: None,
                    line: 7,
                },
                within_s: 1.0,
                error: Some("not ready".to_owned()),
            },
        ]
    }

    #[test]
    fn steps_are_taken_in_order_and_an_old_status_does_not_count() {
        let mut sequence = Sequence::new("enable", &steps(), 0.0);
        let ready_at = |read_s| move |_: &str| Some((0x21, read_s));
        assert!(matches!(sequence.next(0.0, ready_at(0.0)), Next::Write(_)));
        sequence.go_on(0.1);
        assert_eq!(sequence.next(0.5, ready_at(0.5)), Next::Wait);
        // The delay ends here; what was read before that is of another time.
        assert_eq!(sequence.next(0.7, ready_at(0.6)), Next::Wait);
        assert_eq!(sequence.next(0.8, ready_at(0.75)), Next::Done);
    }
}

//! Bringing a drive to rest: every write of a stop leaves at once, whatever becomes of the others.
//!
//! ```text
//! write -> write -> wait -> write        each write goes out although the one before was refused or not acknowledged;
//!                                        what was not acknowledged goes out again with the next exchange
//! in fault: write -> write -> write      nothing is waited for: the output is off, and the words have to be taken back
//! ```

use super::ProfiledLink;
use super::sequence::{Next, Sequence};
use crate::drive::link::{DriveLink, LinkError};
use crate::drive::patience::is_busy;
use crate::drive::register_bus::RegisterBus;
use crate::drive::register_map::Step;

/// Between two looks at the status while a stop is waited for, s.
const LOOK_S: f64 = 0.02;
/// A drive that reports that it runs so long after its stop command was carried out has not stopped, s.
const STOP_TIME_S: f64 = 2.0;

/// What became of a write of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Left {
    /// The drive has it, or will not take it: it does not go out again.
    Settled,
    /// Nobody knows, or the drive was busy: it goes out again.
    Unheard,
}

impl<B: RegisterBus> ProfiledLink<B> {
    /// Takes a stop as far as it goes now. What comes back beside what is next is the first write that was refused or not
    /// acknowledged: it has kept none of the others from going out.
    pub(super) fn descend(
        &mut self,
        sequence: &mut Sequence,
    ) -> Result<(Next, Option<LinkError>), LinkError> {
        self.points.is_urgent = true;
        let mut first = None;
        for (at, step) in sequence.again() {
            let Step::Write {
                set_point,
                value,
                mask,
            } = step
            else {
                continue;
            };
            if self.leave(sequence, &set_point, value, mask, &mut first)? == Left::Unheard {
                sequence.unheard_again(at);
            }
        }
        loop {
            let faulty = self.told("fault") == Some(true);
            let readings = &self.readings;
            match sequence.next(self.bus.now_s(), |name| readings.status(name)) {
                Next::Write {
                    set_point,
                    value,
                    mask,
                } => {
                    let left = self.leave(sequence, &set_point, value, mask, &mut first)?;
                    let now_s = self.bus.now_s();
                    match left {
                        Left::Unheard => sequence.unheard(now_s),
                        Left::Settled => sequence.go_on(now_s),
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
        set_point: &str,
        value: f64,
        mask: Option<u16>,
        first: &mut Option<LinkError>,
    ) -> Result<Left, LinkError> {
        let written = self
            .points
            .write(&mut self.bus, &self.readings, set_point, value, mask);
        let now_s = self.bus.now_s();
        let error = match written {
            Ok(()) => {
                self.kicked_s = now_s;
                return Ok(Left::Settled);
            }
            Err(error @ LinkError::Gone { .. }) => return Err(error),
            Err(error) => error,
        };
        let later = error.is_transient()
            || matches!(&error, LinkError::Exception { code, .. } if is_busy(*code));
        sequence.refused(now_s, error.to_string());
        first.get_or_insert(error);
        Ok(if later { Left::Unheard } else { Left::Settled })
    }

    /// One pass of a command to its end, with the time that its steps take.
    pub(super) fn carry_out(&mut self, command: &'static str) -> Result<(), LinkError> {
        let steps = match command {
            "coast" => &self.map.commands.coast,
            _ => &self.map.commands.stop,
        };
        let mut sequence = Sequence::new(command, steps, self.bus.now_s());
        let mut first = None;
        loop {
            self.points.begin();
            let (next, error) = self.descend(&mut sequence)?;
            first = first.or(error);
            match next {
                Next::Done => return first.map_or(Ok(()), Err),
                Next::Failed { step, reason } => {
                    return Err(LinkError::Sequence {
                        link: self.name().0,
                        command,
                        step,
                        steps: sequence.steps(),
                        reason,
                    });
                }
                Next::Wait | Next::Write { .. } => self.look()?,
            }
        }
    }

    /// Reads the status after a moment; a lost reply is not the end of a stop.
    pub(super) fn look(&mut self) -> Result<(), LinkError> {
        let now_s = self.bus.now_s();
        self.bus.pause_until_s(now_s + LOOK_S);
        match self.readings.read_fast(&mut self.bus, None) {
            Err(error) if !error.is_transient() => Err(error),
            _ => Ok(()),
        }
    }

    /// Whether the drive reports within a while that it does not run; without a status the acknowledged writes are all
    /// there is.
    pub(super) fn rests(&mut self) -> Result<bool, LinkError> {
        let until_s = self.bus.now_s() + STOP_TIME_S;
        self.look()?;
        while self.told("running") == Some(true) {
            if self.bus.now_s() > until_s {
                return Ok(false);
            }
            self.look()?;
        }
        Ok(true)
    }
}

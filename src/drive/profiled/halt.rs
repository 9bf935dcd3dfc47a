//! Stopping without a session: commands carried out to their end, and a look whether the drive says so.

use super::ProfiledLink;
use super::sequence::{Next, Sequence};
use crate::drive::link::{DriveLink, LinkError};
use crate::drive::register_bus::RegisterBus;

/// Between two looks at the status while a stop is waited for, s.
const LOOK_S: f64 = 0.02;
/// A drive that reports that it runs so long after its stop command was carried out has not stopped, s.
const STOP_TIME_S: f64 = 2.0;

impl<B: RegisterBus> ProfiledLink<B> {
    /// One pass of a command to its end, with the time that its steps take.
    pub(super) fn carry_out(&mut self, command: &'static str) -> Result<(), LinkError> {
        self.points.is_urgent = true;
        let steps = match command {
            "coast" => &self.map.commands.coast,
            _ => &self.map.commands.stop,
        };
        let mut sequence = Sequence::new(command, steps, self.bus.now_s());
        loop {
            let faulty = self.told("fault") == Some(true);
            let readings = &self.readings;
            let status = |name: &str| {
                let reading = readings.get(name)?;
                Some((reading.pattern?, reading.read_s))
            };
            match sequence.next(self.bus.now_s(), status) {
                Next::Done => return Ok(()),
                Next::Write {
                    set_point,
                    value,
                    mask,
                } => {
                    self.points
                        .write(&mut self.bus, &self.readings, &set_point, value, mask)?;
                    sequence.written(self.bus.now_s());
                }
                Next::Wait if faulty => return Ok(()),
                Next::Wait => self.look()?,
                Next::Failed { step, reason } => {
                    return Err(LinkError::Sequence {
                        link: self.name().0,
                        command,
                        step,
                        steps: sequence.steps(),
                        reason,
                    });
                }
            }
        }
    }

    /// Reads the status after a moment; a lost reply is not the end of a stop.
    pub(super) fn look(&mut self) -> Result<(), LinkError> {
        let now_s = self.bus.now_s();
        self.bus.pause_until_s(now_s + LOOK_S);
        match self.readings.read_fast(&mut self.bus) {
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

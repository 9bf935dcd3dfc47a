//! One measured instant.

use crate::tabulated;
use std::sync::Arc;

use super::{Channel, Sensors};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Quality {
    Good,
    /// Older than the stamp of the sample.
    Stale,
    #[default]
    Missing,
}

tabulated! {
    /// State of the drive, reduced to the states that every drive has.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum DriveState {
        #[default]
        Disabled = "disabled",
        Ready = "ready",
        Running = "running",
        Fault = "fault",
    }
    pub const fn name(self) -> &'static str;
}

/// Reason, other than a fault, for which a drive does not follow the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hindrance {
    /// Control by its keypad, its terminals or another master.
    LocalControl,
    /// Output disabled by safe torque off or another enable input.
    TorqueOff,
}

impl Hindrance {
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::LocalControl => {
                "the drive is under local control and takes no set-point from here: give the command back to the bus at its keypad"
            }
            Self::TorqueOff => {
                "safe torque off (STO) is active at the drive: close its enable circuit first"
            }
        }
    }
}

/// When a command reached the motor: without it every run seems to have a command delay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Applied {
    pub seq: u64,
    pub time_s: f64,
}

/// One measured instant: every quantity is optional and carries its own quality.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// Drive time where the drive has a clock, else host time; s.
    pub time_s: f64,
    /// Half of the interval in which the sample may have been taken, s: it lies within `time_s` plus or minus this.
    /// `None`: a stamp of the drive.
    pub time_half_width_s: Option<f64>,
    /// Host time at which the reply was complete; s.
    pub host_time_s: Option<f64>,
    pub seq: Option<u64>,
    pub state: Option<DriveState>,
    /// The drive's status word as read.
    pub status: Option<u16>,
    pub fault: Option<u16>,
    pub fault_text: Option<Arc<str>>,
    /// Reason for which the drive does not follow, where it reports one.
    pub hindrance: Option<Hindrance>,
    /// A limit of the drive was active: the voltage was not the commanded one.
    pub limited: bool,
    /// The command in it was not confirmed by the drive: it acted at an unknown time before the next one, if at all.
    pub is_unconfirmed: bool,
    /// What the drive's profile states of the sensors.
    pub sensors: Sensors,
    /// Field current of a motor with a separate field, where the drive's profile maps it, A.
    pub field_a: Option<f64>,
    pub applied: Option<Applied>,
    values: [Option<f64>; Channel::COUNT],
    stale: [bool; Channel::COUNT],
}

impl Sample {
    pub fn at(time_s: f64) -> Self {
        Self { time_s, ..Self::default() }
    }

    /// The value of a channel, stale or good; `None` when missing.
    pub fn get(&self, channel: Channel) -> Option<f64> {
        match channel {
            Channel::TimeHalfWidth => self.time_half_width_s,
            _ => self.values[channel.index()],
        }
    }

    pub fn good(&self, channel: Channel) -> Option<f64> {
        let is_good = self.quality(channel) == Quality::Good;
        self.get(channel).filter(|_| is_good)
    }

    pub fn quality(&self, channel: Channel) -> Quality {
        match (self.get(channel), self.stale[channel.index()]) {
            (None, _) => Quality::Missing,
            (Some(_), true) => Quality::Stale,
            (Some(_), false) => Quality::Good,
        }
    }

    /// Sets a good value; a value that is not finite counts as missing.
    pub fn set(&mut self, channel: Channel, value: f64) {
        let value = value.is_finite().then_some(value);
        match channel {
            Channel::TimeHalfWidth => self.time_half_width_s = value,
            _ => self.values[channel.index()] = value,
        }
        self.stale[channel.index()] = false;
    }

    pub fn set_stale(&mut self, channel: Channel) {
        self.stale[channel.index()] = true;
    }

    #[must_use]
    pub fn with(mut self, channel: Channel, value: f64) -> Self {
        self.set(channel, value);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn staleness_ends_with_the_next_value_and_nan_is_missing() {
        let mut sample = Sample::at(0.0).with(Channel::Speed, 1.0);
        sample.set_stale(Channel::Speed);
        assert_eq!(sample.quality(Channel::Speed), Quality::Stale);
        sample.set(Channel::Speed, 2.0);
        assert_eq!(sample.quality(Channel::Speed), Quality::Good);
        sample.set(Channel::Speed, f64::NAN);
        assert_eq!(sample.quality(Channel::Speed), Quality::Missing);
    }
}

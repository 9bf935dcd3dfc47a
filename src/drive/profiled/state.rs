//! From readings to the state and the sample that every drive has.

use super::{Mode, ProfiledLink};
use crate::drive::register_bus::RegisterBus;
use crate::drive::register_map::Quantity;
use crate::sample::{Channel, DriveState, Sample};

impl<B: RegisterBus> ProfiledLink<B> {
    /// Whether a state of the profile holds; `None` where no register tells it.
    pub(super) fn told(&self, state: &str) -> Option<bool> {
        let condition = self.map.state(state)?;
        let pattern = self.readings.get(&condition.signal)?.pattern?;
        Some(condition.holds(pattern))
    }

    pub(super) fn state(&self) -> DriveState {
        if self.field_lost
            || self.told("fault") == Some(true)
            || self.told("comm_loss") == Some(true)
        {
            DriveState::Fault
        } else if self.told("running").unwrap_or(self.mode == Mode::On) {
            // While it is being enabled no set-point is in force yet.
            if matches!(self.mode, Mode::Enabling(_)) {
                DriveState::Ready
            } else {
                DriveState::Running
            }
        } else if self.told("ready") == Some(true) {
            DriveState::Ready
        } else {
            DriveState::Disabled
        }
    }

    pub(super) fn sample(&self, time_s: f64, began_s: f64) -> Sample {
        let mut sample = Sample::at(time_s);
        sample.host_time_s = Some(self.bus.now_s());
        sample.state = Some(self.state());
        sample.limited = self.points.limited;
        let word = |pattern: u32| {
            let [.., high, low] = pattern.to_be_bytes();
            u16::from_be_bytes([high, low])
        };
        sample.status = ["running", "fault"].into_iter().find_map(|name| {
            let signal = &self.map.state(name)?.signal;
            self.readings.get(signal)?.pattern.map(word)
        });
        if sample.state == Some(DriveState::Fault) {
            sample.fault = self
                .map
                .of_quantity(Quantity::FaultCode)
                .and_then(|signal| self.readings.get(&signal.name)?.pattern)
                .map(word);
        }
        for (index, signal) in self.map.signals.iter().enumerate() {
            let reading = self.readings.at(index);
            if let (Some((channel, si)), Some(value)) = (signal.channel, reading.value) {
                sample.set(channel, value * si);
                if reading.read_s < began_s {
                    sample.set_stale(channel);
                }
            }
        }
        if let Some(volts) = self.points.held(&self.map, Quantity::Voltage) {
            sample.set(Channel::VoltageCmd, volts);
        }
        sample
    }
}

//! At connect: is it the drive of the profile, and who watches over the host.

use super::ProfiledLink;
use crate::drive::link::{DriveLink, LinkError};
use crate::drive::register_bus::RegisterBus;
use crate::drive::register_map::{IdentityCheck, IdentityTest};
use crate::sample::DriveState;

impl<B: RegisterBus> ProfiledLink<B> {
    pub(super) fn check_identity(&mut self) -> Result<(), LinkError> {
        for check in self.map.identity.clone() {
            let wrong = match check {
                IdentityCheck::Object { object, contains } => {
                    let found = self.bus.object(object)?;
                    let fits = found.as_ref().is_some_and(|text| text.contains(&contains));
                    (!fits).then(|| {
                        format!("identification object {object} is {found:?} (expected {contains:?} in it)")
                    })
                }
                IdentityCheck::Signal { signal, mask, test } => {
                    let reading = self.readings.get(&signal).unwrap_or_default();
                    let fits = match &test {
                        IdentityTest::OneOf(patterns) => reading
                            .pattern
                            .is_some_and(|pattern| patterns.contains(&(pattern & mask))),
                        IdentityTest::Within([low, high]) => reading
                            .value
                            .is_some_and(|value| (*low..=*high).contains(&value)),
                    };
                    (!fits)
                        .then(|| format!("{signal} is {:?} (expected {test:?})", reading.pattern))
                }
            };
            if let Some(reason) = wrong {
                return Err(LinkError::Identity(
                    self.name().0,
                    format!("this is not {}: {reason}", self.map.device.name),
                ));
            }
        }
        Ok(())
    }

    /// The watchdog's time: written where the profile says so, and read back. The drive of somebody else, which runs, is
    /// left as it is: with a watchdog that nobody refreshes it would stop once this host has gone.
    pub(super) fn supervision(&mut self) -> Result<Option<f64>, LinkError> {
        let runs = self.state() == DriveState::Running;
        let watchdog = &self.map.watchdog;
        let set_s = watchdog.set_s().filter(|_| !runs);
        let Some((location, unit_s)) = watchdog.time else {
            return Ok(watchdog.default_s());
        };
        if let Some(set_s) = set_s {
            let has_single = self.map.functions.contains(&6);
            let function = if has_single { 6 } else { 16 };
            let registers = location.layout.encode(set_s / unit_s);
            let registers = registers.ok_or_else(|| {
                self.refused(format!("watchdog time {set_s} s does not fit its register"))
            })?;
            self.bus.write(function, location.address, &registers)?;
        }
        let registers = self.bus.read(location.request())?.words;
        let raw = location.layout.pattern(&registers).unwrap_or_default();
        let time_s = location.layout.number(raw) * unit_s;
        if let Some(set_s) = set_s
            && (time_s - set_s).abs() > 0.5 * unit_s
        {
            return Err(LinkError::Identity(
                self.name().0,
                format!("the watchdog was set to {set_s} s and reads back as {time_s} s"),
            ));
        }
        Ok(Some(time_s))
    }
}

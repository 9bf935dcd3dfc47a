//! State and sample of a drive from its readings.

use std::fmt::Write as _;

use super::{Mode, ProfiledLink};
use crate::cell_bus::CellBus;
use crate::link::LinkError;
use crate::register_map::{Condition, Quantity};
use drivebench_model::sample::{Channel, DriveState, Hindrance, Sample};

/// Report of a drive whose watchdog has stopped it.
const COMM_LOSS: &str = "communication loss (comm_loss): the drive's own watchdog has expired";

const fn low_word(pattern: u32) -> u16 {
    let [.., high, low] = pattern.to_be_bytes();
    u16::from_be_bytes([high, low])
}

impl<B: CellBus> ProfiledLink<B> {
    /// Whether a state of the profile holds; `None` where no register maps it.
    pub(super) fn reported(&self, state: &str) -> Option<bool> {
        let condition = self.map.state(state)?;
        let pattern = self.readings.get(&condition.signal)?.pattern;
        condition.holds_by(pattern, |name| self.readings.get(name)?.value)
    }

    /// The same where it was read since then, s.
    pub(super) fn state_since(&self, state: &str, since_s: f64) -> Option<bool> {
        let condition = self.map.state(state)?;
        let is_fresh = |name: &str| {
            self.readings.get(name).is_some_and(|reading| reading.span.asked_s >= since_s)
        };
        let are_fresh = is_fresh(&condition.signal)
            && condition.or.as_ref().is_none_or(|beyond| is_fresh(&beyond.signal));
        self.reported(state).filter(|_| are_fresh)
    }

    /// Whether its fault condition holds, or that of its own watchdog.
    pub(super) fn is_in_fault(&self) -> bool {
        self.reported("fault") == Some(true) || self.has_lost_host()
    }

    /// Whether it reports that its watchdog has expired. One that resumes with the next command reports it of every silence, also
    /// of that before its enable command and that after its stop.
    fn has_lost_host(&self) -> bool {
        let is_expected = self.mode != Mode::On && self.map.watchdog.keys.auto_resume;
        self.reported("comm_loss") == Some(true) && !is_expected
    }

    /// The code of its fault, as last read; 0 is none.
    fn fault_code(&self) -> Option<u16> {
        let signal = self.map.of_quantity(Quantity::FaultCode)?;
        Some(low_word(self.readings.get(&signal.name)?.pattern?)).filter(|code| *code != 0)
    }

    /// Meaning of the fault code, if the profile has it.
    fn fault_words(&self) -> Option<String> {
        let text = self.fault_code().and_then(|code| self.map.fault_codes.get(&code));
        match (self.has_lost_host(), text) {
            (true, Some(text)) => Some(format!("{COMM_LOSS} ({text})")),
            (true, None) => Some(COMM_LOSS.to_owned()),
            (false, text) => text.cloned(),
        }
    }

    /// Words for a drive whose fault condition holds, and whether its watchdog may be why; else nothing.
    pub(super) fn in_fault_text(&self, now_s: f64) -> String {
        let holds =
            ["fault", "comm_loss"].into_iter().find(|state| self.reported(state) == Some(true));
        let Some(fault) = holds.and_then(|state| self.map.state(state)) else {
            return String::new();
        };
        let mut text =
            format!("; it is in fault: {} ({})", self.word_text(fault), fault.expected());
        if let Some(code) = self.fault_code() {
            let _ = write!(text, ", code {code:#06x}");
        }
        if let Some(words) = self.fault_words() {
            let _ = write!(text, ": {words}");
        }
        let silence_s = now_s - self.kicked_s;
        if let Some(watchdog_s) = self.watchdog_s.filter(|limit_s| silence_s > *limit_s) {
            let since = if silence_s.is_finite() {
                format!("for {silence_s:.3} s")
            } else {
                "yet".to_owned()
            };
            let _ = write!(
                text,
                "; nothing that its watchdog of {watchdog_s} s counts went out {since}, which may be the cause"
            );
        }
        text
    }

    /// Every step of the enable command was carried out, and the drive does not report that it runs.
    pub(super) fn never_ran(&self) -> LinkError {
        let steps = self.map.commands.enable.len();
        let reason = self.map.state("running").map_or_else(String::new, |running| {
            format!(
                "the drive does not run after it: {} where [state] running is looked for ({}); if it only takes a while, end enable with a wait for it",
                self.word_text(running),
                running.expected()
            )
        });
        self.broken_off("enable", (steps, steps), reason)
    }

    /// `status is 0x0040`.
    fn word_text(&self, condition: &Condition) -> String {
        let reading = self.readings.get(&condition.signal);
        let found = reading.and_then(|reading| reading.pattern);
        let found =
            found.map_or_else(|| "was not read".to_owned(), |bits| format!("is {bits:#06x}"));
        format!("{} {found}", condition.signal)
    }

    /// What else controls the drive, as far as its profile maps it.
    pub(super) fn hindrance(&self) -> Option<Hindrance> {
        if self.reported("sto") == Some(true) {
            Some(Hindrance::TorqueOff)
        } else if self.reported("local") == Some(true) || self.reported("remote") == Some(false) {
            Some(Hindrance::LocalControl)
        } else {
            None
        }
    }

    pub(super) fn state(&self) -> DriveState {
        // Where no register maps it, a stop that is not through yet has stopped nothing.
        let may_run = matches!(self.mode, Mode::On | Mode::Stopping(_));
        if self.field_lost || self.is_in_fault() {
            DriveState::Fault
        } else if self.reported("running").unwrap_or(may_run) {
            // While it is being enabled no set-point is in force yet.
            if matches!(self.mode, Mode::Enabling(_)) {
                DriveState::Ready
            } else {
                DriveState::Running
            }
        } else if self.reported("ready") == Some(true) {
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
        sample.sensors = self.map.sensors();
        sample.field_a = self
            .map
            .of_quantity(Quantity::FieldCurrent)
            .and_then(|signal| self.reading(&signal.name));
        sample.status = ["running", "fault"].into_iter().find_map(|name| {
            let signal = &self.map.state(name)?.signal;
            self.readings.get(signal)?.pattern.map(low_word)
        });
        if sample.state == Some(DriveState::Fault) {
            sample.fault = self.fault_code();
            sample.fault_text = self.fault_words().map(Into::into);
        }
        sample.hindrance = self.hindrance();
        for (index, signal) in self.map.signals.iter().enumerate() {
            let reading = self.readings.at(index);
            if let (Some((channel, si)), Some(value)) = (signal.channel, reading.value) {
                sample.set(channel, value * si);
                if reading.span.asked_s < began_s {
                    sample.set_stale(channel);
                }
            }
        }
        if let Some(volts) = self.points.held(&self.map, &self.readings, Quantity::Voltage) {
            sample.set(Channel::VoltageCmd, volts);
        }
        sample
    }
}

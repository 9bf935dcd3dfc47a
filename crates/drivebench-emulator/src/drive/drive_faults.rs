//! What goes wrong in the drive itself: commands that are acknowledged and not followed, sensors, registers, clock, power.

use firmware_protocol::{Control, State, Telemetry};

use super::micros;
use crate::fault::{FaultEntry, FaultKind, TimedFault};
use crate::truth::Reading;

pub(super) struct DriveFaults {
    timed: Vec<TimedFault>,
    there: Vec<FaultEntry>,
    reported: Option<Telemetry>,
    clock_us: u32,
}

impl DriveFaults {
    pub(super) fn new(faults: &[FaultEntry]) -> Self {
        let wraps = faults.iter().find(|fault| fault.kind == FaultKind::ClockWraps);
        let wraps_after_s = wraps.map(|fault| fault.wraps_after_s.unwrap_or(5.0));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a counter of microseconds that wraps"
        )]
        let clock_us = wraps_after_s.map_or(0, |at_s| ((at_s * 1e6) as u64 as u32).wrapping_neg());
        Self {
            timed: faults.iter().copied().map(TimedFault::new).collect(),
            there: Vec::new(),
            reported: None,
            clock_us,
        }
    }

    /// Brings it up to date; whether anything goes wrong.
    pub(super) fn look(&mut self, now_s: f64, ran_s: Option<f64>) -> bool {
        self.there.clear();
        for fault in &mut self.timed {
            if fault.is_active(now_s, ran_s) {
                self.there.push(fault.entry);
            }
        }
        !self.there.is_empty()
    }

    pub(super) fn has(&self, kind: FaultKind) -> bool {
        self.there.iter().any(|fault| fault.kind == kind)
    }

    pub(super) const fn clock_us(&self) -> u32 {
        self.clock_us
    }

    pub(super) const fn clock_from(&mut self, tick: u64) {
        self.clock_us = micros(tick).wrapping_neg();
    }

    /// What the drive does of a command that it acknowledges.
    pub(super) fn obeyed(&self, state: State, now: Control, command: Control) -> Control {
        let stops = matches!(command, Control::Stop | Control::Disable);
        let resets = matches!(command, Control::ResetFault);
        if resets || self.there.is_empty() {
            return command;
        }
        if stops {
            let keeps = self.has(FaultKind::StopIgnored) && state == State::Running;
            return if keeps { now } else { command };
        }
        if self.has(FaultKind::EnableIgnored) {
            Control::Stop
        } else if self.has(FaultKind::SetPointIgnored) && state == State::Running {
            now
        } else {
            command
        }
    }

    pub(super) fn reading(&self, mut reading: Reading) -> Reading {
        for fault in &self.there {
            let factor = fault.factor.unwrap_or(0.0);
            match fault.kind {
                FaultKind::SpeedScaled => {
                    reading.speed_rad_s *= factor;
                    reading.angle_rad *= factor;
                }
                FaultKind::CurrentScaled => reading.current_a *= factor,
                FaultKind::SignalMissing => {
                    reading.current_a = f64::NAN;
                    reading.speed_rad_s = f64::NAN;
                }
                _ => {}
            }
        }
        reading
    }

    /// What is reported; measured values that are frozen stay, and the drive's clock and state are still its own.
    pub(super) fn telemetry(&mut self, honest: Telemetry) -> Telemetry {
        if self.timed.is_empty() {
            return honest;
        }
        if let (Some(last), true) = (self.reported, self.has(FaultKind::FrozenRegisters)) {
            return Telemetry {
                voltage_v: last.voltage_v,
                current_a: last.current_a,
                speed_rad_s: last.speed_rad_s,
                angle_rad: last.angle_rad,
                bus_v: last.bus_v,
                temperature_c: last.temperature_c,
                ..honest
            };
        }
        self.reported = Some(honest);
        honest
    }
}

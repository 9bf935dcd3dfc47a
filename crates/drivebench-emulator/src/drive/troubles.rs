//! What goes wrong in the drive itself: commands that are acknowledged and not followed, sensors, registers, clock, power.

use firmware_protocol::{Control, State, Telemetry};

use super::micros;
use crate::fault::{FaultEntry, FaultKind, Lurking};
use crate::truth::Reading;

pub(super) struct Troubles {
    lurking: Vec<Lurking>,
    /// Those that are there now.
    there: Vec<FaultEntry>,
    /// What was told last.
    told: Option<Telemetry>,
    /// Added to the drive's clock, us.
    clock_us: u32,
}

impl Troubles {
    pub(super) fn new(faults: &[FaultEntry]) -> Self {
        let wraps = faults
            .iter()
            .find(|fault| fault.kind == FaultKind::ClockWraps);
        let wraps_after_s = wraps.map(|fault| fault.wraps_after_s.unwrap_or(5.0));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a counter of microseconds that wraps"
        )]
        let clock_us = wraps_after_s.map_or(0, |at_s| ((at_s * 1e6) as u64 as u32).wrapping_neg());
        Self {
            lurking: faults.iter().copied().map(Lurking::new).collect(),
            there: Vec::new(),
            told: None,
            clock_us,
        }
    }

    /// Brings it up to date; whether anything goes wrong.
    pub(super) fn look(&mut self, now_s: f64, ran_s: Option<f64>) -> bool {
        self.there.clear();
        for fault in &mut self.lurking {
            if fault.is_there(now_s, ran_s) {
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

    /// The drive's clock begins anew.
    pub(super) const fn clock_from(&mut self, tick: u64) {
        self.clock_us = micros(tick).wrapping_neg();
    }

    /// What the drive does of what it is told to, and acknowledges.
    pub(super) fn obeyed(&self, state: State, now: Control, told: Control) -> Control {
        let stops = matches!(told, Control::Stop | Control::Disable);
        let resets = matches!(told, Control::ResetFault);
        if resets || self.there.is_empty() {
            return told;
        }
        if stops {
            let keeps = self.has(FaultKind::StopIgnored) && state == State::Running;
            return if keeps { now } else { told };
        }
        if self.has(FaultKind::EnableIgnored) {
            Control::Stop
        } else if self.has(FaultKind::SetPointIgnored) && state == State::Running {
            now
        } else {
            told
        }
    }

    /// What broken sensors show.
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

    /// What is told; measured values that are frozen stay, and the drive's clock and state are still its own.
    pub(super) fn telemetry(&mut self, honest: Telemetry) -> Telemetry {
        if self.lurking.is_empty() {
            return honest;
        }
        if let (Some(told), true) = (self.told, self.has(FaultKind::FrozenRegisters)) {
            return Telemetry {
                voltage_v: told.voltage_v,
                current_a: told.current_a,
                speed_rad_s: told.speed_rad_s,
                angle_rad: told.angle_rad,
                bus_v: told.bus_v,
                temperature_c: told.temperature_c,
                ..honest
            };
        }
        self.told = Some(honest);
        honest
    }
}

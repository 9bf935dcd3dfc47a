//! Burst capture: the drive records voltage, current and speed far faster than a link carries.

use firmware_protocol::{CaptureControl, CaptureSample, CaptureState};

use crate::truth::Reading;

/// Samples that one capture holds: 0.4 s at 100 us.
pub(super) const LENGTH: u16 = 4096;

/// The record and its trigger.
#[derive(Default)]
pub(super) struct Capture {
    state: CaptureState,
    samples: Vec<CaptureSample>,
    first_tick: u64,
    next_tick: u64,
    /// Voltage since the sample before: its sum over the ticks, and how many.
    volts: f64,
    ticks: u32,
}

impl Capture {
    pub(super) fn control(&mut self, control: CaptureControl, tick: u64) {
        self.samples.clear();
        (self.volts, self.ticks) = (0.0, 0);
        self.state = match control {
            CaptureControl::Abort => CaptureState::Empty,
            CaptureControl::Arm => CaptureState::Armed,
            CaptureControl::Start => CaptureState::Recording,
        };
        self.next_tick = tick + 1;
    }

    /// The trigger of an armed capture: sample 0 is taken at the instant of the command.
    pub(super) const fn command_applied(&mut self) {
        if matches!(self.state, CaptureState::Armed) {
            self.state = CaptureState::Recording;
            self.next_tick = 0;
            (self.volts, self.ticks) = (0.0, 0);
        }
    }

    /// The armature stood at this voltage for one tick more.
    pub(super) fn held(&mut self, voltage_v: f64) {
        self.volts += voltage_v;
        self.ticks += 1;
    }

    /// Mean voltage since the last call; `None` where no time has passed.
    pub(super) fn mean_voltage_v(&mut self) -> Option<f64> {
        let (volts, ticks) = (std::mem::take(&mut self.volts), std::mem::take(&mut self.ticks));
        (ticks > 0).then(|| volts / f64::from(ticks))
    }

    /// Whether a sample is to be recorded at `tick`; if so, the next one is due `period` ticks later.
    pub(super) fn is_due(&mut self, tick: u64, period: u64) -> bool {
        let due = self.state == CaptureState::Recording && tick >= self.next_tick;
        if due {
            self.next_tick = tick + period;
        }
        due
    }

    pub(super) fn record(&mut self, tick: u64, reading: &Reading) {
        if self.samples.is_empty() {
            self.first_tick = tick;
        }
        self.samples.push(CaptureSample {
            voltage_v: reading.voltage_v,
            current_a: reading.current_a,
            speed_rad_s: reading.speed_rad_s,
        });
        if self.count() == LENGTH {
            self.state = CaptureState::Complete;
        }
    }

    pub(super) const fn state(&self) -> CaptureState {
        self.state
    }

    pub(super) const fn first_tick(&self) -> u64 {
        self.first_tick
    }

    pub(super) fn count(&self) -> u16 {
        u16::try_from(self.samples.len()).unwrap_or(u16::MAX)
    }

    pub(super) fn samples(&self, index: u16, most: usize) -> &[CaptureSample] {
        let tail = self.samples.get(usize::from(index)..).unwrap_or_default();
        &tail[..tail.len().min(most)]
    }
}

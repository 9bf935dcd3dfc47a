//! Recursive (on-line) identification by schemes 2 and 3 from samples and commands in the order of time.
//!
//! A pure function of the samples and their stamps: the same sequence gives the same bits.

use serde::Serialize;

use super::recursive::{CurrentIntegral, Memory, Scheme2, Scheme3, StartValues};
use super::stamps;
use drivebench_model::plant::{Model, MotorKey};
use drivebench_model::sample::{Channel, ParameterEstimate, Sample, Sensors};

#[derive(Clone, Copy, Debug, Default)]
pub struct OnlineConfig {
    /// Forgetting factors per row (a block of about 10 ms).
    pub memory: Memory,
    /// Torque constant, N.m/A; equal to the back-EMF constant unless given.
    pub torque_n_m_per_a: Option<f64>,
    /// First guess of R, L, Ke; without it the data give one.
    pub start: Option<StartValues>,
    /// Filter of the speed, as far as it is known, and whether a current is the mean since the last read.
    pub sensors: Sensors,
}

impl OnlineConfig {
    /// First guess and torque constant from a model; missing values are estimated.
    pub fn from_model(model: &Model) -> Self {
        Self {
            memory: Memory::default(),
            torque_n_m_per_a: model.motor.get(MotorKey::TorqueConstant),
            start: StartValues::from_motor(&model.motor),
            sensors: Sensors::default(),
        }
    }
}

/// The applied voltage of a sample: the command, or the measured voltage in a sequence without commands.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AppliedVoltage {
    commanded: bool,
}

impl AppliedVoltage {
    pub(super) fn of(&mut self, sample: &Sample) -> Option<f64> {
        let command = sample.get(Channel::VoltageCmd);
        self.commanded |= command.is_some();
        let measured = || sample.get(Channel::Voltage).filter(|_| !self.commanded);
        command.or_else(measured)
    }
}

#[derive(Clone, Debug)]
pub struct Online {
    scheme_2: Scheme2,
    scheme_3: Scheme3,
    /// The same with each voltage later by the half-width: the difference is the uncertainty by the stamps. `None`: stamps of the
    /// drive.
    late: Option<Box<Scheme3>>,
    applied: AppliedVoltage,
    /// The last one.
    applied_v: Option<f64>,
    /// Largest half-width of a stamp over about the last hundred samples, s; zero for stamps of the drive.
    half_width_s: f64,
    frozen: Frozen,
    last_s: Option<f64>,
    sensors: Sensors,
    /// Time, current and speed of the last reading, where means over the interval before a reading are taken.
    last: Option<[f64; 3]>,
}

/// Samples at an active limit of the drive, where the voltage is not the commanded one and the estimates are frozen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Frozen {
    pub rows: u64,
    pub seconds: f64,
    /// Begin of the present interval, s in the samples' time; `None`: no active limit.
    pub since_s: Option<f64>,
}

impl Frozen {
    fn take(&mut self, time_s: f64, limited: bool, last_s: Option<f64>) {
        if let (Some(_), Some(last_s)) = (self.since_s, last_s) {
            self.seconds += (time_s - last_s).max(0.0);
        }
        self.rows += u64::from(limited);
        self.since_s = limited.then(|| self.since_s.unwrap_or(time_s));
    }
}

impl Online {
    pub fn new(config: OnlineConfig) -> Self {
        Self {
            // Rows of 10 ms at least.
            scheme_2: Scheme2::new(CurrentIntegral::Trapezoid, config.memory.mechanical, 0.01),
            scheme_3: Scheme3::new(config.memory, config.torque_n_m_per_a, config.start),
            late: None,
            applied: AppliedVoltage::default(),
            applied_v: None,
            half_width_s: 0.0,
            frozen: Frozen::default(),
            last_s: None,
            sensors: config.sensors,
            last: None,
        }
    }

    /// The voltage that the drive has applied from `time_s` on (drive time, as the samples). The reply that reports it
    /// comes with a sample of a later stamp: call this first, then [`Self::push`].
    pub fn command_applied(&mut self, time_s: f64, voltage_v: f64) {
        self.applied.commanded = true;
        self.hold(time_s, voltage_v);
    }

    fn hold(&mut self, time_s: f64, voltage_v: f64) {
        self.scheme_3.voltage_applied(time_s, voltage_v);
        if let Some(late) = &mut self.late {
            late.voltage_applied(time_s + self.half_width_s, voltage_v);
        }
    }

    /// Takes a sample. A voltage command in it holds from its stamp on; where no command ever came, the measured voltage
    /// is held in its place. Stale or missing current or speed: the row gives only its command.
    pub fn push(&mut self, sample: &Sample) {
        let time_s = sample.time_s;
        if let Some(volts) = self.applied.of(sample) {
            let changes = self.applied_v.is_none_or(|before| before.to_bits() != volts.to_bits());
            if sample.is_unconfirmed && changes {
                self.scheme_3.interrupt();
                self.late.iter_mut().for_each(|late| late.interrupt());
            }
            self.applied_v = Some(volts);
            self.hold(time_s, volts);
        }
        let good = [Channel::Current, Channel::Speed].map(|channel| sample.good(channel));
        if let [Some(current), Some(speed)] = good {
            self.frozen.take(time_s, sample.limited, self.last_s);
            self.last_s = Some(time_s);
            let half_width_s = sample.time_half_width_s.unwrap_or(0.0).abs();
            self.half_width_s = half_width_s.max(0.99 * self.half_width_s);
            if half_width_s > 0.0 && self.late.is_none() {
                self.late = Some(Box::new(self.scheme_3.clone()));
            }
            let Some([time_s, current, speed]) = self.middle([time_s, current, speed]) else {
                return;
            };
            for scheme_3 in std::iter::once(&mut self.scheme_3).chain(self.late.as_deref_mut()) {
                scheme_3.set_limited(sample.limited);
                scheme_3.set_half_width(half_width_s);
                scheme_3.push(time_s, current, speed);
            }
            if let Some(noise) = self.scheme_3.speed_noise_rad_s() {
                self.scheme_2.set_speed_noise(noise);
            }
            self.scheme_2.push(time_s, current, speed);
        }
    }

    /// The reading itself; where the speed is filtered or the current a mean, the means since the last reading at the middle of the
    /// interval: of a first-order filter `T (y1 - y0) / h + (y0 + y1) / 2` is the mean of its input. `None` for the first.
    fn middle(&mut self, now: [f64; 3]) -> Option<[f64; 3]> {
        let Sensors { speed, averages_current, .. } = self.sensors;
        if speed.filter_s <= 0.0 && !averages_current {
            return Some(now);
        }
        let [from, to] = [self.last.replace(now)?, now];
        let mean = |signal: usize| f64::midpoint(from[signal], to[signal]);
        let lead = speed.filter_s * (to[2] - from[2]) / (to[0] - from[0]);
        let current_a = if averages_current { to[1] } else { mean(1) };
        Some([mean(0), current_a, mean(2) + lead])
    }

    /// Scheme 3: R, L, Ke, J, Mc.
    pub fn estimates(&self) -> Vec<ParameterEstimate> {
        let mut estimates = self.scheme_3.estimates();
        if let Some(late) = &self.late {
            stamps::widen(&mut estimates, &late.estimates(), self.scheme_3.period_s());
            stamps::refuse(&mut estimates, self.half_width_s);
        }
        estimates
    }

    /// Scheme 2: J, Mc from current and speed alone, with the torque constant that was given, else the one that scheme 3
    /// has found.
    pub fn scheme_2(&self) -> Vec<ParameterEstimate> {
        self.scheme_2.estimates(self.scheme_3.torque_constant())
    }

    /// Innovation of the last block: current, A, and speed, rad/s.
    pub fn innovation(&self) -> Option<(f64, f64)> {
        self.scheme_3.innovation()
    }

    /// Samples and time at a limit of the drive.
    pub const fn frozen(&self) -> Frozen {
        self.frozen
    }

    /// Information on R, L, Ke, Kt/J, Mc/J: one less the posterior over the prior variance.
    pub fn excitation(&self) -> [f64; 5] {
        self.scheme_3.excitation()
    }
}

#[cfg(test)]
#[path = "online_tests.rs"]
mod tests;

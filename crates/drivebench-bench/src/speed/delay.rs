//! The delay of the loop, measured: from the instant at which a sample was taken to the instant at which the command that
//! was computed from it was applied.
//!
//! Both instants are the drive's own, so the host's clock does not come in. What the command asks does not matter: it is
//! measured at rest with the output off before the loop is tuned, and goes on being measured while it runs.

use std::collections::VecDeque;

use serde::Serialize;

use crate::clock::Clock;
use crate::timing::quantile;
use drivebench_link::{DriveLink, LinkError};
use drivebench_model::sample::{Command, Demand, Sample};

/// Cycles over which it is measured at rest.
const CYCLES: u32 = 50;
/// Fewest answers that make a measurement.
const FEWEST: usize = 10;
/// Commands that may be on their way.
const WAITING_MAX: usize = 64;
/// Delays that are kept for the quantiles: at 100 Hz an hour.
const KEPT_MAX: usize = 360_000;

/// What was measured; cycles are those that were asked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LoopDelay {
    pub median_s: f64,
    pub p99_s: f64,
    pub median_cycles: f64,
    pub p99_cycles: f64,
    /// Commands of which the drive said when they were applied.
    pub measured: usize,
}

/// Pairs samples with the commands that were computed from them.
#[derive(Clone, Debug, Default)]
pub(super) struct DelayMeter {
    /// Sequence number and stamp of the sample behind it.
    waiting: VecDeque<(u64, f64)>,
    delays_s: Vec<f64>,
}

impl DelayMeter {
    /// The command with this number was computed from a sample of this time.
    pub(super) fn sent(&mut self, seq: u64, sample_time_s: f64) {
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back((seq, sample_time_s));
    }

    pub(super) fn sample(&mut self, sample: &Sample) {
        let Some(applied) = sample.applied else {
            return;
        };
        while let Some((seq, sample_time_s)) = self.waiting.front().copied() {
            if seq > applied.seq {
                break;
            }
            self.waiting.pop_front();
            let delay_s = applied.time_s - sample_time_s;
            if seq == applied.seq && delay_s >= 0.0 && self.delays_s.len() < KEPT_MAX {
                self.delays_s.push(delay_s);
            }
        }
    }

    /// `None` where the drive said too seldom when a command was applied.
    pub(super) fn delay(&self, period_s: f64) -> Option<LoopDelay> {
        if self.delays_s.len() < FEWEST {
            return None;
        }
        let mut sorted = self.delays_s.clone();
        let (median_s, p99_s) = (quantile(&mut sorted, 0.5), quantile(&mut sorted, 0.99));
        Some(LoopDelay {
            median_s,
            p99_s,
            median_cycles: median_s / period_s,
            p99_cycles: p99_s / period_s,
            measured: sorted.len(),
        })
    }
}

/// Measures the delay at the pace of the run, with the output off; `first_seq` goes on from what was sent before.
/// Returns the last number that was used, too.
///
/// # Errors
/// A link that is gone; a lost reply is only not counted.
pub fn measure_delay(
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    rate_hz: f64,
    first_seq: u64,
) -> Result<(Option<LoopDelay>, u64), LinkError> {
    let period_s = 1.0 / rate_hz;
    let begin_s = clock.now_s();
    let mut meter = DelayMeter::default();
    let mut last: Option<Sample> = None;
    let mut seq = first_seq;
    for cycle in 0..CYCLES {
        clock.sleep_until_s(begin_s + f64::from(cycle) * period_s);
        seq += 1;
        if let Some(sample) = last.take() {
            meter.sent(seq, sample.time_s);
        }
        let demand = Demand::Disable;
        match link.exchange(Command { seq, demand }) {
            Ok(sample) => {
                meter.sample(&sample);
                last = Some(sample);
            }
            Err(error) if error.is_transient() => {}
            Err(error) => return Err(error),
        }
    }
    Ok((meter.delay(period_s), seq))
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};
    use drivebench_model::sample::Applied;

    #[test]
    fn an_exchange_of_one_cycle_has_the_delay_of_one_cycle() {
        let config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
        let mut clock = VirtualClock::new();
        let drive = SoftDrive::new(&config, 1);
        let mut link = MemoryLink::new(drive, clock.clone(), Latency::default());
        let (delay, last) = measure_delay(&mut link, &mut clock, 100.0, 7).unwrap();
        let delay = delay.unwrap();
        // What is computed from a reply leaves with the next request: a cycle, on the drive's ticks of 50 us.
        assert!((delay.median_cycles - 1.0).abs() < 0.01, "{delay:?}");
        assert_eq!((delay.measured, last), (49, 57));
    }

    #[test]
    fn a_late_drive_is_measured_and_a_silent_one_is_not() {
        let mut meter = DelayMeter::default();
        for n in 0..100_u32 {
            let time_s = f64::from(n) * 0.01;
            meter.sent(n.into(), time_s);
            let mut sample = Sample::at(time_s + 0.01);
            // The reply tells of the command before.
            sample.applied =
                n.checked_sub(1).map(|seq| Applied { seq: seq.into(), time_s: time_s + 0.0095 });
            meter.sample(&sample);
        }
        let delay = meter.delay(0.01).unwrap();
        assert!((delay.median_cycles - 1.95).abs() < 1e-9, "{delay:?}");
        let mut deaf = DelayMeter::default();
        for n in 0..100 {
            deaf.sent(n, 0.0);
            deaf.sample(&Sample::at(0.0));
        }
        assert_eq!(deaf.delay(0.01), None);
        assert_eq!(deaf.waiting.len(), WAITING_MAX);
    }
}

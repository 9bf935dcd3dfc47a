//! Measurement of the loop's delay: from the instant of a sample to the instant at which the command that was computed from it
//! was applied, both by the drive's clock.
//!
//! It does not depend on the demand: it is measured at rest with the output off before the loop is tuned, and on while the
//! loop runs.

use std::collections::VecDeque;

use serde::Serialize;

use crate::clock::Clock;
use crate::push_within;
use crate::timing::quantile;
use drivebench_link::{DriveLink, LinkError};
use drivebench_model::sample::{Command, Demand, Sample};

/// Cycles are those of the requested rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LoopDelay {
    pub median_s: f64,
    pub p99_s: f64,
    pub median_cycles: f64,
    pub p99_cycles: f64,
    /// Commands with the time of their application.
    pub measured: usize,
}

/// Pairs samples with the commands that were computed from them.
#[derive(Clone, Debug, Default)]
pub(super) struct DelayMeter {
    /// Sequence number of a command, and time stamp of the sample from which it was computed.
    waiting: VecDeque<(u64, f64)>,
    delays_s: Vec<f64>,
}

impl DelayMeter {
    /// The command with this number is computed from a sample of this time.
    pub(super) fn sent(&mut self, seq: u64, sample_time_s: f64) {
        push_within(&mut self.waiting, (seq, sample_time_s), 64);
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
            // For the quantiles an hour at 100 Hz is enough.
            if seq == applied.seq && delay_s >= 0.0 && self.delays_s.len() < 360_000 {
                self.delays_s.push(delay_s);
            }
        }
    }

    /// `None` with fewer than ten measurements.
    pub(super) fn delay(&self, period_s: f64) -> Option<LoopDelay> {
        if self.delays_s.len() < 10 {
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

/// Measures the delay over 50 cycles at the rate of the run, with the output off; `first_seq` is the last number that was used
/// before. Returns the last number too.
///
/// # Errors
/// A link that is gone; lost replies are left out.
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
    for cycle in 0..50 {
        clock.sleep_until_s(begin_s + f64::from(cycle) * period_s);
        seq += 1;
        if let Some(sample) = last.take() {
            meter.sent(seq, sample.time_s);
        }
        match link.exchange(Command { seq, demand: Demand::Disable }) {
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
    use crate::testing::{exact, in_memory};
    use drivebench_model::sample::Applied;

    #[test]
    fn an_exchange_of_one_cycle_has_the_delay_of_one_cycle() {
        let (mut link, mut clock) = in_memory(&exact("zk-22fc-plain"), 1);
        let (delay, last) = measure_delay(&mut link, &mut clock, 100.0, 7).unwrap();
        let delay = delay.unwrap();
        // A command leaves with the request after its sample: a cycle, on the drive's ticks of 50 us.
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
            // A reply reports the application of the command before.
            sample.applied =
                n.checked_sub(1).map(|seq| Applied { seq: seq.into(), time_s: time_s + 0.0095 });
            meter.sample(&sample);
        }
        let delay = meter.delay(0.01).unwrap();
        assert!((delay.median_cycles - 1.95).abs() < 1e-9, "{delay:?}");
        let mut silent = DelayMeter::default();
        for n in 0..100 {
            silent.sent(n, 0.0);
            silent.sample(&Sample::at(0.0));
        }
        assert_eq!(silent.delay(0.01), None);
        assert_eq!(silent.waiting.len(), 64);
    }
}

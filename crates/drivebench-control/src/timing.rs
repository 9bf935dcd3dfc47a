//! Dead time of the loop, from a speed to the output that is computed from it.

use serde::{Deserialize, Serialize};

use drivebench_model::numerics::count::whole;

/// Delays of a sampled loop, s. They are measured on the link, not assumed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoopTiming {
    pub period_s: f64,
    /// From the instant at which the speed was sampled to the instant at which the output computed from it is applied:
    /// computing, link and drive.
    pub delay_s: f64,
    /// First-order filter in the speed measurement.
    pub filter_s: f64,
}

impl LoopTiming {
    /// Longest delay that is analysed, periods.
    pub const MOST_CYCLES: f64 = 64.0;

    pub fn delay_cycles(&self) -> f64 {
        self.delay_s / self.period_s
    }

    pub fn whole_cycles(&self) -> usize {
        whole(self.delay_cycles().round().clamp(0.0, Self::MOST_CYCLES))
    }

    /// With the zero-order hold, s: on average half a period on top of the delay.
    pub fn dead_time_s(&self) -> f64 {
        0.5 * self.period_s + self.delay_s
    }

    /// From a sample to the end of the period for which its output holds, s: as long a limited output acts on.
    pub fn leaving_s(&self) -> f64 {
        self.delay_s + self.period_s
    }

    /// Dead time and filter: the share of the small time constant that is not the motor's, s.
    pub fn small_time_s(&self) -> f64 {
        self.dead_time_s() + self.filter_s
    }

    pub fn is_valid(&self) -> bool {
        self.period_s.is_finite()
            && self.period_s > 0.0
            && [self.delay_s, self.filter_s].iter().all(|time| time.is_finite() && *time >= 0.0)
            && self.delay_cycles() <= Self::MOST_CYCLES
    }
}

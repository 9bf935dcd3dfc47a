//! Punctuality of the cycles: requested and achieved rate, lateness, missed cycles.

use drivebench_link::RoundTrips;
use drivebench_model::numerics::count::whole;
use serde::Serialize;

/// Lateness of cycles, in the histogram of bounded size that round trips have: a percentile is known to 5 %.
#[derive(Clone, Debug, Default)]
pub(super) struct Punctuality {
    late: RoundTrips,
    missed: u64,
    first_s: Option<f64>,
    last_s: f64,
}

impl Punctuality {
    pub(super) fn cycle(&mut self, now_s: f64, late_s: f64) {
        self.late.add(late_s);
        self.first_s.get_or_insert(now_s);
        self.last_s = now_s;
    }

    pub(super) fn missed(&mut self, cycles: u64) {
        self.missed += cycles;
    }

    pub(super) fn timing(&self, rate_asked_hz: f64) -> Timing {
        let span_s = self.last_s - self.first_s.unwrap_or(self.last_s);
        let steps = self.late.count().saturating_sub(1) as f64;
        Timing {
            rate_asked_hz,
            rate_achieved_hz: if span_s > 0.0 { steps / span_s } else { 0.0 },
            lateness_p50_s: self.late.p50_s().unwrap_or(0.0),
            lateness_p99_s: self.late.p99_s().unwrap_or(0.0),
            lateness_max_s: self.late.longest_s(),
            cycles: self.late.count(),
            missed_cycles: self.missed,
        }
    }
}

/// The smallest value that at least `share` of the values do not exceed; 0 without any. Sorts them.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = whole((share * values.len() as f64).ceil()).max(1);
    values.get(rank.min(values.len()).wrapping_sub(1)).copied().unwrap_or(0.0)
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Timing {
    pub rate_asked_hz: f64,
    pub rate_achieved_hz: f64,
    pub lateness_p50_s: f64,
    pub lateness_p99_s: f64,
    pub lateness_max_s: f64,
    pub cycles: u64,
    /// Deadlines that passed without a cycle.
    pub missed_cycles: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_within_a_bucket_and_the_worst_is_exact() {
        let mut punctuality = Punctuality::default();
        for cycle in 0..1000_u32 {
            punctuality.cycle(f64::from(cycle) * 0.01, if cycle < 985 { 100e-6 } else { 5e-3 });
        }
        punctuality.missed(3);
        let timing = punctuality.timing(100.0);
        assert!((timing.lateness_p50_s - 100e-6).abs() < 9e-6);
        assert!((timing.lateness_p99_s - 5e-3).abs() < 5e-4);
        assert!((timing.lateness_max_s - 5e-3).abs() < 1e-12);
        assert!((timing.rate_achieved_hz - 100.0).abs() < 1e-6);
        assert_eq!((timing.cycles, timing.missed_cycles), (1000, 3));
    }

    #[test]
    fn without_lateness_every_quantile_is_zero() {
        let mut punctuality = Punctuality::default();
        assert_eq!(punctuality.timing(1.0), Timing { rate_asked_hz: 1.0, ..Timing::default() });
        punctuality.cycle(0.0, 0.0);
        punctuality.cycle(0.5, 0.0);
        let timing = punctuality.timing(2.0);
        assert!(timing.lateness_p99_s.abs() < f64::EPSILON);
        assert!((timing.rate_achieved_hz - 2.0).abs() < 1e-12);
    }
}

//! Punctuality of the cycles: requested and achieved rate, lateness, missed cycles.

use serde::Serialize;

/// The logarithmic histogram of lateness: from 1 us, below which it counts as none, to 100 s.
const PER_DECADE: f64 = 30.0;
const BUCKETS: usize = 241;

/// Lateness of cycles as a histogram, so that the memory does not grow: a percentile is known to 8 %.
#[derive(Clone, Debug)]
pub(super) struct Punctuality {
    counts: Vec<u64>,
    cycles: u64,
    missed: u64,
    worst_s: f64,
    first_s: Option<f64>,
    last_s: f64,
}

impl Default for Punctuality {
    fn default() -> Self {
        Self {
            counts: vec![0; BUCKETS],
            cycles: 0,
            missed: 0,
            worst_s: 0.0,
            first_s: None,
            last_s: 0.0,
        }
    }
}

impl Punctuality {
    pub(super) fn cycle(&mut self, now_s: f64, late_s: f64) {
        let bucket = whole((PER_DECADE * (late_s / 1e-6).max(1.0).log10()).ceil());
        self.counts[bucket.min(BUCKETS - 1)] += 1;
        self.cycles += 1;
        self.worst_s = self.worst_s.max(late_s);
        self.first_s.get_or_insert(now_s);
        self.last_s = now_s;
    }

    pub(super) fn missed(&mut self, cycles: u64) {
        self.missed += cycles;
    }

    pub(super) fn timing(&self, rate_asked_hz: f64) -> Timing {
        let span_s = self.last_s - self.first_s.unwrap_or(self.last_s);
        Timing {
            rate_asked_hz,
            rate_achieved_hz: if span_s > 0.0 { (self.cycles - 1) as f64 / span_s } else { 0.0 },
            lateness_p50_s: self.quantile_s(0.5),
            lateness_p99_s: self.quantile_s(0.99),
            lateness_max_s: self.worst_s,
            cycles: self.cycles,
            missed_cycles: self.missed,
        }
    }

    /// Upper edge of the bucket in which the quantile lies.
    fn quantile_s(&self, share: f64) -> f64 {
        let rank = whole((share * self.cycles as f64).ceil()).max(1) as u64;
        let mut below = 0;
        for (bucket, count) in self.counts.iter().enumerate() {
            below += count;
            if below >= rank && below > 0 {
                let edge_s = 1e-6 * 10_f64.powf(bucket as f64 / PER_DECADE);
                return if bucket == 0 { 0.0 } else { edge_s.min(self.worst_s) };
            }
        }
        0.0
    }
}

/// The integer part of a number that is not negative.
pub(super) fn whole(value: f64) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "truncation is what is wanted; the cast saturates"
    )]
    {
        value as usize
    }
}

/// The smallest value that at least `share` of the values do not exceed; 0 without any. Sorts them.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = whole((share * values.len() as f64).ceil()).max(1);
    values.get(rank.min(values.len()).wrapping_sub(1)).copied().unwrap_or(0.0)
}

/// Requested and achieved rate, lateness, missed cycles.
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

//! What became of every request: counts that balance, and round-trip times.

use super::link::{LinkError, LinkStatistics};

/// Buckets per doubling of the round-trip time: 9 % wide.
const PER_DOUBLING: f64 = 8.0;
/// From 1 us to 16 s.
const BUCKETS: usize = 8 * 24;

/// Histogram of round-trip times with logarithmic buckets; bounded memory however long the run.
#[derive(Clone, Debug)]
pub struct RoundTrips {
    counts: [u64; BUCKETS],
    total: u64,
    longest_s: f64,
}

impl Default for RoundTrips {
    fn default() -> Self {
        Self {
            counts: [0; BUCKETS],
            total: 0,
            longest_s: 0.0,
        }
    }
}

impl RoundTrips {
    pub fn add(&mut self, round_trip_s: f64) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the cast of a float saturates, and the index is bounded below"
        )]
        let bucket = ((round_trip_s * 1e6).log2() * PER_DOUBLING) as usize;
        self.counts[bucket.min(BUCKETS - 1)] += 1;
        self.total += 1;
        self.longest_s = self.longest_s.max(round_trip_s);
    }

    pub const fn count(&self) -> u64 {
        self.total
    }

    pub const fn longest_s(&self) -> f64 {
        self.longest_s
    }

    /// The time that this share of all round trips did not exceed, s, within 5 %; `None` without any.
    pub fn quantile_s(&self, share: f64) -> Option<f64> {
        let rank = share.clamp(0.0, 1.0) * self.total as f64;
        let mut below = 0;
        let bucket = self.counts.iter().position(|count| {
            below += count;
            below > 0 && below as f64 >= rank
        })?;
        let centre_us = ((bucket as f64 + 0.5) / PER_DOUBLING).exp2();
        Some((centre_us * 1e-6).min(self.longest_s))
    }

    /// The buckets that are not empty: upper bound in us, and how many round trips fell into each.
    pub fn histogram_us(&self) -> Vec<(f64, u64)> {
        self.counts
            .iter()
            .enumerate()
            .filter(|(_, count)| **count > 0)
            .map(|(bucket, count)| {
                let bound_us = ((bucket as f64 + 1.0) / PER_DOUBLING).exp2();
                ((10.0 * bound_us).round() / 10.0, *count)
            })
            .collect()
    }

    pub fn p50_s(&self) -> Option<f64> {
        self.quantile_s(0.5)
    }

    pub fn p99_s(&self) -> Option<f64> {
        self.quantile_s(0.99)
    }
}

/// Counts and times of one link.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    pub(super) statistics: LinkStatistics,
    pub(super) round_trips: RoundTrips,
}

impl Tally {
    /// Books one request that went out, under the one class that its end belongs to.
    pub(super) fn settle<T>(&mut self, result: &Result<T, LinkError>, round_trip_s: f64) {
        self.statistics.settle(result);
        if result.is_ok() {
            self.round_trips.add(round_trip_s);
        }
    }
}

impl LinkStatistics {
    pub(super) const fn settle<T>(&mut self, result: &Result<T, LinkError>) {
        self.sent += 1;
        *match result {
            Ok(_) => &mut self.ok,
            Err(LinkError::Timeout { .. }) => &mut self.timeout,
            Err(LinkError::Corrupt { .. }) => &mut self.crc,
            Err(LinkError::Stale { .. } | LinkError::Unproven { .. }) => &mut self.stale,
            Err(
                LinkError::Mismatch { .. }
                | LinkError::Version { .. }
                | LinkError::Identity { .. }
                | LinkError::Refused { .. }
                | LinkError::Sequence { .. },
            ) => &mut self.mismatch,
            Err(LinkError::Exception { .. }) => &mut self.exception,
            Err(LinkError::Gone { .. } | LinkError::Open { .. }) => &mut self.aborted,
        } += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_within_a_bucket() {
        let mut trips = RoundTrips::default();
        assert_eq!(trips.p50_s(), None);
        for k in 1..=1000 {
            trips.add(f64::from(k) * 1e-5);
        }
        assert!((trips.p50_s().unwrap() / 5e-3 - 1.0).abs() < 0.06);
        assert!((trips.p99_s().unwrap() / 9.9e-3 - 1.0).abs() < 0.06);
        assert!((trips.quantile_s(0.0).unwrap() / 1e-5 - 1.0).abs() < 0.06);
        assert!((trips.longest_s() - 0.01).abs() < 1e-12);
        let histogram = trips.histogram_us();
        assert_eq!(histogram.iter().map(|(_, count)| count).sum::<u64>(), 1000);
        assert!(histogram.is_sorted_by(|a, b| a.0 < b.0) && histogram[0].0 > 10.0);
    }

    #[test]
    fn times_outside_the_range_are_counted_at_its_ends() {
        let mut trips = RoundTrips::default();
        trips.add(0.0);
        trips.add(1e9);
        assert_eq!(trips.count(), 2);
        assert!(trips.quantile_s(1.0).unwrap() > 1.0);
    }

    #[test]
    fn every_end_has_one_class() {
        let none = String::new;
        let timeout = LinkError::Timeout {
            link: none(),
            deadline_ms: 1,
            request: none(),
        };
        let exception = LinkError::Exception {
            link: none(),
            request: none(),
            code: 2,
            name: "x",
        };
        let version = LinkError::Version {
            link: none(),
            found: 2,
            expected: 1,
        };
        let ends: [Result<(), LinkError>; 8] = [
            Ok(()),
            Err(timeout),
            Err(LinkError::Corrupt(none(), none())),
            Err(LinkError::Stale(none(), none())),
            Err(LinkError::Mismatch(none(), none())),
            Err(exception),
            Err(LinkError::Gone(none(), none())),
            Err(version),
        ];
        let mut tally = Tally::default();
        for end in &ends {
            tally.settle(end, 0.001);
            assert!(tally.statistics.balances());
        }
        let s = tally.statistics;
        assert_eq!(
            (s.sent, s.ok, s.stale, s.mismatch, s.aborted),
            (8, 1, 1, 2, 1)
        );
    }
}

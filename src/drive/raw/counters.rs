//! What became of every request, and what the line carried.

use serde::Serialize;

use super::super::link::LinkStatistics;
use super::super::transaction::LineCounts;

/// Every request ends in exactly one class of the statistics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RawCounters {
    #[serde(flatten)]
    pub requests: LinkStatistics,
    /// Requests among `sent` that only proved that the line is in step.
    pub probes: u64,
    pub resynchronisations: u64,
    #[serde(flatten)]
    pub line: LineCounts,
}

//! What the bench needs of an excitation: a demand for every instant.

use crate::excitation;
use crate::sample::Demand;

/// A pure function of the time since its begin.
pub trait Program: Send {
    fn duration_s(&self) -> f64;

    /// The demand at `time_s`, before slew and limits. `Disable` lets the motor coast.
    fn demand_at(&self, time_s: f64) -> Demand;

    fn segment_at(&self, time_s: f64) -> usize;

    fn segment_name(&self, index: usize) -> &str;
}

impl Program for excitation::Program {
    fn duration_s(&self) -> f64 {
        Self::duration_s(self)
    }

    fn demand_at(&self, time_s: f64) -> Demand {
        self.value_at(time_s).into()
    }

    fn segment_at(&self, time_s: f64) -> usize {
        let spans = self.spans();
        spans
            .partition_point(|span| span.end_s <= time_s)
            .min(spans.len().saturating_sub(1))
    }

    fn segment_name(&self, index: usize) -> &str {
        self.spans().get(index).map_or("", |span| &span.name)
    }
}

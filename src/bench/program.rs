//! What the bench needs of an excitation: a demand for every instant.

use crate::sample::Demand;

/// A pure function of the time since its begin.
pub trait Program: Send {
    fn duration_s(&self) -> f64;

    /// The demand at `time_s`, before slew and limits. `Disable` lets the motor coast.
    fn demand_at(&self, time_s: f64) -> Demand;

    fn segment_at(&self, time_s: f64) -> usize;

    fn segment_name(&self, index: usize) -> &str;
}

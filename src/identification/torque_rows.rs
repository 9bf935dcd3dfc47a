//! The torque balance of one run as rows of a linear regression, open to any term.
//!
//! ```text
//! Scenario --(weak_form | inverse_dynamics: torque_rows)--> TorqueRows: left side, inertia's column, where the machine was
//!                                  any term at the samples --column--> its column beside them
//! ```
//!
//! `T = J <w'> + sum of coefficient x <term>`. Which terms stand on the right is the caller's: the diagnosis puts one
//! candidate effect after the other beside the same rows, so what costs time is done once.

use crate::plant::Instant;

/// How the rows came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Averaged over windows with a smooth test function, nothing differentiated (DISCOVERY.md 2.9).
    WeakForm,
    /// Differentiated and low-passed on both sides: the field's reference (Janot, Gautier and Brunot 2019).
    InverseDynamics,
}

/// Turns the values of a term at the samples into its column.
pub(super) type Averaging = Box<dyn Fn(&[f64]) -> Vec<f64> + Send + Sync>;

/// Rows of the torque balance over the scored part of one run.
pub struct TorqueRows {
    pub method: Method,
    /// What was done, for the reader.
    pub sentence: String,
    /// Where the machine was at each sample: terms are evaluated there. Under a given torque the current is that torque
    /// and the torque constant one, as in the simulation.
    pub at: Vec<Instant>,
    /// The run's first command, on the run's clock: times of events count from there.
    pub begin_s: f64,
    /// Middle of each row, on the run's clock.
    pub time_s: Vec<f64>,
    /// Mean speed and current (torque where that is given) of each row.
    pub speed_rad_s: Vec<f64>,
    pub current_a: Vec<f64>,
    /// Motor torque, N.m.
    pub left: Vec<f64>,
    /// What one unit of inertia contributes.
    pub inertia: Vec<f64>,
    /// Norms of a row's weights and of its weights for a rate: what white noise makes of a mean and of a rate; not a
    /// number where they are not known.
    pub gain: f64,
    pub rate_gain: f64,
    /// Length of one row's window (or of the filter's memory), s.
    pub span_s: f64,
    pub(super) averaging: Averaging,
}

impl TorqueRows {
    pub fn rows(&self) -> usize {
        self.left.len()
    }

    /// The column of a term with these values at the samples; not a number in rows that touch a missing value.
    pub fn column(&self, at_samples: &[f64]) -> Vec<f64> {
        (self.averaging)(at_samples)
    }
}

/// Linear interpolation between points, not across gaps longer than `longest_gap_s`.
pub(super) fn between(points: &[(f64, f64)], time_s: f64, longest_gap_s: f64) -> f64 {
    let after = points.partition_point(|point| point.0 < time_s);
    match (after.checked_sub(1).map(|k| points[k]), points.get(after)) {
        #[expect(clippy::float_cmp, reason = "a stamp of the same row")]
        (_, Some(exact)) if exact.0 == time_s => exact.1,
        (Some(a), Some(b)) if b.0 - a.0 <= longest_gap_s => {
            a.1 + (b.1 - a.1) * (time_s - a.0) / (b.0 - a.0)
        }
        _ => f64::NAN,
    }
}

/// Median distance between points, s; zero for fewer than two.
pub(super) fn median_gap_s(points: impl Iterator<Item = f64>) -> f64 {
    let times: Vec<f64> = points.collect();
    let gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let median = crate::numerics::statistics::median(&gaps);
    if median.is_finite() { median } else { 0.0 }
}

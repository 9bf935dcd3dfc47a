//! Speed loops in virtual time, for both papers: machines, every regulator on them, what a trace shows.
//!
//! ```text
//! bench (model, machine, timing, limits) + kind --> controller --trial--> trace --> measure: steps, load changes, effort
//!                                                                           \--> cases: every regulator on the same cases
//! ```

mod bench;
mod cases;
mod joining;
mod measure;

pub use bench::Kind;
pub(super) use bench::{Bench, Trial, cycles};
pub use cases::{Case, CaseRow, Comparison};
pub(super) use cases::{Sizes, comparison};
pub(super) use joining::{Joining, WithBackEmf};
pub use measure::{LoadChange, Step};
pub(super) use measure::{
    effort_v, error, lasting_rad_s, limited_percent, load_change, mean_and_std, rms, steps, within,
};

use crate::control::TrialPoint;

/// A trace with its name; in JSON the name only.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Named {
    pub name: String,
    #[serde(skip)]
    pub trace: Vec<TrialPoint>,
}

impl Named {
    pub fn new(name: impl Into<String>, trace: Vec<TrialPoint>) -> Self {
        Self {
            name: name.into(),
            trace,
        }
    }

    /// Each trace with its name.
    pub fn all<const N: usize>(names: [&str; N], traces: [Vec<TrialPoint>; N]) -> Vec<Self> {
        let pairs = names.into_iter().zip(traces);
        pairs.map(|(name, trace)| Self::new(name, trace)).collect()
    }
}

/// A square wave that begins `high`, each level for `half_s`.
pub(super) fn square(half_s: f64, high: f64, low: f64) -> impl Fn(f64) -> f64 {
    // A hundredth of a step of rounding must not decide on which side of an edge a cycle lies.
    move |t| {
        if ((t / half_s + 1e-9).floor() % 2.0).abs() < 0.5 {
            high
        } else {
            low
        }
    }
}

//! Budget of a diagnosis, in sub-steps of simulation, so that a run which no set of effects explains costs seconds.
//!
//! A limit of time would not be reproducible on another machine. Sub-steps are counted as they are simulated, on any
//! thread, and the count is read between steps of the search only, where it does not depend on the order of the threads.

use std::sync::atomic::{AtomicU64, Ordering};

/// Sub-steps of a linear machine, or their equivalent, after which a search takes no further step. Two cores simulate some 80
/// million a second, and two records of 25,500 rows are diagnosed in 15 s; with 300 million a backlash at 100 Hz was not searched to
/// the end, with two false names more, and with 400 a servo with a drop of .15 V, two filters and a clock of 1 ms.
const MOST_STEPS: u64 = 600_000_000;
/// Share of the budget that one refit may take.
const REFIT_SHARE: f64 = 0.1;
/// Fewest iterations of a refit: fewer do not converge from the initial values.
const FEWEST_ITERATIONS: usize = 4;

/// What a search has simulated.
#[derive(Default)]
pub(super) struct Work {
    steps: AtomicU64,
}

impl Work {
    pub(super) fn add(&self, steps: u64) {
        self.steps.fetch_add(steps, Ordering::Relaxed);
    }

    pub(super) fn is_spent(&self) -> bool {
        self.steps.load(Ordering::Relaxed) >= MOST_STEPS
    }

    /// The same of one refit: a model may become stiff during the fit, and each of its iterations as expensive as
    /// all that were planned.
    pub(super) fn is_spent_by_a_refit(&self) -> bool {
        self.steps.load(Ordering::Relaxed) as f64 >= 2.0 * REFIT_SHARE * MOST_STEPS as f64
    }
}

/// Iterations that a refit may take of `most`, each of so many sub-steps.
pub(super) fn iterations_of(steps: u64, most: usize) -> usize {
    let affordable = REFIT_SHARE * MOST_STEPS as f64 / steps.max(1) as f64;
    (FEWEST_ITERATIONS.min(most)..most).find(|count| *count as f64 >= affordable).unwrap_or(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refit_of_a_short_run_takes_all_iterations_and_one_of_a_long_run_some() {
        assert_eq!(iterations_of(1000, 25), 25);
        assert_eq!(iterations_of(6_000_000, 25), 10);
        assert_eq!(iterations_of(u64::MAX, 25), FEWEST_ITERATIONS);
    }
}

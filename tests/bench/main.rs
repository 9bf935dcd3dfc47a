//! Benches and records of the library against the emulator's truth, in virtual time and without the binary: what is named,
//! what is covered, what is refused.
#![expect(clippy::unwrap_used, reason = "helpers of an integration test are test code")]

mod coverage;
mod deviations;
mod diagnosis_on_emulator;
mod mechanical;
mod next_run;
mod placebo;
mod rule6;

use drivebench::diagnosis::Evidence;

/// With `DRIVEBENCH_EVERYTHING` the counts are over all machines and effects; else each claim is tested on fewer of them.
pub(crate) fn everything() -> bool {
    std::env::var_os("DRIVEBENCH_EVERYTHING").is_some()
}

/// The most by which chance lets a counted share lie off its true one: 2.6 standard deviations of a binomial share.
pub(crate) fn tolerance(share: f64, of: usize) -> f64 {
    2.6 * (share * (1.0 - share) / of.max(1) as f64).sqrt()
}

/// The other way round: each run is half of what is known.
pub(crate) fn swapped(data: &Evidence) -> Evidence {
    Evidence { training: data.holdout.clone(), holdout: data.training.clone(), ..data.clone() }
}

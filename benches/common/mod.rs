//! What the benchmarks share.
//!
//! ```text
//! hot_paths, simulation, diagnosis, session, ... -> target/criterion/*/new/*.json -> table -> docs/benchmarks.md
//! ```

pub(crate) mod records;

use std::time::Duration;

use criterion::Criterion;

/// Many short samples: on a shared machine the least of them is near the truth and their spread says how near.
pub(crate) fn settings() -> Criterion {
    Criterion::default()
        .sample_size(100)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args()
}

//! Common code of the benchmarks.
//!
//! ```text
//! hot_paths, simulation, diagnosis, session, ... -> target/criterion/*/new/*.json -> table -> docs/benchmarks.md
//! ```

pub(crate) mod records;

use std::time::Duration;

use criterion::Criterion;

/// Many short samples: on a shared machine their minimum estimates the cost and their spread its uncertainty.
pub(crate) fn settings() -> Criterion {
    Criterion::default()
        .sample_size(100)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args()
}

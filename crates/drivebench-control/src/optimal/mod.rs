//! Optimal control: paper B's, and what a practitioner puts in its place today.
//!
//! ```text
//! paper B:       n --> Kalman filter (2 states) --> -gamma G (x - r) --> + u0 --> u
//!                n - n_p, filtered ---------------- -K3 ------------------^
//! practitioner:  i, w --> Kalman filter (i, w, load) --> predicted over the delay --> feedback + integral --> u
//! ```

mod augmented;
mod paper_b;
#[cfg(test)]
mod tests;

pub use augmented::{LoadObserving, LoadObservingSettings};
pub use paper_b::{PaperB, PaperBError, PaperBPlant, PaperBSettings};

//! Linear-quadratic Gaussian control (Anderson and Moore, Optimal Control: Linear Quadratic Methods, 1990): paper B's, and
//! one with a load observer, integral action and prediction over the delay.
//!
//! ```text
//! paper B:       n --> Kalman filter (2 states) --> -gamma G (x - r) --> + u0 --> u
//!                n - n_p, filtered ---------------- -K3 ------------------^
//! load observer: i, w --> Kalman filter (i, w, load) --> predicted over the delay --> feedback + integral --> u
//! ```

mod lqg;
mod paper_b;
#[cfg(test)]
mod tests;

pub use lqg::{LoadObserving, LoadObservingSettings};
pub use paper_b::{PaperB, PaperBError, PaperBPlant, PaperBSettings};

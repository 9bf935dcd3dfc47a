//! Mathematics without physics: filters, least squares (batch, recursive, non-linear), propagators and statistics.
//!
//! ```text
//! rows of a balance -> least_squares | recursive_least_squares -> estimate, covariance
//! residuals, states -> levenberg_marquardt | riccati          -> optimum, gains
//! ```

pub mod change_watch;
pub mod checksum;
mod clustered_spread;
pub mod count;
pub mod filter;
pub mod least_squares;
pub mod levenberg_marquardt;
pub mod linear_map;
pub mod propagator;
pub mod recursive_least_squares;
pub mod riccati;
pub mod root;
pub mod statistics;

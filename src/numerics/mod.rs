//! Mathematics without physics: filters, least squares (batch, recursive, non-linear) and statistics.

pub mod change_watch;
mod clustered_spread;
pub mod count;
pub mod filter;
pub mod least_squares;
pub mod levenberg_marquardt;
pub mod linear_map;
pub(crate) mod propagator;
pub mod recursive_least_squares;
pub mod reference_recursive_least_squares;
pub mod riccati;
pub mod root;
pub mod statistics;

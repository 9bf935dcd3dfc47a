//! Mathematics without physics: filters, least squares (batch, recursive, non-linear) and statistics.

pub mod count;
pub mod filter;
pub mod least_squares;
pub mod levenberg_marquardt;
pub mod recursive_least_squares;
pub mod reference_recursive_least_squares;
pub mod root;
pub mod statistics;

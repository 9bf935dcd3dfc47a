//! Mathematics without physics: least squares (batch, recursive, non-linear) and statistics.

pub mod least_squares;
pub mod levenberg_marquardt;
pub mod statistics;

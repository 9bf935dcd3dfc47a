//! Mathematics without physics: least squares, Levenberg-Marquardt, statistics.

pub mod least_squares;
pub mod levenberg_marquardt;
pub mod recursive_least_squares;

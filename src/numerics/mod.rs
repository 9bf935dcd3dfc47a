//! Mathematics without physics: least squares, Levenberg-Marquardt, statistics.

pub mod levenberg_marquardt;

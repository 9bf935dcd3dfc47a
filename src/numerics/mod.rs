//! Mathematics without physics: least squares, Levenberg-Marquardt, matrix exponential, statistics.

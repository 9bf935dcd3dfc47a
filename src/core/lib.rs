//! The core of drivebench: physics, identification, control and diagnosis as functions of time, without a clock, a file or a terminal.

pub mod config_text;
pub mod control;
pub mod diagnosis;
pub mod excitation;
pub mod identification;
pub mod numerics;
pub mod plant;
pub mod sample;
pub mod signal;
pub mod text;
pub mod units;

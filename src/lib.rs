//! drivebench: connect to a motor drive, identify the motor on line, and learn which physical effect its model misses.
//!
//! The floors of the house, lowest first; a file uses only what stands on a lower floor. The lower half is a crate of its own,
//! [`drivebench_core`], which knows no clock, file or terminal; its rooms are shown here beside those above it.
//!
//! ```text
//! core:    units < text < sample < signal < numerics < {plant, excitation} < identification < {diagnosis, control}
//! program: {drive, recording} < emulator < bench < report < workflow < tui < app < cli < main
//! ```

pub use drivebench_core::{
    config_text, control, diagnosis, excitation, identification, numerics, plant, sample, signal,
    text, units,
};

pub mod app;
pub mod bench;
pub mod cli;
pub mod drive;
pub mod emulator;
pub mod recording;
pub mod report;
pub mod tui;
pub mod workflow;
